"""Plants, runs and records."""
