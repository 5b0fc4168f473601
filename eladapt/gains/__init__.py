"""Gains from the URDF and from what is known of the hardware around the arm."""
