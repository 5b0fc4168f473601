"""Plots of a record, and its motion in three dimensions."""
