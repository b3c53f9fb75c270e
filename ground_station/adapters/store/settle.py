"""A person's word that closes an order, and all that hangs on it, in one transaction."""

from collections.abc import Callable

import sqlalchemy as sa

from companion.fleet.messages import Withdraw
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import hold_steps as holds
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.order_states import OrderState, ParcelOutcome
from ground_station.core.schema.orders import (
    AssignmentRow,
    AssignmentState,
    assignment_and_order_state_after_outcome,
)

SETTLED_FROM = (
    *(OrderState.ASSIGNED, OrderState.STUCK),
    *(OrderState.CANCELLED, OrderState.RETURNED),
)


def close_order_with_outcome(
    database: Database,
    epoch_us: Callable[[], int],
    order_id: str,
    parcel_outcome: ParcelOutcome,
    reason: str,
    by: str,
) -> str | None:
    """Close an order by a person's word; what was done, in words.

    None: it is open, delivered or unknown. A lost drone is held: if it is found, a person inspects
    it before its next launch.
    """
    now_us, state_reason = epoch_us(), f"{parcel_outcome.value}, says {by}: {reason}"
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        states = [state.value for state in SETTLED_FROM]
        here = t.orders.c.id == order_id
        if (
            db.execute(sa.select(t.orders.c.n).where(here, t.orders.c.state.in_(states))).first()
            is None
        ):
            return None
        row = rows.assignment_in_force(db, order_id)
        done = (
            ""
            if row is None
            else f"; {_end_settled_assignment(db, now_us, row, parcel_outcome, state_reason, by)}"
        )
        order = assignment_and_order_state_after_outcome(parcel_outcome)[1]
        db.execute(
            sa.update(t.orders).where(here).values(state=order.value, why=state_reason, attempts=0)
        )
        audit.add_entry(db, now_us, by, "settle", order_id, f"{state_reason}{done}")
    return f"{order_id}: {order.value}{done}"


def _end_settled_assignment(
    db: sa.Connection,
    now_us: int,
    row: AssignmentRow,
    parcel_outcome: ParcelOutcome,
    state_reason: str,
    by: str,
) -> str:
    """End its assignment; what has become of the vehicle, in words."""
    state = assignment_and_order_state_after_outcome(parcel_outcome)[0]
    delivered = state is AssignmentState.DELIVERED
    rows.end_assignment(db, now_us, row, state, delivered, state_reason)
    if row.state is not AssignmentState.IN_FLIGHT:  # the mission may still be aboard
        deed = Withdraw(assignment=row.id)
        rows.enqueue_command(db, now_us, f"{row.id}:settled", row.vehicle, None, deed, by)
    if parcel_outcome is not ParcelOutcome.LOST or row.vehicle == TRUCK:
        return f"{row.vehicle} is free"
    holds.insert_hold(db, now_us, row.vehicle, f"lost with {row.id}", by)
    return f"{row.vehicle} is out of service: held until it is released"
