"""Winds over a whole site: several vehicles meet one field."""
