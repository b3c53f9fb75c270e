"""Restore of a copy: all drones are held until their evidence is in the store again.

The copy lacks what happened after it. Members report it: their events are requested again, and
outcomes of assignments that the copy lacks are applied. Ids of a new epoch exclude that one of them
is issued again.
"""

from collections.abc import Callable, Iterable

import msgspec
import sqlalchemy as sa

from companion.fleet.messages import (
    CommandStatus,
    Drive,
    EventKind,
    FleetEvent,
    State,
    Withdraw,
)
from ground_station.adapters.store import about_steps, audit_steps, day_steps, hold_steps
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import (
    Database,
    StoreError,
    draw_epoch,
    store_schema_version,
)
from ground_station.core.schema.holds import ALL_DRONES
from ground_station.core.schema.orders import (
    IN_FORCE,
    ROOT_CHARS,
    AssignmentRow,
    AssignmentState,
    is_assignment_of_epochs_root,
)


class StoreHistory(msgspec.Struct, frozen=True):
    """What a store knows that a copy of it may lack: its epochs and its members."""

    epochs: list[str] = []
    members: list[str] = []


def read_history(url: str) -> StoreHistory | None:
    """Return the history of a store of any schema; None: this database contains no store."""
    try:
        database = Database(url, create=False, any_schema=True)
    except StoreError:
        return None
    try:
        with database.read() as db:
            return None if store_schema_version(db) is None else _history(db)
    finally:
        database.close()


def _history(db: sa.Connection) -> StoreHistory:
    vehicles = sa.union(sa.select(t.assignments.c.vehicle), sa.select(t.logs.c.vehicle))
    epochs = about_steps.about_value(db, t.EPOCHS_KEY, list[str]) or []
    return StoreHistory(epochs, sorted(db.execute(vehicles).scalars()))


def upgrade_and_hold_restored_store(
    url: str, now_us: int, backup_source: str, by: str, replaced: StoreHistory | None = None
) -> None:
    """Hold every drone, begin an epoch, void launches of the copy and record the restore in the
    audit, after the copy's last row. `replaced`: history of the store that the copy has replaced.

    A copy of an older schema is upgraded first.
    """
    from ground_station.adapters.store.upgrade import upgrade_schema  # a desk loads no Alembic

    database = Database(url, create=False, any_schema=True)
    try:
        upgrade_schema(database, now_us, by)
        with database.write() as db:
            _begin_epoch(db, replaced or StoreHistory())
            hold_steps.insert_hold(db, now_us, ALL_DRONES, f"restored from {backup_source}", by)
            audit_steps.add_entry(
                db, now_us, by, "restore", database.shown_url, f"from {backup_source}"
            )
    finally:
        database.close()


def _begin_epoch(db: sa.Connection, replaced: StoreHistory) -> None:
    copied = _history(db)
    epochs = copied.epochs or replaced.epochs
    epochs += [one for one in replaced.epochs if one[:ROOT_CHARS] == epochs[0][:ROOT_CHARS]]
    value = [*dict.fromkeys(epochs), draw_epoch(epochs)]
    about_steps.replace_about_value(db, t.EPOCHS_KEY, value)
    launches = t.commands.c.id.contains(":launch"), t.commands.c.answer.is_(None)
    void = {"answer": CommandStatus.EXPIRED.value, "reason": "the store was restored"}
    db.execute(sa.update(t.commands).where(*launches).values(**void))
    members = dict.fromkeys([*copied.members, *replaced.members], NOT_REPORTED)
    hold_steps.write_restore_record(db, hold_steps.RestoreRecord(missing=members))


NOT_REPORTED, RESTORED_BY = "has not reported", "desk"


def open_restore(database: Database) -> hold_steps.RestoreRecord | None:
    """Return the record of a restore that is not settled; None: there is none."""
    with database.read() as db:
        return hold_steps.restore_record(db)


def require_evidence_of_members(database: Database, members: Iterable[str]) -> None:
    """Require the evidence of these members of the day, too, if a restore is open."""
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        record = hold_steps.restore_record(db)
        if record is not None:
            new = set(members) - set(record.settled)
            record.missing = dict.fromkeys(new, NOT_REPORTED) | record.missing
            hold_steps.write_restore_record(db, record)


def record_evidence(database: Database, missing: dict[str, str], settled: list[str]) -> bool:
    """Record which evidence is missing and which members are settled; whether the restore is."""
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        record = hold_steps.restore_record(db)
        if record is None:
            return False
        for name in settled:
            if record.missing.pop(name, None) is not None:
                record.settled.append(name)
        record.missing |= {name: why for name, why in missing.items() if name in record.missing}
        hold_steps.write_restore_record(db, record if record.missing else None)
        return not record.missing


def withdraw_unknown_assignment(
    database: Database, now_us: int, assignment: str, vehicle: str
) -> None:
    """Withdraw an assignment that the store does not know from its vehicle, once."""
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        if not rows.count_commands_with_id_prefix(db, f"{assignment}:unknown"):
            id_ = f"{assignment}:unknown"
            action = Withdraw(assignment=assignment)
            rows.enqueue_command(db, now_us, id_, vehicle, None, action, "desk")


def record_reported_truck_stop(database: Database, now_us: int, state: State) -> None:
    """Record the truck's stop, or the one to which it drives, as ordered: the copy may lack it."""
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        if state.stop is None or state.stop == day_steps.last_ordered_truck_stop(db):
            return
        here = {"lat_deg": state.lat_deg or 0.0, "lon_deg": state.lon_deg or 0.0}
        number = rows.count_commands_with_id_prefix(db, "drive-") + 1
        id_, action = f"drive-{number}", Drive(stop=state.stop, **here)
        rows.enqueue_command(db, now_us, id_, state.vehicle, None, action, RESTORED_BY)
        done = {"answer": CommandStatus.DONE.value, "reason": "reported after the restore"}
        newest = sa.select(sa.func.max(t.commands.c.n)).scalar_subquery()
        db.execute(sa.update(t.commands).where(t.commands.c.n == newest).values(**done))


def apply_stored_outcomes(database: Database, epoch_us: Callable[[], int]) -> None:
    """Apply the outcomes in the store that its assignments do not show: of assignments that the
    store does not know, or that are in force.
    """
    over = sa.select(t.assignments.c.id).where(
        t.assignments.c.state.not_in([state.value for state in IN_FORCE])
    )
    query = sa.select(t.events.c.content).where(
        t.events.c.kind == EventKind.OUTCOME.value, t.events.c.assignment.not_in(over)
    )
    with database.write() as db:
        for content in db.execute(query.order_by(t.events.c.n)).scalars().all():
            event = msgspec.json.decode(content, type=FleetEvent)
            if event.outcome:
                apply_outcome(db, epoch_us(), event)


def apply_outcome(db: sa.Connection, now_us: int, event: FleetEvent) -> None:
    """End a flight of this store, also one that it issued in a lost epoch."""
    lost_row = insert_assignment_of_lost_epoch(db, now_us, event)
    rows.apply_flight_outcome_event(db, now_us, event, lost_row)


def insert_assignment_of_lost_epoch(
    db: sa.Connection, now_us: int, event: FleetEvent
) -> AssignmentRow | None:
    """Insert an assignment that the store issued after the copy from which it was restored; other
    assignments of its order are withdrawn. None: it is known, or of another store.
    """
    id_, order_id, epoch = event.assignment or "", event.order or "", about_steps.store_epoch(db)
    known = db.execute(sa.select(t.assignments.c.n).where(t.assignments.c.id == id_)).first()
    order = db.execute(sa.select(t.orders).where(t.orders.c.id == order_id).with_for_update())
    if known or order.first() is None or not is_assignment_of_epochs_root(id_, order_id, epoch):
        return None
    if event.delivered or event.drop_unproven or not event.home:
        _withdraw_other_assignments(db, now_us, order_id)
    rows.insert_assignment(db, now_us, id_, order_id, event.vehicle, state=AssignmentState.RETURNED)
    return AssignmentRow(
        id_, order_id, event.vehicle, AssignmentState.RETURNED, delivered=False, reason=""
    )


def _withdraw_other_assignments(db: sa.Connection, now_us: int, order_id: str) -> None:
    not_started = (AssignmentState.ORDERED, AssignmentState.UPLOADED, AssignmentState.WITHDRAWING)
    ids = sa.select(t.assignments.c.id).where(t.assignments.c.order_id == order_id)
    for id_ in db.execute(ids).scalars().all():
        row = rows.lock_assignment_if_in_states(db, id_, not_started)
        if row is not None:
            reason_text = "flown by another drone before the restore"
            rows.end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, reason_text)
            action = Withdraw(assignment=row.id)
            new_id = f"{row.id}:superseded"
            rows.enqueue_command(db, now_us, new_id, row.vehicle, None, action, "desk")
