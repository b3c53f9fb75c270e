"""Replay of recorded flights through estimators and gate. Flight code does not import it."""
