"""Days of one store. Orders, plans and the truck's visits belong to a day, all other rows by time.

The newest day is the current one: desks, commands and page act on it only. Orders that are open or
stuck when a day begins are carried over to it. Plans and visits of earlier days are in tables of
their own, since revisions and stops are counted for each day.
"""

from collections.abc import Callable
from typing import Any

import sqlalchemy as sa

from companion.core.base.errors import LeewayError
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.about_steps import about_value, replace_about_value
from ground_station.adapters.store.database import Database
from ground_station.core.schema.order_states import OrderState

DAY_START_KEY = "day_began_us"
SPARES_KEY = "spares"
_KEYS_OF_A_DAY = (
    *(DAY_START_KEY, SPARES_KEY),
    *(t.IDLE_KEY, t.LATE_KEY, t.CONFIRM_KEY, t.DEPOT_KEY),
)
_CARRIED = [OrderState.OPEN.value, OrderState.STUCK.value]
_NEWEST_FIRST = sa.select(t.days.c.day).order_by(t.days.c.began_us.desc())
_END_OF_TIME_US = 2**62


def current_day(database: Database) -> str:
    """Return the date of the current day."""
    with database.read() as db:
        return db.execute(_NEWEST_FIRST.limit(1)).scalar_one()


def read_spares(database: Database) -> dict[str, str]:
    """Return the day's spare drones, each with the drone of the day file whose place it has."""
    return database.about_value(SPARES_KEY, dict[str, str]) or {}


def day_and_spares(database: Database) -> tuple[str, dict[str, str]]:
    """Return the current day, and its spare drones."""
    return current_day(database), read_spares(database)


def has_new_spare(database: Database, before: tuple[str, dict[str, str]]) -> bool:
    """Return whether a spare drone has joined since `before`. LeewayError: another day began."""
    now = day_and_spares(database)
    if now[0] != before[0]:
        raise LeewayError("a new day has begun while this desk ran: start the desk again")
    return now != before


def past_day_or_none(database: Database, day: str) -> str | None:
    """Return this day; None: it is the current one. Raises LeewayError if the store has no such."""
    with database.read() as db:
        known = list(db.execute(_NEWEST_FIRST).scalars())
    if day not in known:
        raise LeewayError(f"--date {day}: expected a day of the store: {', '.join(known)}")
    return None if day == known[0] else day


def during(column: Any, day: str | None) -> sa.ColumnElement[bool]:
    """Select rows by their time stamp; `day` None: of the current day."""
    begun = column >= start_us_of(day).scalar_subquery()
    return begun if day is None else begun & (column < end_us_of(day))


def start_us_of(day: str | None) -> "sa.Select[int]":
    """Select the start of a day; None: of the current one."""
    if day is None:
        return sa.select(sa.func.max(t.days.c.began_us))
    return sa.select(t.days.c.began_us).where(t.days.c.day == day)


def end_us_of(day: str) -> sa.ColumnElement[int]:
    """Return the start of the next day."""
    start = start_us_of(day).scalar_subquery()
    later = sa.select(sa.func.min(t.days.c.began_us)).where(t.days.c.began_us > start)
    return sa.func.coalesce(later.scalar_subquery(), _END_OF_TIME_US)


def is_order_of(day: str | None) -> sa.ColumnElement[bool]:
    """Select orders; `day` None: of the current day."""
    which = _NEWEST_FIRST.limit(1).scalar_subquery() if day is None else sa.literal(day)
    of_day = sa.select(t.order_days.c.order_id).where(t.order_days.c.day == which)
    return t.orders.c.id.in_(of_day)


def carried_over_from(db: sa.Connection, day: str | None) -> set[str]:
    """Return the orders that were carried over to a day after this one."""
    if day is None:
        return set()
    later = sa.select(t.order_days.c.order_id).where(t.order_days.c.day > day)
    return set(db.execute(later).scalars())


def insert_orders_of_current_day(db: sa.Connection, order_ids: list[str]) -> None:
    """Make new orders those of the current day."""
    day = db.execute(_NEWEST_FIRST.limit(1)).scalar_one()
    db.execute(sa.insert(t.order_days), [{"day": day, "order_id": one} for one in order_ids])


def of_earlier_days(db: sa.Connection, order_ids: list[str]) -> set[str]:
    """Return those of these orders that are not of the current day: they are closed."""
    query = sa.select(t.orders.c.id).where(t.orders.c.id.in_(order_ids), ~is_order_of(None))
    return set(db.execute(query).scalars())


def plans_of(day: str | None) -> "tuple[sa.Table, sa.ColumnElement[bool]]":
    """Return the table of a day's plans, and the condition of its rows."""
    return (t.plans, sa.true()) if day is None else (t.past_plans, t.past_plans.c.day == day)


def visits_of(day: str | None) -> "tuple[sa.Table, sa.ColumnElement[bool]]":
    """Return the table of the truck's visits on a day, and the condition of its rows."""
    return (t.visits, sa.true()) if day is None else (t.past_visits, t.past_visits.c.day == day)


def day_start_key(day: str | None) -> str:
    """Return the name in `about` of the start of the truck's day."""
    return DAY_START_KEY if day is None else f"{DAY_START_KEY}.{day}"


def begin_day(database: Database, epoch_us: Callable[[], int], day: str, by: str) -> str:
    """Begin a day unless it is the current one; returns the result. Raises LeewayError while an
    assignment is in force, and for a day before the current one.
    """
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        before = db.execute(_NEWEST_FIRST.limit(1)).scalar_one()
        if day == before:
            return f"day {day} continues"
        if day < before:
            raise LeewayError(f"day {day}: the store's day is {before}: check the clock")
        states = [state.value for state in rows.IN_FORCE]
        in_force = sa.select(t.assignments).where(t.assignments.c.state.in_(states))
        left = [f"{row.vehicle} has {row.order_id}" for row in db.execute(in_force)]
        if left:
            text = "settle or withdraw it, or go on without --new-day"
            raise LeewayError(f"day {before} is not over: {', '.join(left)}: {text}")
        here = is_order_of(None), t.orders.c.state.in_(_CARRIED)
        left_over = sa.select(t.orders.c.id).where(*here).order_by(t.orders.c.n)
        carried = list(db.execute(left_over).scalars())
        now_us = max(epoch_us(), _newest_stamp_us(db) + 1)
        _archive(db, before)
        db.execute(sa.insert(t.days).values(day=day, began_us=now_us))
        if carried:
            insert_orders_of_current_day(db, carried)
        result = f"{len(carried)} orders carried over from {before}"
        result += f": {', '.join(carried)}" if carried else ""
        audit.add_entry(db, now_us, by, "begin_day", day, result)
    return f"day {day} begins, {result}"


def _newest_stamp_us(db: sa.Connection) -> int:
    stamps = (
        *(t.assignments.c.ended_us, t.commands.c.made_us, t.events.c.heard_us),
        *(t.visits.c.arrived_us, t.plans.c.made_us, t.orders.c.taken_us, t.flights.c.ended_us),
    )
    found = (db.execute(sa.select(sa.func.max(stamp))).scalar() for stamp in stamps)
    return max((stamp for stamp in found if stamp is not None), default=0)


def _archive(db: sa.Connection, day: str) -> None:
    for table, past in ((t.plans, t.past_plans), (t.visits, t.past_visits)):
        names = [column.name for column in table.columns]
        content = sa.select(sa.literal(day), *table.columns)
        db.execute(sa.insert(past).from_select(["day", *names], content))
        db.execute(sa.delete(table))
    start_us = about_value(db, DAY_START_KEY, int)
    for key in _KEYS_OF_A_DAY:
        replace_about_value(db, key, None)
    replace_about_value(db, day_start_key(day), start_us)
