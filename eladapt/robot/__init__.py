"""The robot and its library."""
