"""Files that people or programs write: days, plans, params, benchmark problems."""
