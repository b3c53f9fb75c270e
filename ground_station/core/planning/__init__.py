"""Day plans: from the day's data and its present state to stops and sorties."""
