"""What happened, and what a controller remembers, on disk."""
