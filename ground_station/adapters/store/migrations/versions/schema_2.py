"""The oldest schema that can be upgraded."""

revision = "2"
down_revision = None


def upgrade() -> None:
    """Do nothing: a store of this schema exists."""
