"""Thousands of random worlds: in how many a controller fails, in which, and why."""
