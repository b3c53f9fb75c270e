"""The store's tables (SQLAlchemy Core), equal for SQLite and PostgreSQL.

Constraints exclude inconsistent states: one assignment in force for each order, for each drone and
for each layer over the depot, one command for each id, one event for each position in a member's
log, one plan for each revision.
"""

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
    false,
    text,
)

from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.orders import IN_FORCE

SCHEMA = 4
"""Schema that `migrations` upgrades a store to; the table `about` contains a store's schema."""

ROSTER_KEY = "roster"  # name in `about` of the desk's signed roster
IDLE_KEY = "idle"  # name in `about` of the reasons why vehicles get no order
LATE_KEY = "late"  # name in `about` of the orders that cannot keep their window
CONFIRM_KEY = "confirm"  # name in `about` of the assignments that wait for a confirmed launch
EPOCHS_KEY = "epochs"  # name in `about` of the epochs of this store; the last is in force
DEPOT_KEY = "depot"  # name in `about` of the depot's location; absent on a day with a truck

metadata = MetaData()

about = Table(
    "about",
    metadata,
    Column("name", String(40), primary_key=True),
    Column("value", Text, nullable=False),
)

_count = BigInteger().with_variant(Integer, "sqlite")

orders = Table(
    "orders",
    metadata,
    Column("n", _count, primary_key=True, autoincrement=True),
    Column("id", String(64), nullable=False, unique=True),
    Column("content", Text, nullable=False),
    Column("state", String(16), nullable=False, index=True),
    Column("attempts", Integer, nullable=False, default=0),
    Column("why", Text, nullable=False, default=""),
    Column("taken_us", BigInteger, nullable=False),
)

assignments = Table(
    "assignments",
    metadata,
    Column("n", _count, primary_key=True, autoincrement=True),
    Column("id", String(64), nullable=False, unique=True),
    Column("order_id", String(64), ForeignKey("orders.id"), nullable=False),
    Column("vehicle", String(32), nullable=False),
    Column("state", String(16), nullable=False, index=True),
    Column("delivered", Boolean, nullable=False, default=False),
    Column("why", Text, nullable=False, default=""),
    Column("made_us", BigInteger, nullable=False),
    Column("ended_us", BigInteger),
    Column("confirmed_by", String(64)),
    Column("layer", Integer),
)

_in_force = text("state IN ({})".format(", ".join(f"'{s.value}'" for s in IN_FORCE)))
_drone_in_force = text(f"{_in_force.text} AND vehicle <> '{TRUCK}'")  # a truck may have several
for _column, _condition in (
    (assignments.c.order_id, _in_force),
    (assignments.c.vehicle, _drone_in_force),
    (assignments.c.layer, _in_force),  # NULL for sorties from a truck: their plan has the layer
):
    Index(
        f"one_in_force_per_{_column.name}",
        _column,
        unique=True,
        sqlite_where=_condition,
        postgresql_where=_condition,
    )

commands = Table(
    "commands",
    metadata,
    Column("n", _count, primary_key=True, autoincrement=True),
    Column("id", String(64), nullable=False, unique=True),
    Column("vehicle", String(32), nullable=False),
    Column("assignment", String(64)),
    Column("deed", LargeBinary, nullable=False),
    Column("said_by", String(64), nullable=False),
    Column("held", Boolean, nullable=False, default=False),
    Column("sent", Boolean, nullable=False, server_default=false()),
    Column("answer", String(16), index=True),
    Column("reason", Text, nullable=False, default=""),
    Column("life", String(64)),
    Column("made_us", BigInteger, nullable=False),
    Column("answered_us", BigInteger),
)

events = Table(
    "events",
    metadata,
    Column("n", _count, primary_key=True, autoincrement=True),
    Column("vehicle", String(32), nullable=False),
    Column("log", String(64), nullable=False),
    Column("seq", BigInteger, nullable=False),
    Column("kind", String(16), nullable=False),
    Column("assignment", String(64)),
    Column("content", Text, nullable=False),
    Column("heard_us", BigInteger, nullable=False),
    UniqueConstraint("vehicle", "log", "seq"),
)

logs = Table(
    "logs",
    metadata,
    Column("vehicle", String(32), primary_key=True),
    Column("log", String(64), primary_key=True),
    Column("seen_to", BigInteger, nullable=False),
)

plans = Table(
    "plans",
    metadata,
    Column("revision", Integer, primary_key=True, autoincrement=False),
    Column("content", Text, nullable=False),
    Column("why", Text, nullable=False),
    Column("wind", Text),
    Column("made_us", BigInteger, nullable=False),
)

sorties = Table(
    "sorties",
    metadata,
    Column("assignment", String(64), ForeignKey("assignments.id"), primary_key=True),
    Column("content", Text, nullable=False),
    Column("pads", Text, nullable=False),
    Column("promised", String(64), nullable=False),
    Column("asked", String(64)),
    Column("placed", Boolean, nullable=False, default=False),
    Column("recovered", Boolean, nullable=False, default=False),
    Column("away", Boolean, nullable=False, default=False),
    Column("lapsed", Boolean, nullable=False, default=False),
    Column("launched_us", BigInteger),
    Column("landed_us", BigInteger),
    Column("used_wh", Float),
)

visits = Table(
    "visits",
    metadata,
    Column("stop", String(64), primary_key=True),
    Column("arrived_us", BigInteger, nullable=False),
    Column("left_us", BigInteger),
)

days = Table(
    "days",
    metadata,
    Column("day", String(10), primary_key=True),
    Column("began_us", BigInteger, nullable=False),
)

order_days = Table(  # an order that is carried over is of several days
    "order_days",
    metadata,
    Column("day", String(10), ForeignKey("days.day"), primary_key=True),
    Column("order_id", String(64), ForeignKey("orders.id"), primary_key=True),
)

past_plans = Table(
    "past_plans",
    metadata,
    Column("day", String(10), ForeignKey("days.day"), primary_key=True),
    Column("revision", Integer, primary_key=True, autoincrement=False),
    Column("content", Text, nullable=False),
    Column("why", Text, nullable=False),
    Column("wind", Text),
    Column("made_us", BigInteger, nullable=False),
)

past_visits = Table(
    "past_visits",
    metadata,
    Column("day", String(10), ForeignKey("days.day"), primary_key=True),
    Column("stop", String(64), primary_key=True),
    Column("arrived_us", BigInteger, nullable=False),
    Column("left_us", BigInteger),
)

packs = Table(
    "packs",
    metadata,
    Column("n", _count, primary_key=True, autoincrement=True),
    Column("pack", String(64), nullable=False),
    Column("vehicle", String(32), nullable=False),
    Column("fitted_us", BigInteger, nullable=False),
    Column("fitted_by", String(64), nullable=False),
    Column("removed_us", BigInteger),
)
_fitted = text("removed_us IS NULL")
for _column in (packs.c.pack, packs.c.vehicle):
    Index(
        f"one_fitted_per_{_column.name}",
        _column,
        unique=True,
        sqlite_where=_fitted,
        postgresql_where=_fitted,
    )

flights = Table(
    "flights",
    metadata,
    Column("assignment", String(64), ForeignKey("assignments.id"), primary_key=True),
    Column("pack", String(64)),
    Column("used_wh", Float, nullable=False),
    Column("ended_us", BigInteger, nullable=False),
)

hold_table = Table(
    "holds",
    metadata,
    Column("n", _count, primary_key=True, autoincrement=True),
    Column("scope", String(32), nullable=False),
    Column("reason", Text, nullable=False),
    Column("set_by", String(64), nullable=False),
    Column("set_us", BigInteger, nullable=False),
    Column("lifted_by", String(64)),
    Column("lifted_us", BigInteger, index=True),
)

audit = Table(
    "audit",
    metadata,
    Column("n", BigInteger, primary_key=True, autoincrement=False),
    Column("at_us", BigInteger, nullable=False),
    Column("who", String(64), nullable=False),
    Column("login", String(64), nullable=False),
    Column("deed", String(32), nullable=False),
    Column("subject", Text, nullable=False),
    Column("answer", Text, nullable=False),
    Column("before", String(64), nullable=False),
    Column("digest", String(64), nullable=False),
)
