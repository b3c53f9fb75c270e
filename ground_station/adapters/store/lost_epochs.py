"""Outcomes of assignments that a restored store does not know."""

import sqlalchemy as sa

from companion.fleet.messages import FleetEvent, Withdraw
from ground_station.adapters.store import epoch_steps as epochs
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.core.schema.orders import (
    AssignmentRow,
    AssignmentState,
    is_assignment_of_epochs_root,
)


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
    id_, order_id, epoch = event.assignment or "", event.order or "", epochs.store_epoch(db)
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
