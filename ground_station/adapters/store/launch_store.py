"""Launches in the store: their validity, and which of them may still start a flight."""

from collections.abc import Collection

import msgspec
import sqlalchemy as sa

from companion.core.mission.event_text import PhaseEvent
from companion.fleet.messages import CommandStatus, EventKind, FleetEvent, Launch, LaunchWindow
from ground_station.adapters.store import hold_steps as holds
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES
from ground_station.core.schema.orders import (
    IN_FORCE,
    AssignmentRow,
    AssignmentState,
    CommandRow,
)

_IS_LAUNCH = t.commands.c.id.contains(":launch")
_MAY_START = _IS_LAUNCH & sa.or_(
    rows.pending_response_condition(),
    t.commands.c.answer.in_([CommandStatus.DONE.value, CommandStatus.INTERRUPTED.value]),
)
_LAUNCHED = (
    sa.select(t.assignments)
    .where(
        t.assignments.c.state.in_([state.value for state in IN_FORCE]),
        sa.or_(
            t.assignments.c.state == AssignmentState.IN_FLIGHT.value,
            t.assignments.c.id.in_(
                sa.select(t.commands.c.assignment).where(
                    _IS_LAUNCH, rows.pending_response_condition()
                )
            ),
        ),
    )
    .order_by(t.assignments.c.n)
)


def newest_launch_command_number(database: Database) -> int:
    """Return the number of the newest launch of any desk; 0 without one."""
    with database.read() as db:
        return rows.newest_launch(db)


def airborne_or_launch_pending(database: Database) -> list[AssignmentRow]:
    """Return the assignments that are airborne, or whose launch no vehicle has answered."""
    with database.read() as db:
        return [rows.assignment_from_database_row(row) for row in db.execute(_LAUNCHED)]


def launches_that_may_start(database: Database, assignment: str) -> list[CommandRow]:
    """Return the launches of an assignment that its vehicle has not refused, oldest first."""
    query = sa.select(t.commands).where(t.commands.c.assignment == assignment, _MAY_START)
    with database.read() as db:
        found = db.execute(query.order_by(t.commands.c.n)).all()
    return [rows.command_from_database_row(row) for row in found]


def last_phases(database: Database, assignments: Collection[str]) -> dict[str, str]:
    """Return the last phase that vehicles have reported with these assignments."""
    here = t.events.c.assignment.in_(assignments), t.events.c.kind == EventKind.PHASE.value
    query = sa.select(t.events.c.assignment, t.events.c.content).where(*here)
    with database.read() as db:
        found = db.execute(query.order_by(t.events.c.n)).all()
    texts = {
        row.assignment: msgspec.json.decode(row.content, type=FleetEvent).text for row in found
    }
    return {id_: PhaseEvent.parse(text).now for id_, text in texts.items()}


def has_reported_flight(database: Database, row: AssignmentRow) -> bool:
    """Return whether a vehicle has reported leaving a flight phase with this assignment."""
    contents = sa.select(t.events.c.content).where(
        t.events.c.vehicle == row.vehicle,
        t.events.c.assignment == row.id,
        t.events.c.kind == EventKind.PHASE.value,
    )
    with database.read() as db:
        found = db.execute(contents).scalars().all()
    texts = (msgspec.json.decode(one, type=FleetEvent).text for one in found)
    return any(PhaseEvent.parse(text).before in FLIGHT_PHASE_NAMES for text in texts)


def count_refused_launches(database: Database, assignment: str) -> int:
    """Return how many launches of an assignment its vehicle has refused."""
    refused = sa.select(sa.func.count()).where(
        t.commands.c.id.startswith(f"{assignment}:launch", autoescape=True),
        t.commands.c.answer == CommandStatus.REFUSED.value,
        t.commands.c.life.is_not(None),  # not launches that a hold has voided
    )
    with database.read() as db:
        return db.execute(refused).scalar_one()


def stamp_and_mark_launch_sent(
    database: Database, command: CommandRow, window: LaunchWindow
) -> LaunchWindow | None:
    """Return the validity of a launch that may be sent now, decided under the lock that holds take;
    it is fixed when the launch is sent first.

    A sent launch may be carried out, so a later hold does not make it void.
    """
    with database.write() as db:
        rows.lock_dispatch_decisions(db)
        if holds.hold_on(db, command.vehicle) is not None:
            return None
        return _stamp_unanswered_launch(db, command.id, window)


def _stamp_unanswered_launch(
    db: sa.Connection, command_id: str, window: LaunchWindow
) -> LaunchWindow | None:
    """Return the validity of an unanswered launch, `window` if it has not been sent before.

    None: it was answered, or sent by a version that gave launches no validity.
    """
    here = t.commands.c.id == command_id
    row = db.execute(sa.select(t.commands).where(here)).one_or_none()
    if row is None or row.answer is not None:
        return None
    launch = msgspec.json.decode(row.deed, type=Launch)
    if row.sent:
        return launch.window if isinstance(launch.window, LaunchWindow) else None
    stamped = msgspec.structs.replace(launch, window=window)
    values = {"sent": True, "deed": msgspec.json.encode(stamped)}
    db.execute(sa.update(t.commands).where(here).values(**values))
    return window
