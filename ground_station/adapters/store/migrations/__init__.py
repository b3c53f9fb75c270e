"""Steps from one schema of the store to the next (Alembic); a revision is a schema's number."""
