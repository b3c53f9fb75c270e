"""Steps about holds; each gets the transaction that it is part of."""

import sqlalchemy as sa

from ground_station.adapters.store import tables as t
from ground_station.core.schema.holds import Hold, holding


def in_force(db: sa.Connection) -> list[Hold]:
    """The holds in force, oldest first."""
    query = sa.select(t.holds).where(t.holds.c.lifted_us.is_(None)).order_by(t.holds.c.n)
    return [Hold(row.scope, row.reason, row.set_by, row.set_us) for row in db.execute(query)]


def hold_of(db: sa.Connection, vehicle: str) -> Hold | None:
    """The hold that a vehicle is under. The caller has the lock, so it stays so."""
    return holding(in_force(db), vehicle)


def set_hold(db: sa.Connection, now_us: int, scope: str, reason: str, by: str) -> None:
    """Put a vehicle, or all, under a hold, beside those that it is under."""
    db.execute(sa.insert(t.holds).values(scope=scope, reason=reason, set_by=by, set_us=now_us))


def lift(
    db: sa.Connection, now_us: int, scope: str, by: str, *, only_own: bool = False
) -> list[Hold]:
    """Lift every hold of this scope (`only_own`: of those that `by` set); returns those that were
    in force.
    """
    lifted = [h for h in in_force(db) if h.scope == scope and not (only_own and h.by != by)]
    which = (t.holds.c.scope == scope) & t.holds.c.lifted_us.is_(None)
    if only_own:
        which &= t.holds.c.set_by == by
    db.execute(sa.update(t.holds).where(which).values(lifted_by=by, lifted_us=now_us))
    return lifted
