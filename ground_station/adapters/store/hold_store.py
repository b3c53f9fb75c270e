"""Holds (ground stops) of one store. Assignments and launches ask for them in their transactions.

Every transaction here takes the lock that those take: a hold is either there before a launch is
decided, or comes behind it and names it.
"""

from collections.abc import Callable, Iterable

import sqlalchemy as sa

from companion.fleet.messages import Answered
from ground_station.adapters.store import audit_steps as audit
from ground_station.adapters.store import hold_steps as steps
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.core.schema.holds import ALL, Hold


class HoldStore:
    """The holds of one desk."""

    def __init__(self, database: Database, epoch_us: Callable[[], int]) -> None:
        self._database = database
        self._now = epoch_us

    def set(self, scopes: Iterable[str], reason: str, by: str) -> list[str]:
        """Hold these vehicles (or `ALL`) from now on.

        A launch that was not sent yet is void, and so is a person's word for one. Returns the
        assignments whose launch was sent before and is not answered: these may take off.
        """
        with self._database.write() as db:
            rows.lock(db)
            sent: list[str] = []
            for scope in scopes:
                steps.set_hold(db, self._now(), scope, reason, by)
                audit.note(db, self._now(), by, "hold", scope, reason)
                sent += self._stop_launches(db, scope)
        return list(dict.fromkeys(sent))

    def _stop_launches(self, db: sa.Connection, scope: str) -> list[str]:
        mine = _launches_of(scope)
        _void(db, mine & t.commands.c.sent.is_(False), "held before it was sent")
        held = t.assignments.c.vehicle == scope if scope != ALL else sa.true()
        db.execute(sa.update(t.assignments).where(held).values(confirmed_by=None))
        sent = db.execute(sa.select(t.commands.c.assignment).where(mine)).scalars()
        return [assignment for assignment in sent if assignment is not None]

    def release(self, scopes: Iterable[str], by: str, *, only_own: bool = False) -> list[Hold]:
        """Lift the holds of these vehicles (or `ALL`), `only_own`: no others than `by` set itself;
        returns those that were in force.

        A launch that was sent before the hold and is not answered is not sent again: it takes a
        person's word, or a new decision, to launch. Its vehicle's own answer still counts.
        """
        with self._database.write() as db:
            rows.lock(db)
            lifted: list[Hold] = []
            for scope in scopes:
                lifted += steps.lift(db, self._now(), scope, by, only_own=only_own)
            for hold in lifted:
                _void(db, _launches_of(hold.scope), "held after it was sent: not sent again")
                audit.note(db, self._now(), by, "release", hold.scope, hold.words)
        return lifted


def _launches_of(scope: str) -> sa.ColumnElement[bool]:
    """The launches of a vehicle, or of all, that are not answered."""
    launch = t.commands.c.id.like("%:launch%") & t.commands.c.answer.is_(None)
    return launch if scope == ALL else launch & (t.commands.c.vehicle == scope)


def _void(db: sa.Connection, which: sa.ColumnElement[bool], why: str) -> None:
    values = {"answer": Answered.REFUSED.value, "reason": why}
    db.execute(sa.update(t.commands).where(which).values(**values))
