"""Steps for launch holds; each runs inside the caller's transaction."""

import sqlalchemy as sa

from ground_station.adapters.store import tables as t
from ground_station.core.schema.holds import Hold, hold_of_vehicle_or_of_all


def read_holds_in_force(db: sa.Connection) -> list[Hold]:
    """Return the holds in force, oldest first."""
    query = (
        sa.select(t.hold_table).where(t.hold_table.c.lifted_us.is_(None)).order_by(t.hold_table.c.n)
    )
    return [Hold(row.scope, row.reason, row.set_by, row.set_us) for row in db.execute(query)]


def hold_on(db: sa.Connection, vehicle: str) -> Hold | None:
    """Return the hold on a vehicle. The caller has the lock, so the result stays valid."""
    return hold_of_vehicle_or_of_all(read_holds_in_force(db), vehicle)


def insert_hold(db: sa.Connection, now_us: int, scope: str, reason: str, by: str) -> None:
    """Place a hold on a vehicle or on all, in addition to existing holds."""
    db.execute(sa.insert(t.hold_table).values(scope=scope, reason=reason, set_by=by, set_us=now_us))


def clear_holds_of_scope(
    db: sa.Connection, now_us: int, scope: str, by: str, *, only_placed_by_actor: bool = False
) -> list[Hold]:
    """Clear every hold of this scope (`only_placed_by_actor`: only those that `by` placed); returns
    the cleared holds.
    """
    lifted = [
        h
        for h in read_holds_in_force(db)
        if h.scope == scope and not (only_placed_by_actor and h.by != by)
    ]
    which = (t.hold_table.c.scope == scope) & t.hold_table.c.lifted_us.is_(None)
    if only_placed_by_actor:
        which &= t.hold_table.c.set_by == by
    db.execute(sa.update(t.hold_table).where(which).values(lifted_by=by, lifted_us=now_us))
    return lifted
