"""Launch holds (ground stops) of one store, which assigning and launching transactions check.

Every transaction here takes the same lock as those: a hold either precedes the decision on a launch
or follows it and reports that launch.
"""

from collections.abc import Callable, Iterable

import sqlalchemy as sa

from companion.fleet.messages import CommandStatus
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import hold_steps as steps
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.core.schema.holds import ALL_DRONES, Hold
from ground_station.core.schema.orders import AssignmentState


class HoldStore:
    """Launch holds of one desk."""

    def __init__(self, database: Database, epoch_us: Callable[[], int]) -> None:
        self._database = database
        self._epoch_us = epoch_us

    def place_holds(self, scopes: Iterable[str], reason: str, by: str) -> list[str]:
        """Place a hold on these vehicles (or `ALL_DRONES`).

        Unsent launch commands become void, and so do operator confirmations of launches. Returns
        the assignments whose launch was sent earlier without a response: these may take off.
        """
        with self._database.write() as db:
            rows.lock_dispatch_decisions(db)
            sent: list[str] = []
            for scope in scopes:
                steps.insert_hold(db, self._epoch_us(), scope, reason, by)
                audit.add_entry(db, self._epoch_us(), by, "hold", scope, reason)
                sent += void_unsent_launches_and_list_sent(db, scope)
        return list(dict.fromkeys(sent))

    def void_launch_confirmation(self, assignment: str, reason: str) -> bool:
        """Void an operator's confirmation; False if its launch was ordered meanwhile."""
        with self._database.write() as db:
            row = rows.lock_assignment_if_in_states(db, assignment, (AssignmentState.UPLOADED,))
            if row is None or row.confirmed_by is None:
                return False
            rows.set_launch_confirmation(db, assignment, None)
            subject = f"{row.vehicle}: {assignment}"
            audit.add_entry(db, self._epoch_us(), row.confirmed_by, "confirm", subject, reason)
        return True

    def clear_holds(
        self, scopes: Iterable[str], by: str, *, only_placed_by_actor: bool = False
    ) -> list[Hold]:
        """Clear holds of vehicles (or `ALL_DRONES`), with `only_placed_by_actor` only those that
        `by` placed; returns the cleared holds.

        A launch that was sent before the hold without a response is not sent again: it needs an
        operator confirmation or a new decision. The response of its vehicle still counts.
        """
        with self._database.write() as db:
            rows.lock_dispatch_decisions(db)
            lifted: list[Hold] = []
            for scope in scopes:
                lifted += steps.clear_holds_of_scope(
                    db, self._epoch_us(), scope, by, only_placed_by_actor=only_placed_by_actor
                )
            for hold in lifted:
                _void_launches(
                    db,
                    _unanswered_launch_condition(hold.scope),
                    "held after it was sent: not sent again",
                )
                audit.add_entry(db, self._epoch_us(), by, "release", hold.scope, hold.text)
        return lifted


def void_unsent_launches_and_list_sent(db: sa.Connection, scope: str) -> list[str]:
    """Void unsent launches and confirmations; return the assignments of sent ones."""
    launches = _unanswered_launch_condition(scope)
    _void_launches(db, launches & t.commands.c.sent.is_(False), "held before it was sent")
    selection = t.assignments.c.vehicle == scope if scope != ALL_DRONES else sa.true()
    db.execute(sa.update(t.assignments).where(selection).values(confirmed_by=None))
    sent = db.execute(sa.select(t.commands.c.assignment).where(launches)).scalars()
    return [assignment for assignment in sent if assignment is not None]


def _unanswered_launch_condition(scope: str) -> sa.ColumnElement[bool]:
    """Select the unanswered launch commands of a vehicle, or of all."""
    launch = t.commands.c.id.like("%:launch%") & t.commands.c.answer.is_(None)
    return launch if scope == ALL_DRONES else launch & (t.commands.c.vehicle == scope)


def _void_launches(
    db: sa.Connection, launch_condition: sa.ColumnElement[bool], reason: str
) -> None:
    values = {"answer": CommandStatus.REFUSED.value, "reason": reason}
    db.execute(sa.update(t.commands).where(launch_condition).values(**values))
