"""The oldest schema that can be brought to today's."""

revision = "2"
down_revision = None


def upgrade() -> None:
    """Nothing: such a store is there."""
