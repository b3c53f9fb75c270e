"""Fit of a wind process to wind recordings. Flight code does not import it."""
