"""Holds, the audit, layers, sent launches, and confirmed launches.

This migration must not follow changes of `tables`: it describes schema 3 as it is.
"""

import sqlalchemy as sa
from alembic import op

revision = "3"
down_revision = "2"

_count = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Upgrade from schema 2."""
    op.add_column(
        "commands", sa.Column("sent", sa.Boolean, nullable=False, server_default=sa.false())
    )
    op.add_column("assignments", sa.Column("confirmed_by", sa.String(64)))
    op.add_column("assignments", sa.Column("layer", sa.Integer))
    in_force = sa.text("state IN ('ordered', 'aboard', 'flying', 'withdrawing')")
    op.create_index(
        "one_in_force_per_layer",
        "assignments",
        ["layer"],
        unique=True,
        sqlite_where=in_force,
        postgresql_where=in_force,
    )
    # Schema 2 does not record sending: an unanswered launch counts as sent.
    commands = sa.table(
        "commands", sa.column("id"), sa.column("answer"), sa.column("sent", sa.Boolean)
    )
    waits = commands.c.id.contains(":launch") & commands.c.answer.is_(None)
    op.execute(sa.update(commands).where(waits).values(sent=True))
    _create_hold_table()
    _create_audit_table()


def _create_hold_table() -> None:
    op.create_table(
        "holds",
        sa.Column("n", _count, primary_key=True, autoincrement=True),
        sa.Column("scope", sa.String(32), nullable=False),
        sa.Column("reason", sa.Text, nullable=False),
        sa.Column("set_by", sa.String(64), nullable=False),
        sa.Column("set_us", sa.BigInteger, nullable=False),
        sa.Column("lifted_by", sa.String(64)),
        sa.Column("lifted_us", sa.BigInteger),
    )
    op.create_index("ix_holds_lifted_us", "holds", ["lifted_us"])


def _create_audit_table() -> None:
    op.create_table(
        "audit",
        sa.Column("n", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("at_us", sa.BigInteger, nullable=False),
        sa.Column("who", sa.String(64), nullable=False),
        sa.Column("login", sa.String(64), nullable=False),
        sa.Column("deed", sa.String(32), nullable=False),
        sa.Column("subject", sa.Text, nullable=False),
        sa.Column("answer", sa.Text, nullable=False),
        sa.Column("before", sa.String(64), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
    )
    head = '{"n":0,"digest":"' + "0" * 64 + '"}'
    about = sa.table("about", sa.column("name", sa.Text), sa.column("value", sa.Text))
    op.bulk_insert(about, [{"name": "audit_head", "value": head}])
