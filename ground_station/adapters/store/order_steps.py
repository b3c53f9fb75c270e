"""Steps of the store's transactions; each gets the transaction that it is part of."""

from functools import lru_cache
from typing import Any

import msgspec
import sqlalchemy as sa

from companion.fleet.messages import (
    Answered,
    Assign,
    Deed,
    EventKind,
    FleetEvent,
    Launch,
    MoveHome,
    PutOut,
    Serve,
    Withdraw,
)
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import tables as t
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.orders import (
    IN_FORCE,
    TAKEN,
    AssignmentRow,
    AssignmentState,
    CommandRow,
    OrderState,
    assignment_id,
    ends_as,
    order_after,
)


def lock(db: sa.Connection) -> None:
    """One transaction at a time decides who is launched, who is held, where the truck goes
    (PostgreSQL; SQLite has one writer anyway). It is the first lock of whoever takes it.
    """
    db.execute(sa.select(t.about).where(t.about.c.name == "schema").with_for_update()).one()


def order_taken(db: sa.Connection, order_id: str) -> str | None:
    """Take an open order; the id of the assignment to be made, None: the order is not open."""
    taken = db.execute(
        sa.update(t.orders)
        .where(t.orders.c.id == order_id, t.orders.c.state == OrderState.OPEN.value)
        .values(state=OrderState.ASSIGNED.value, attempts=t.orders.c.attempts + 1, why="")
    )
    if taken.rowcount != 1:
        return None
    attempt = db.execute(
        sa.select(sa.func.count()).where(t.assignments.c.order_id == order_id)
    ).scalar_one()
    return assignment_id(order_id, attempt + 1)


def make_assignment(
    db: sa.Connection,
    now_us: int,
    id_: str,
    order_id: str,
    vehicle: str,
    layer: int | None = None,
) -> None:
    """Insert an assignment. IntegrityError: drone or layer has another one in force."""
    db.execute(
        sa.insert(t.assignments).values(
            id=id_,
            order_id=order_id,
            vehicle=vehicle,
            state=AssignmentState.ORDERED.value,
            delivered=False,
            why="",
            made_us=now_us,
            layer=layer,
        )
    )


def put_out(
    db: sa.Connection,
    now_us: int,
    id_: str,
    vehicle: str,
    assignment: str | None,
    deed: Deed,
    by: str,
    *,
    held: bool = False,
) -> None:
    """Put a command into the outbox; `held`: not to be sent before it is released."""
    db.execute(
        sa.insert(t.commands).values(
            id=id_,
            vehicle=vehicle,
            assignment=assignment,
            deed=msgspec.json.encode(deed),
            said_by=by,
            held=held,
            reason="",
            made_us=now_us,
        )
    )
    answer = "held back" if held else "in the outbox"
    audit.note(db, now_us, by, deed_word(deed), f"{vehicle}: {id_}", answer)


def deed_word(deed: Deed) -> str:
    """The name of a deed, as messages have it."""
    return str(deed.__struct_config__.tag)


def in_state(
    db: sa.Connection, id_: str, states: tuple[AssignmentState, ...]
) -> AssignmentRow | None:
    """The assignment, locked until the transaction ends, if it is in one of these states."""
    row = db.execute(
        sa.select(t.assignments)
        .where(
            t.assignments.c.id == id_,
            t.assignments.c.state.in_([state.value for state in states]),
        )
        .with_for_update()
    ).one_or_none()
    return None if row is None else assignment_row(row)


def set_state(db: sa.Connection, id_: str, state: AssignmentState, why: str) -> None:
    """Change the state of an assignment."""
    db.execute(
        sa.update(t.assignments).where(t.assignments.c.id == id_).values(state=state.value, why=why)
    )


def unanswered(db: sa.Connection, assignment: str) -> bool:
    """Whether a command about an assignment waits for its answer."""
    waiting = sa.select(sa.func.count()).where(
        t.commands.c.assignment == assignment, t.commands.c.answer.is_(None)
    )
    return db.execute(waiting).scalar_one() > 0


def count_commands(db: sa.Connection, prefix: str) -> int:
    """How many commands have an id with this prefix."""
    asked = sa.select(sa.func.count()).where(t.commands.c.id.startswith(prefix, autoescape=True))
    return db.execute(asked).scalar_one()


def newest_launch(db: sa.Connection) -> int:
    """The number of the newest launch command, of whichever desk; 0: there is none."""
    launches = t.commands.c.id.contains(":launch")
    return db.execute(sa.select(sa.func.max(t.commands.c.n)).where(launches)).scalar() or 0


def awaits_its_vehicle() -> sa.ColumnElement[bool]:
    """Commands that their vehicle has not answered: of launches that left the desk also those that
    were made void there, since they may be carried out.
    """
    left = t.commands.c.sent.is_(True) & t.commands.c.life.is_(None)
    return t.commands.c.answer.is_(None) | left


def launch_on_its_way(db: sa.Connection, assignment: str) -> CommandRow | None:
    """The newest launch of an assignment that left the desk and that its vehicle did not answer."""
    query = sa.select(t.commands).where(
        t.commands.c.assignment == assignment,
        t.commands.c.id.contains(":launch"),
        t.commands.c.sent.is_(True),
        awaits_its_vehicle(),
    )
    row = db.execute(query.order_by(t.commands.c.n.desc()).limit(1)).one_or_none()
    return None if row is None else command_row(row)


def carried_out(db: sa.Connection, now_us: int, launch: CommandRow, life: str) -> None:
    """A launch was carried out, as its vehicle's state shows."""
    reason = "seen in flight"
    values = {"answer": Answered.DONE.value, "reason": reason, "life": life, "answered_us": now_us}
    db.execute(sa.update(t.commands).where(t.commands.c.id == launch.id).values(**values))
    follow(db, now_us, launch, Answered.DONE, reason)


def confirm(db: sa.Connection, assignment: str, by: str | None) -> None:
    """Note who lets an assignment be launched, once; None: nobody does."""
    here = t.assignments.c.id == assignment
    db.execute(sa.update(t.assignments).where(here).values(confirmed_by=by))


def end_assignment(
    db: sa.Connection,
    now_us: int,
    row: AssignmentRow,
    state: AssignmentState,
    delivered: bool,
    why: str,
    *,
    elsewhere: bool = False,
) -> None:
    """An assignment is over: its order changes state, and its unanswered commands are void.

    `elsewhere`: the parcel is not known to be home.
    """
    db.execute(
        sa.update(t.assignments)
        .where(t.assignments.c.id == row.id)
        .values(state=state.value, delivered=delivered, why=why, ended_us=now_us)
    )
    db.execute(
        sa.update(t.commands)
        .where(t.commands.c.assignment == row.id, t.commands.c.answer.is_(None))
        .values(answer=Answered.REFUSED.value, reason="the assignment is over")
    )
    db.execute(
        sa.update(t.sorties).where(t.sorties.c.assignment == row.id).values(landed_us=now_us)
    )
    attempts = db.execute(
        sa.select(t.orders.c.attempts).where(t.orders.c.id == row.order_id)
    ).scalar_one()
    order = order_after(state, delivered, attempts, elsewhere)
    db.execute(
        sa.update(t.orders).where(t.orders.c.id == row.order_id).values(state=order.value, why=why)
    )


def conclude(db: sa.Connection, now_us: int, event: FleetEvent) -> None:
    """A flight is over. Only the vehicle that holds the assignment can end it, and only once."""
    row = in_state(db, event.assignment or "", IN_FORCE)
    if row is None or row.vehicle != event.vehicle:
        return
    delivered = bool(event.delivered)
    state = ends_as(event.outcome or "FAIL", delivered, bool(event.home))
    unproven = bool(event.drop_unproven)
    why = f"{event.outcome}: {'drop not proven, look for the parcel; ' * unproven}{event.text}"
    taken = event.outcome == TAKEN
    end_assignment(db, now_us, row, state, delivered, why, elsewhere=unproven or taken)
    if taken:  # the truck waits for it nowhere: whoever landed it has it
        here = t.sorties.c.assignment == row.id
        db.execute(sa.update(t.sorties).where(here).values(away=True))


def driver_said(db: sa.Connection, now_us: int, event: FleetEvent) -> None:
    """What the driver has done, or cannot do, for a drone."""
    here = t.sorties.c.assignment == event.assignment
    row = db.execute(sa.select(t.sorties).where(here).with_for_update()).one_or_none()
    if row is None or event.vehicle != TRUCK:
        return
    match event.kind:
        case EventKind.PLACED:
            db.execute(sa.update(t.sorties).where(here).values(placed=True))
        case EventKind.RECOVERED:
            db.execute(sa.update(t.sorties).where(here).values(recovered=True, away=False))
            _withdrawn_by_hand(db, now_us, row.assignment)
            if event.delivered is not None:
                _parcel_found(db, row.assignment, gone=event.delivered)
        case _ if row.placed:
            db.execute(sa.update(t.sorties).where(here).values(away=True))
        case _:
            held = in_state(db, row.assignment, (AssignmentState.ORDERED,))
            if held is not None:
                why = f"the driver: {event.text}"
                end_assignment(db, now_us, held, AssignmentState.WITHDRAWN, False, why)
            db.execute(sa.update(t.sorties).where(here).values(away=True))


def _withdrawn_by_hand(db: sa.Connection, now_us: int, assignment: str) -> None:
    """A drone that has not answered its withdrawal is aboard the truck, and off: it never flew."""
    row = in_state(db, assignment, (AssignmentState.WITHDRAWING,))
    if row is None:
        return
    why = f"{row.why}; the driver has it aboard"
    end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, why)


def parcel_missed(db: sa.Connection, assignment: str) -> str | None:
    """The order whose parcel may still be on a drone that came home; None: its place is known."""
    query = (
        sa.select(t.orders.c.id)
        .join(t.assignments, t.assignments.c.order_id == t.orders.c.id)
        .where(
            t.assignments.c.id == assignment,
            t.assignments.c.state == AssignmentState.RETURNED.value,
            t.orders.c.state == OrderState.STUCK.value,
        )
    )
    return db.execute(query).scalar_one_or_none()


def _parcel_found(db: sa.Connection, assignment: str, *, gone: bool) -> None:
    order = parcel_missed(db, assignment)
    if order is None:
        return
    here = t.orders.c.id == order
    attempts = db.execute(sa.select(t.orders.c.attempts).where(here)).scalar_one()
    state = AssignmentState.DELIVERED if gone else AssignmentState.RETURNED
    words = "gone: it was dropped" if gone else "still on it"
    why = f"the driver looked: the parcel is {words}"
    db.execute(
        sa.update(t.assignments)
        .where(t.assignments.c.id == assignment)
        .values(state=state.value, delivered=gone, why=why)
    )
    after = order_after(state, gone, attempts)
    db.execute(sa.update(t.orders).where(here).values(state=after.value, why=why))


def follow(
    db: sa.Connection, now_us: int, command: CommandRow, answer: Answered, reason: str
) -> None:
    """What the answer to a command means for its assignment."""
    row = in_state(db, command.assignment or "", IN_FORCE)
    if row is None:
        return
    withdrawing = row.state is AssignmentState.WITHDRAWING
    match command.deed, answer:
        case ((Assign() | Serve()), Answered.REFUSED):
            end_assignment(db, now_us, row, AssignmentState.REFUSED, False, reason)
        case ((Assign() | Serve()), _) if not withdrawing:
            set_state(db, row.id, AssignmentState.ABOARD, reason)
        case PutOut(), Answered.REFUSED:
            end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, reason)
        case Launch(), Answered.DONE | Answered.INTERRUPTED:
            set_state(db, row.id, AssignmentState.FLYING, reason)
            _note_launch(db, now_us, row.id)
        case Launch(), Answered.REFUSED if row.state is not AssignmentState.FLYING:
            set_state(db, row.id, AssignmentState.ABOARD, f"launch refused: {reason}")
        case MoveHome(), Answered.REFUSED | Answered.INTERRUPTED:
            _forget_asked(db, row.id, command.deed.home)
        case Withdraw(), _ if command.vehicle != row.vehicle or command.deed.assignment != row.id:
            return
        case Withdraw(), Answered.DONE:
            why = row.why or reason  # the desk's own, where it said one
            end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, why)
        case Withdraw(), Answered.REFUSED | Answered.INTERRUPTED:
            set_state(db, row.id, AssignmentState.FLYING, f"not withdrawn: {reason}")
        case _:
            return


def _note_launch(db: sa.Connection, now_us: int, assignment: str) -> None:
    here = (t.sorties.c.assignment == assignment, t.sorties.c.launched_us.is_(None))
    db.execute(sa.update(t.sorties).where(*here).values(launched_us=now_us))


def _forget_asked(db: sa.Connection, assignment: str, home: str) -> None:
    here = (t.sorties.c.assignment == assignment, t.sorties.c.asked == home)
    db.execute(sa.update(t.sorties).where(*here).values(asked=None))


def assignment_row(row: Any) -> AssignmentRow:
    """A row as the core's type."""
    return _assignment(
        row.id,
        row.order_id,
        row.vehicle,
        row.state,
        row.delivered,
        row.why,
        row.confirmed_by,
        row.layer,
    )


@lru_cache(maxsize=20_000)
def _assignment(
    name: str,
    order_id: str,
    vehicle: str,
    state: str,
    delivered: bool,
    why: str,
    confirmed_by: str | None,
    layer: int | None,
) -> AssignmentRow:
    """A desk reads what is in force several times a second, and little of it has changed."""
    return AssignmentRow(
        name, order_id, vehicle, AssignmentState(state), delivered, why, confirmed_by, layer
    )


def command_row(row: Any) -> CommandRow:
    """A row as the core's type."""
    return CommandRow(
        row.id,
        row.vehicle,
        row.assignment,
        msgspec.json.decode(row.deed, type=Deed),
        row.said_by,
        None if row.answer is None else Answered(row.answer),
        row.reason,
        row.life,
        row.made_us,
    )
