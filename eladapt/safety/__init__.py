"""What stands between a controller and an arm."""
