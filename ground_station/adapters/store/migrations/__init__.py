"""Migrations of the store between schemas (Alembic); a revision is a schema's number."""
