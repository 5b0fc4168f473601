"""What others do: controllers to compare with, in the same loop."""
