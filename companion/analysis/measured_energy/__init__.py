"""Measured against predicted energy of recorded flights: tracks, phases, times, daily scatter."""
