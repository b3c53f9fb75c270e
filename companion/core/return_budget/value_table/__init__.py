"""The best policy by dynamic programming, as a table that is read in flight."""
