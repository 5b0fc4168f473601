"""Motions within an arm's limits: where a goal becomes a reference that an arm can follow."""
