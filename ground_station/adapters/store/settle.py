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
from ground_station.core.schema.order_states import OrderState, Settled
from ground_station.core.schema.orders import (
    IN_FORCE,
    AssignmentRow,
    AssignmentState,
    settled_as,
)

SETTLED_FROM = (OrderState.ASSIGNED, OrderState.STUCK)


def settle(
    database: Database,
    epoch_us: Callable[[], int],
    order_id: str,
    settled: Settled,
    reason: str,
    by: str,
) -> str | None:
    """Close an order by a person's word; what was done, in words.

    None: it is not assigned and not stuck. A drone that is lost is held, so that nobody launches
    it, should it turn up, before somebody has looked at it.
    """
    now_us, why = epoch_us(), f"{settled.value}, says {by}: {reason}"
    with database.write() as db:
        rows.lock(db)
        states = [state.value for state in SETTLED_FROM]
        here = t.orders.c.id == order_id
        if (
            db.execute(sa.select(t.orders.c.n).where(here, t.orders.c.state.in_(states))).first()
            is None
        ):
            return None
        row = _in_force(db, order_id)
        done = "" if row is None else f"; {_end(db, now_us, row, settled, why, by)}"
        order = settled_as(settled)[1]
        db.execute(sa.update(t.orders).where(here).values(state=order.value, why=why, attempts=0))
        audit.note(db, now_us, by, "settle", order_id, f"{why}{done}")
    return f"{order_id}: {order.value}{done}"


def _in_force(db: sa.Connection, order_id: str) -> AssignmentRow | None:
    states = [state.value for state in IN_FORCE]
    found = db.execute(
        sa.select(t.assignments).where(
            t.assignments.c.order_id == order_id, t.assignments.c.state.in_(states)
        )
    ).one_or_none()
    return None if found is None else rows.assignment_row(found)


def _end(
    db: sa.Connection, now_us: int, row: AssignmentRow, settled: Settled, why: str, by: str
) -> str:
    """End its assignment; what has become of the vehicle, in words."""
    state = settled_as(settled)[0]
    delivered = state is AssignmentState.DELIVERED
    rows.end_assignment(db, now_us, row, state, delivered, why)
    if row.state is not AssignmentState.FLYING:  # the mission may still be aboard
        deed = Withdraw(assignment=row.id)
        rows.put_out(db, now_us, f"{row.id}:settled", row.vehicle, None, deed, by)
    if settled is not Settled.LOST or row.vehicle == TRUCK:
        return f"{row.vehicle} is free"
    holds.set_hold(db, now_us, row.vehicle, f"lost with {row.id}", by)
    return f"{row.vehicle} is out of service: held until it is released"
