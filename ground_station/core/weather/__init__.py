"""Forecasts of the wind over time, height and position."""
