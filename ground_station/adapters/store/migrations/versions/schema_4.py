"""Several days, and packs with their flights.

This migration must not follow changes of `tables`: it describes schema 4 as it is.
"""

from datetime import datetime

import sqlalchemy as sa
from alembic import op

revision = "4"
down_revision = "3"

_count = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Upgrade from schema 3: all orders are of the day of the first one."""
    op.create_table(
        "days",
        sa.Column("day", sa.String(10), primary_key=True),
        sa.Column("began_us", sa.BigInteger, nullable=False),
    )
    op.create_table("order_days", _day_column(), _of("order_id", "orders.id"))
    op.create_table(
        "past_plans",
        _day_column(),
        sa.Column("revision", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("content", sa.Text, nullable=False),
        sa.Column("why", sa.Text, nullable=False),
        sa.Column("wind", sa.Text),
        sa.Column("made_us", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "past_visits",
        _day_column(),
        sa.Column("stop", sa.String(64), primary_key=True),
        sa.Column("arrived_us", sa.BigInteger, nullable=False),
        sa.Column("left_us", sa.BigInteger),
    )
    _create_pack_tables()
    orders = sa.table("orders", sa.column("id"), sa.column("taken_us"))
    first_us = op.get_bind().execute(sa.select(sa.func.min(orders.c.taken_us))).scalar() or 0
    day = datetime.fromtimestamp(first_us / 1e6).date().isoformat()  # local, as people write it
    days = sa.table("days", sa.column("day"), sa.column("began_us"))
    op.execute(sa.insert(days).values(day=day, began_us=0))
    order_days = sa.table("order_days", sa.column("day"), sa.column("order_id"))
    of_day = sa.select(sa.literal(day, sa.String), orders.c.id)
    op.execute(sa.insert(order_days).from_select(["day", "order_id"], of_day))


def _day_column() -> "sa.Column[str]":
    return sa.Column("day", sa.String(10), sa.ForeignKey("days.day"), primary_key=True)


def _of(name: str, key: str) -> "sa.Column[str]":
    return sa.Column(name, sa.String(64), sa.ForeignKey(key), primary_key=True)


def _create_pack_tables() -> None:
    op.create_table(
        "packs",
        sa.Column("n", _count, primary_key=True, autoincrement=True),
        sa.Column("pack", sa.String(64), nullable=False),
        sa.Column("vehicle", sa.String(32), nullable=False),
        sa.Column("fitted_us", sa.BigInteger, nullable=False),
        sa.Column("fitted_by", sa.String(64), nullable=False),
        sa.Column("removed_us", sa.BigInteger),
    )
    fitted = sa.text("removed_us IS NULL")
    for name in ("pack", "vehicle"):
        op.create_index(
            f"one_fitted_per_{name}",
            "packs",
            [name],
            unique=True,
            sqlite_where=fitted,
            postgresql_where=fitted,
        )
    op.create_table(
        "flights",
        _of("assignment", "assignments.id"),
        sa.Column("pack", sa.String(64)),
        sa.Column("used_wh", sa.Float, nullable=False),
        sa.Column("ended_us", sa.BigInteger, nullable=False),
    )
