"""Rows 2 and 11: paths that a vehicle with a turn radius can fly, in steady wind."""
