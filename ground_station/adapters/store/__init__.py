"""The database of a desk: SQLite or PostgreSQL."""
