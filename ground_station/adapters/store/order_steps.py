"""Steps of the store's transactions; each runs inside the caller's transaction."""

from functools import lru_cache
from operator import attrgetter
from typing import Any

import msgspec
import sqlalchemy as sa

from companion.fleet.messages import (
    Assign,
    CommandAction,
    CommandStatus,
    FleetEvent,
    Launch,
    MoveHome,
    PutOut,
    Serve,
    Withdraw,
)
from ground_station.adapters.store import about_steps as about
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import tables as t
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.order_states import CLOSED
from ground_station.core.schema.orders import (
    IN_FORCE,
    OVERRIDE_OUTCOME,
    AssignmentRow,
    AssignmentState,
    CommandRow,
    OrderState,
    assignment_id,
    final_assignment_state,
    order_state_after_assignment,
)

_CLOSED_ORDER_STATES = tuple(state.value for state in CLOSED)


def lock_dispatch_decisions(db: sa.Connection) -> None:
    """Serialise transactions that decide on launches, holds and the truck's route (PostgreSQL;
    SQLite has one writer anyway). Must be the first lock of its transaction.
    """
    db.execute(sa.select(t.about).where(t.about.c.name == "schema").with_for_update()).one()


def assign_order(db: sa.Connection, order_id: str) -> str | None:
    """Assign an open order; returns the new assignment's id, None if the order is not open."""
    updated = db.execute(
        sa.update(t.orders)
        .where(t.orders.c.id == order_id, t.orders.c.state == OrderState.OPEN.value)
        .values(state=OrderState.ASSIGNED.value, attempts=t.orders.c.attempts + 1, why="")
    )
    if updated.rowcount != 1:
        return None
    attempt = db.execute(
        sa.select(sa.func.count()).where(t.assignments.c.order_id == order_id)
    ).scalar_one()
    return assignment_id(order_id, about.store_epoch(db), attempt + 1)


def insert_assignment(
    db: sa.Connection,
    now_us: int,
    id_: str,
    order_id: str,
    vehicle: str,
    layer: int | None = None,
    state: AssignmentState = AssignmentState.ORDERED,
) -> None:
    """Insert an assignment. IntegrityError if drone or layer has another one in force."""
    db.execute(
        sa.insert(t.assignments).values(
            id=id_,
            order_id=order_id,
            vehicle=vehicle,
            state=state.value,
            delivered=False,
            why="",
            made_us=now_us,
            layer=layer,
        )
    )


def enqueue_command(
    db: sa.Connection,
    now_us: int,
    command_id: str,
    vehicle: str,
    assignment: str | None,
    action: CommandAction,
    by: str,
    *,
    withheld: bool = False,
    is_random_id: bool = False,
) -> None:
    """Put a command into the outbox; `withheld`: withheld until it is released. Its id gets the
    store's epoch unless it `is_random_id`.
    """
    command_id = command_id if is_random_id else about.id_in_epoch(db, command_id)
    db.execute(
        sa.insert(t.commands).values(
            id=command_id,
            vehicle=vehicle,
            assignment=assignment,
            deed=msgspec.json.encode(action),
            said_by=by,
            held=withheld,
            reason="",
            made_us=now_us,
        )
    )
    response = "held back" if withheld else "in the outbox"
    audit.add_entry(db, now_us, by, action_name(action), f"{vehicle}: {command_id}", response)


def action_name(action: CommandAction) -> str:
    """Return the name of a command type, as messages contain it."""
    return str(action.__struct_config__.tag)


def lock_assignment_if_in_states(
    db: sa.Connection, id_: str, states: tuple[AssignmentState, ...]
) -> AssignmentRow | None:
    """Return the assignment, locked until the transaction ends, if it is in one of these states."""
    row = db.execute(
        sa.select(t.assignments)
        .where(
            t.assignments.c.id == id_,
            t.assignments.c.state.in_([state.value for state in states]),
        )
        .with_for_update()
    ).one_or_none()
    return None if row is None else assignment_from_database_row(row)


def assignment_in_force(db: sa.Connection, order_id: str) -> AssignmentRow | None:
    """Return the assignment in force of an order."""
    states = [state.value for state in IN_FORCE]
    here = t.assignments.c.order_id == order_id, t.assignments.c.state.in_(states)
    found = db.execute(sa.select(t.assignments).where(*here)).one_or_none()
    return None if found is None else assignment_from_database_row(found)


def set_assignment_state(
    db: sa.Connection, id_: str, state: AssignmentState, reason_text: str
) -> None:
    """Set the state of an assignment."""
    db.execute(
        sa.update(t.assignments)
        .where(t.assignments.c.id == id_)
        .values(state=state.value, why=reason_text)
    )


def has_unanswered_command(db: sa.Connection, assignment: str) -> bool:
    """Return whether a command of an assignment waits for its response."""
    waiting = sa.select(sa.func.count()).where(
        t.commands.c.assignment == assignment, t.commands.c.answer.is_(None)
    )
    return db.execute(waiting).scalar_one() > 0


def count_commands_with_id_prefix(db: sa.Connection, prefix: str) -> int:
    """Return the number of commands with this id prefix."""
    count_query = sa.select(sa.func.count()).where(
        t.commands.c.id.startswith(prefix, autoescape=True)
    )
    return db.execute(count_query).scalar_one()


def newest_launch(db: sa.Connection) -> int:
    """Return the number of the newest launch command of any desk; 0 without one."""
    launches = t.commands.c.id.contains(":launch")
    return db.execute(sa.select(sa.func.max(t.commands.c.n)).where(launches)).scalar() or 0


def pending_response_condition() -> sa.ColumnElement[bool]:
    """Select commands without a response of their vehicle: of sent launches also those that were
    voided here, since the vehicle may still carry them out.
    """
    left = t.commands.c.sent.is_(True) & t.commands.c.life.is_(None)
    return t.commands.c.answer.is_(None) | left


def newest_unanswered_launch(db: sa.Connection, assignment: str) -> CommandRow | None:
    """Return the newest launch of an assignment that was sent without a vehicle response."""
    query = sa.select(t.commands).where(
        t.commands.c.assignment == assignment,
        t.commands.c.id.contains(":launch"),
        t.commands.c.sent.is_(True),
        pending_response_condition(),
    )
    row = db.execute(query.order_by(t.commands.c.n.desc()).limit(1)).one_or_none()
    return None if row is None else command_from_database_row(row)


def record_and_apply_executed_launch(
    db: sa.Connection, now_us: int, launch: CommandRow, instance_id: str
) -> None:
    """Record that a launch was carried out, as its vehicle's state shows."""
    reason = "seen in flight"
    values = {
        "answer": CommandStatus.DONE.value,
        "reason": reason,
        "life": instance_id,
        "answered_us": now_us,
    }
    db.execute(sa.update(t.commands).where(t.commands.c.id == launch.id).values(**values))
    apply_response_to_assignment(db, now_us, launch, CommandStatus.DONE, reason)


def set_launch_confirmation(db: sa.Connection, assignment: str, by: str | None) -> None:
    """Record the person who confirms one launch of an assignment; None clears it."""
    here = t.assignments.c.id == assignment
    db.execute(sa.update(t.assignments).where(here).values(confirmed_by=by))


def end_assignment(
    db: sa.Connection,
    now_us: int,
    row: AssignmentRow,
    state: AssignmentState,
    delivered: bool,
    reason_text: str,
    *,
    waits_for_person: bool = False,
) -> None:
    """End an assignment: its order changes state, and its unanswered commands become void.

    `waits_for_person`: a person decides whether it is delivered again.
    """
    db.execute(
        sa.update(t.assignments)
        .where(t.assignments.c.id == row.id)
        .values(state=state.value, delivered=delivered, why=reason_text, ended_us=now_us)
    )
    db.execute(
        sa.update(t.commands)
        .where(t.commands.c.assignment == row.id, t.commands.c.answer.is_(None))
        .values(answer=CommandStatus.REFUSED.value, reason="the assignment is over")
    )
    db.execute(
        sa.update(t.sorties).where(t.sorties.c.assignment == row.id).values(landed_us=now_us)
    )
    attempts = db.execute(
        sa.select(t.orders.c.attempts).where(t.orders.c.id == row.order_id)
    ).scalar_one()
    order = order_state_after_assignment(state, delivered, attempts, waits_for_person)
    db.execute(
        sa.update(t.orders)
        .where(
            t.orders.c.id == row.order_id,
            t.orders.c.state != OrderState.DELIVERED.value
            if order is OrderState.DELIVERED  # also if it was cancelled too late
            else t.orders.c.state.not_in(_CLOSED_ORDER_STATES) & ~_other_assignment_in_force(row),
        )
        .values(state=order.value, why=reason_text)
    )


def _other_assignment_in_force(row: AssignmentRow) -> sa.ColumnElement[bool]:
    others = sa.select(t.assignments.c.n).where(
        t.assignments.c.order_id == row.order_id,
        t.assignments.c.id != row.id,
        t.assignments.c.state.in_([state.value for state in IN_FORCE]),
    )
    return others.exists()


def apply_flight_outcome_event(
    db: sa.Connection, now_us: int, event: FleetEvent, lost_row: AssignmentRow | None = None
) -> None:
    """End a flight. Only the vehicle that has the assignment can end it, and only once.

    `lost_row`: its assignment, if the store issued it after the copy from which it was restored.
    """
    row = lost_row or lock_assignment_if_in_states(db, event.assignment or "", IN_FORCE)
    if row is None or row.vehicle != event.vehicle:
        return
    delivered = bool(event.delivered)
    state = final_assignment_state(event.outcome or "FAIL", delivered, bool(event.home))
    unproven = bool(event.drop_unproven)
    reason_text = (
        f"{event.outcome}: {'drop not proven, look for the parcel; ' * unproven}{event.text}"
    )
    updated = event.outcome == OVERRIDE_OUTCOME
    waits = unproven or updated or row.vehicle == TRUCK  # the driver has met no customer
    end_assignment(db, now_us, row, state, delivered, reason_text, waits_for_person=waits)
    if updated:  # the truck does not wait: the pilot who landed it has it
        here = t.sorties.c.assignment == row.id
        db.execute(sa.update(t.sorties).where(here).values(away=True))


def apply_response_to_assignment(
    db: sa.Connection, now_us: int, command: CommandRow, response: CommandStatus, reason: str
) -> None:
    """Apply the response to a command to its assignment."""
    row = lock_assignment_if_in_states(db, command.assignment or "", IN_FORCE)
    if row is None:
        return
    withdrawing = row.state is AssignmentState.WITHDRAWING
    match command.command, response:
        case ((Assign() | Serve()), CommandStatus.REFUSED):
            end_assignment(db, now_us, row, AssignmentState.REFUSED, False, reason)
        case ((Assign() | Serve()), _) if not withdrawing:
            set_assignment_state(db, row.id, AssignmentState.UPLOADED, reason)
        case PutOut(), CommandStatus.REFUSED:
            end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, reason)
        case Launch(), CommandStatus.DONE | CommandStatus.INTERRUPTED:
            set_assignment_state(db, row.id, AssignmentState.IN_FLIGHT, reason)
            here = (t.sorties.c.assignment == row.id, t.sorties.c.launched_us.is_(None))
            db.execute(sa.update(t.sorties).where(*here).values(launched_us=now_us))
        case Launch(), CommandStatus.REFUSED | CommandStatus.EXPIRED if (
            row.state is not AssignmentState.IN_FLIGHT
        ):
            reason_text = f"launch {response.value}: {reason}"
            set_assignment_state(db, row.id, AssignmentState.UPLOADED, reason_text)
        case MoveHome(), CommandStatus.REFUSED | CommandStatus.INTERRUPTED:
            here = (t.sorties.c.assignment == row.id, t.sorties.c.asked == command.command.home)
            db.execute(sa.update(t.sorties).where(*here).values(asked=None))
        case Withdraw(), _ if (
            command.vehicle != row.vehicle or command.command.assignment != row.id
        ):
            return
        case Withdraw(), CommandStatus.DONE:
            reason_text = row.reason or reason  # the desk's own reason, if it gave one
            end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, reason_text)
        case Withdraw(), CommandStatus.REFUSED | CommandStatus.INTERRUPTED:
            set_assignment_state(db, row.id, AssignmentState.IN_FLIGHT, f"not withdrawn: {reason}")
        case _:
            return


def assignment_from_database_row(database_row: Any) -> AssignmentRow:
    """Convert a database row to the core's type."""
    return _cached_assignment_row(_ASSIGNMENT_COLUMNS(database_row))


_ASSIGNMENT_COLUMNS = attrgetter(
    "id", "order_id", "vehicle", "state", "delivered", "why", "confirmed_by", "layer"
)


@lru_cache(maxsize=20_000)
def _cached_assignment_row(column_values: tuple[Any, ...]) -> AssignmentRow:
    """Cached: a desk reads assignments in force several times per second, and few change."""
    id_, order_id, vehicle, state, *others = column_values
    return AssignmentRow(id_, order_id, vehicle, AssignmentState(state), *others)


def command_from_database_row(database_row: Any) -> CommandRow:
    """Convert a database row to the core's type."""
    return CommandRow(
        database_row.id,
        database_row.vehicle,
        database_row.assignment,
        msgspec.json.decode(database_row.deed, type=CommandAction),
        database_row.said_by,
        None if database_row.answer is None else CommandStatus(database_row.answer),
        database_row.reason,
        database_row.life,
        database_row.made_us,
    )
