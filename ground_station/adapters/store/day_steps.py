"""Steps of the transactions of a day with a truck; each runs inside the caller's transaction."""

from typing import Any

import msgspec
import sqlalchemy as sa

from companion.core.base.location import Location
from companion.fleet.messages import (
    CommandAction,
    CommandStatus,
    Drive,
    EventKind,
    FleetEvent,
    Withdraw,
)
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.shift.days import during
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.orders import (
    AssignmentRow,
    AssignmentState,
    OrderState,
    order_state_after_assignment,
)
from ground_station.core.schema.sortie_rows import SortieRow

SORTIES = (
    sa.select(t.assignments, t.sorties)
    .join(t.sorties, t.sorties.c.assignment == t.assignments.c.id)
    .order_by(t.assignments.c.n)
)


def read_drive_commands_not_refused(db: sa.Connection) -> list[tuple[Drive, CommandStatus | None]]:
    """Return the day's drive commands that the truck has not refused, oldest first."""
    here = t.commands.c.id.like("drive-%"), during(t.commands.c.made_us, None)
    query = sa.select(t.commands.c.deed, t.commands.c.answer).where(*here)
    found: list[tuple[Drive, CommandStatus | None]] = []
    for row in db.execute(query.order_by(t.commands.c.n)):
        action = msgspec.json.decode(row.deed, type=CommandAction)
        response = None if row.answer is None else CommandStatus(row.answer)
        if isinstance(action, Drive) and response is not CommandStatus.REFUSED:
            found.append((action, response))
    return found


def last_ordered_truck_stop(db: sa.Connection) -> str | None:
    """Return the stop that the truck was last ordered to, None before the first order."""
    drive_commands = read_drive_commands_not_refused(db)
    return drive_commands[-1][0].stop if drive_commands else None


def read_sorties_without_responses(db: sa.Connection, day: str | None = None) -> list[SortieRow]:
    """Return the day's sorties, to determine at which stops the truck must wait."""
    found = db.execute(SORTIES.where(during(t.assignments.c.made_us, day)))
    return [sortie_from_database_row(row, ()) for row in found]


def ordered_and_promised_landing_stops(db: sa.Connection) -> set[str]:
    """Return the truck's last ordered stop and the stops where airborne drones may land."""
    out = [
        row
        for row in read_sorties_without_responses(db)
        if not (row.is_drone_on_truck or row.is_drone_lost_off_site_or_overdue)
    ]
    stops = {stop for row in out for stop in (row.promised_stop, row.requested_stop)}
    return {stop for stop in (*stops, last_ordered_truck_stop(db)) if stop is not None}


def has_truck_delivery_in_force(db: sa.Connection) -> bool:
    """Return whether the driver has an order to deliver."""
    query = sa.select(sa.func.count()).where(
        t.assignments.c.vehicle == TRUCK,
        t.assignments.c.state.in_([state.value for state in rows.IN_FORCE]),
    )
    return db.execute(query).scalar_one() > 0


def is_launch_unanswered(db: sa.Connection, assignment: str) -> bool:
    """Return whether a launch command of this assignment waits for its response."""
    waiting = sa.select(sa.func.count()).where(
        t.commands.c.id.startswith(f"{assignment}:launch", autoescape=True),
        t.commands.c.answer.is_(None),
    )
    return db.execute(waiting).scalar_one() > 0


def withdraw_before_launch(
    db: sa.Connection, now_us: int, row: AssignmentRow, by: str, reason: str
) -> None:
    """Withdraw an assignment on the ground; on a truck the driver's task, too."""
    if is_mission_withheld(db, row.id):  # its companion has not received it
        rows.end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, reason)
    else:
        rows.set_assignment_state(db, row.id, AssignmentState.WITHDRAWING, reason)
        action = Withdraw(assignment=row.id)
        rows.enqueue_command(db, now_us, f"{row.id}:withdraw", row.vehicle, row.id, action, by)
    here = t.sorties.c.assignment == row.id
    if db.execute(sa.select(t.sorties.c.assignment).where(here)).first() is not None:
        action = Withdraw(assignment=row.id)
        rows.enqueue_command(db, now_us, f"{row.id}:unput", TRUCK, None, action, by)


def mission_with_unconfirmed_withdrawal(db: sa.Connection, vehicle: str) -> str | None:
    """Return the mission of a drone that was switched off before it confirmed the withdrawal."""
    newest = (
        sa.select(t.assignments.c.id)
        .where(t.assignments.c.vehicle == vehicle)
        .order_by(t.assignments.c.n.desc())
        .limit(1)
    )
    id_ = db.execute(newest).scalar_one_or_none()
    if id_ is None:
        return None
    withdrawal = t.commands.c.id.startswith(f"{id_}:withdraw", autoescape=True)
    unanswered = sa.select(t.commands.c.n).where(withdrawal, t.commands.c.life.is_(None))
    return None if db.execute(unanswered).first() is None else id_


def is_mission_withheld(db: sa.Connection, assignment: str) -> bool:
    """Return whether the mission upload of this assignment is still withheld."""
    query = sa.select(t.commands.c.held).where(t.commands.c.id == f"{assignment}:assign")
    return bool(db.execute(query).scalar_one_or_none())


def sortie_from_database_row(database_row: Any, command_responses: Any) -> SortieRow:
    """Convert a database row, with the responses to its commands, to the core's type."""
    launch_rows = [a for a in command_responses if a.id.startswith(f"{database_row.id}:launch")]
    move_home_rows = [a for a in command_responses if a.id.startswith(f"{database_row.id}:home")]
    refusals = [a.answered_us for a in move_home_rows if a.answer == CommandStatus.REFUSED.value]
    return SortieRow(
        assignment=rows.assignment_from_database_row(database_row),
        sortie=msgspec.json.decode(database_row.content, type=PlannedSortie),
        pads=msgspec.json.decode(database_row.pads, type=dict[str, Location]),
        promised_stop=database_row.promised,
        requested_stop=database_row.asked,
        put_on_pad=database_row.placed,
        recovered=database_row.recovered,
        is_off_site=database_row.away,
        is_overdue=database_row.lapsed,
        launched_us=database_row.launched_us,
        landed_us=database_row.landed_us,
        used_wh=database_row.used_wh,
        launch_pending=any(a.answer is None or (a.sent and a.life is None) for a in launch_rows),
        refused_launches=sum(
            a.answer == CommandStatus.REFUSED.value and a.life is not None for a in launch_rows
        ),
        recovery_ordered=any(
            a.id.startswith(f"{database_row.id}:recover") for a in command_responses
        ),
        home_refused_us=max((us for us in refusals if us is not None), default=None),
    )


def apply_driver_event(db: sa.Connection, now_us: int, event: FleetEvent) -> None:
    """Apply a driver's report about a drone: placed, recovered or not possible."""
    here = t.sorties.c.assignment == event.assignment
    row = db.execute(sa.select(t.sorties).where(here).with_for_update()).one_or_none()
    if row is None or event.vehicle != TRUCK:
        return
    match event.kind:
        case EventKind.DRONE_ON_PAD:
            db.execute(sa.update(t.sorties).where(here).values(placed=True))
        case EventKind.RECOVERED:
            db.execute(sa.update(t.sorties).where(here).values(recovered=True, away=False))
            _complete_withdrawal(db, now_us, row.assignment)
            if event.fitted_pack:
                _record_pack(db, now_us, row.assignment, event.fitted_pack)
            if event.delivered is not None:
                _apply_driver_parcel_check(db, row.assignment, parcel_dropped=event.delivered)
        case _ if row.placed:
            db.execute(sa.update(t.sorties).where(here).values(away=True))
        case _:
            withheld = rows.lock_assignment_if_in_states(
                db, row.assignment, (AssignmentState.ORDERED,)
            )
            if withheld is not None:
                reason_text = f"the driver: {event.text}"
                rows.end_assignment(
                    db, now_us, withheld, AssignmentState.WITHDRAWN, False, reason_text
                )
            db.execute(sa.update(t.sorties).where(here).values(away=True))


def _record_pack(db: sa.Connection, now_us: int, assignment: str, pack: str) -> None:
    from ground_station.adapters.store.shift.pack_store import (
        record_fitted_pack,  # a cycle of imports
    )

    vehicle = sa.select(t.assignments.c.vehicle).where(t.assignments.c.id == assignment)
    name = db.execute(vehicle).scalar_one()
    record_fitted_pack(db, now_us, name, pack, TRUCK, takes_from_other=True)


def _complete_withdrawal(db: sa.Connection, now_us: int, assignment: str) -> None:
    """Conclude an unanswered withdrawal: the drone is off and on the truck, it did not fly."""
    row = rows.lock_assignment_if_in_states(db, assignment, (AssignmentState.WITHDRAWING,))
    if row is None:
        return
    reason_text = f"{row.reason}; the driver has loaded it"
    rows.end_assignment(db, now_us, row, AssignmentState.WITHDRAWN, False, reason_text)


def order_with_unlocated_parcel(db: sa.Connection, assignment: str) -> str | None:
    """Return the order whose parcel may still be on a drone that came home, None if it is known."""
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


def _apply_driver_parcel_check(db: sa.Connection, assignment: str, *, parcel_dropped: bool) -> None:
    order = order_with_unlocated_parcel(db, assignment)
    if order is None:
        return
    here = t.orders.c.id == order
    attempts = db.execute(sa.select(t.orders.c.attempts).where(here)).scalar_one()
    state = AssignmentState.DELIVERED if parcel_dropped else AssignmentState.RETURNED
    words = "was dropped" if parcel_dropped else "is still on the drone"
    reason_text = f"driver's check: the parcel {words}"
    db.execute(
        sa.update(t.assignments)
        .where(t.assignments.c.id == assignment)
        .values(state=state.value, delivered=parcel_dropped, why=reason_text)
    )
    after = order_state_after_assignment(state, parcel_dropped, attempts)
    db.execute(sa.update(t.orders).where(here).values(state=after.value, why=reason_text))
