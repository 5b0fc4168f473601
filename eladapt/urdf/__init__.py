"""Reading, checking and writing robot files."""
