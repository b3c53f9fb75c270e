"""A person's change of an order, with the withdrawal that it needs, in one transaction."""

from collections.abc import Callable

import msgspec
import sqlalchemy as sa

from companion.core.base.errors import LeewayError
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import day_steps
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.core.schema.order_changes import (
    FLIGHT,
    OrderStage,
    cancel_refusal,
    change_refusal,
    change_text,
    changed_fields,
    order_stage,
)
from ground_station.core.schema.order_states import OrderState
from ground_station.core.schema.orders import AssignmentRow, Order

CHANGE, PROOF = "change", "proof"
"""Actions in the audit."""


def change_order(
    database: Database,
    epoch_us: Callable[[], int],
    order_id: str,
    changed_order: Callable[[Order], Order],
    by: str,
) -> str:
    """Change an order and record it; returns what was done, as text. Raises LeewayError with the
    reason of a refusal. `changed_order(order)` returns the new content.

    A changed destination or mass withdraws an assignment on the ground: the order is then open.
    """
    with database.write() as db:
        row, assignment, stage = lock_order(db, order_id)
        before = msgspec.json.decode(row.content, type=Order)
        after = changed_order(before)
        fields = changed_fields(before, after)
        if not fields:
            return f"{order_id}: nothing to change"
        if refusal := change_refusal(stage, fields):
            raise LeewayError(f"order {order_id}: {refusal}")
        content = msgspec.json.encode(after).decode()
        db.execute(sa.update(t.orders).where(t.orders.c.id == order_id).values(content=content))
        text = change_text(before, after)
        audit.add_entry(db, epoch_us(), by, CHANGE, order_id, text)
        if assignment is not None and stage is OrderStage.ON_GROUND and fields & FLIGHT:
            reason = f"the order was changed by {by}"
            day_steps.withdraw_before_launch(db, epoch_us(), assignment, by, reason)
            return f"{order_id}: {text}; {assignment.vehicle}: {assignment.id} withdrawn"
        if stage is OrderStage.STUCK:
            text += f"; stuck: `ground-station order settle {order_id}` closes or reopens it"
        return f"{order_id}: {text}"


def cancel_order(
    database: Database,
    epoch_us: Callable[[], int],
    order_id: str,
    by: str,
    reason: str,
    state: OrderState = OrderState.CANCELLED,
) -> str:
    """Cancel an order (`state`: or return it to its sender) and record it; returns what was done,
    as text. Raises LeewayError with the reason of a refusal. Withdraws an assignment on the ground.
    """
    with database.write() as db:
        _, assignment, stage = lock_order(db, order_id)
        if refusal := cancel_refusal(stage, assignment and assignment.vehicle):
            raise LeewayError(f"order {order_id}: {refusal}")
        values = {"state": state.value, "why": f"{reason}, by {by}", "attempts": 0}
        db.execute(sa.update(t.orders).where(t.orders.c.id == order_id).values(values))
        audit.add_entry(db, epoch_us(), by, "order", order_id, f"{state.value}: {reason}")
        if assignment is None:
            return f"{order_id}: {state.value}"
        if stage is OrderStage.ON_GROUND:
            text = f"the order was {state.value} by {by}"
            day_steps.withdraw_before_launch(db, epoch_us(), assignment, by, text)
        return f"{order_id}: {state.value}, withdrawn from {assignment.vehicle}"


def lock_order(
    db: sa.Connection, order_id: str
) -> "tuple[sa.Row, AssignmentRow | None, OrderStage]":
    """Return an order's row, its assignment in force and its stage. LeewayError: not known."""
    rows.lock_dispatch_decisions(db)
    row = db.execute(sa.select(t.orders).where(t.orders.c.id == order_id)).one_or_none()
    if row is None:
        raise LeewayError(f"order {order_id}: not known")
    assignment = rows.assignment_in_force(db, order_id)
    launch_ordered = assignment is not None and (
        day_steps.is_launch_unanswered(db, assignment.id)
        or rows.newest_unanswered_launch(db, assignment.id) is not None
    )
    state = OrderState(row.state)
    stage = order_stage(state, assignment and assignment.state, launch_ordered=launch_ordered)
    return row, assignment, stage


def changed_order_ids(db: sa.Connection) -> set[str]:
    """Return the orders that a person has changed: a file's older content does not replace them."""
    query = sa.select(t.audit.c.subject).where(t.audit.c.deed == CHANGE)
    return set(db.execute(query).scalars())
