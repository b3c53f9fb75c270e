"""The tested behaviours, by family."""
