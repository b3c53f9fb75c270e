"""Steps for launch holds; each runs inside the caller's transaction."""

import msgspec
import sqlalchemy as sa

from ground_station.adapters.store import tables as t
from ground_station.adapters.store.about_steps import about_value, replace_about_value
from ground_station.core.schema.holds import ALL_DRONES, Hold, hold_of_vehicle_or_of_all

RESTORED_KEY = "restored"
RESTORE_SOURCE = "store restore"


class RestoreRecord(msgspec.Struct):
    """Members whose evidence a restored store lacks, with the reason, and those that it has."""

    missing: dict[str, str]
    settled: list[str] = []


def restore_record(db: sa.Connection) -> RestoreRecord | None:
    """Return the record of a restore that is not settled; None: there is none."""
    return about_value(db, RESTORED_KEY, RestoreRecord)


def write_restore_record(db: sa.Connection, record: RestoreRecord | None) -> None:
    """Replace the record of the restore; None: it is settled."""
    replace_about_value(db, RESTORED_KEY, record)


def hold_after_restore(db: sa.Connection) -> Hold | None:
    """Return the hold on all drones that ends when the evidence of each member is in the store."""
    record = restore_record(db)
    if record is None:
        return None
    texts = [f"{name} {reason}" for name, reason in sorted(record.missing.items())]
    waiting = "; ".join(texts) or "no desk has run since"
    remedy = "a member that cannot report: check it, then ground-station release NAME"
    return Hold(ALL_DRONES, f"restored: {waiting}; {remedy}", RESTORE_SOURCE, 0)


def read_holds_in_force(db: sa.Connection) -> list[Hold]:
    """Return the holds in force, oldest first, and the one that a restore places."""
    restored = hold_after_restore(db)
    return [*_read_placed_holds(db), *([restored] if restored else [])]


def _read_placed_holds(db: sa.Connection) -> list[Hold]:
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
        for h in _read_placed_holds(db)
        if h.scope == scope and not (only_placed_by_actor and h.by != by)
    ]
    record = restore_record(db)
    if record is not None and scope in record.missing and not only_placed_by_actor:
        reason = f"restored: {record.missing.pop(scope)}"
        record.settled.append(scope)
        write_restore_record(db, record)
        lifted.append(Hold(scope, reason, RESTORE_SOURCE, now_us))
    which = (t.hold_table.c.scope == scope) & t.hold_table.c.lifted_us.is_(None)
    if only_placed_by_actor:
        which &= t.hold_table.c.set_by == by
    db.execute(sa.update(t.hold_table).where(which).values(lifted_by=by, lifted_us=now_us))
    return lifted
