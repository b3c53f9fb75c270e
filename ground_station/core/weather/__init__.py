"""Forecasts of the wind: over time, height and place, and what they let fly when."""
