"""Day plans: stops and sorties from the day's data and current state."""
