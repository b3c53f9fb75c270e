"""A store's day as it was at each moment, from the times that its rows have.

A change that the store keeps no time of (a note, a doubt of the plan) is shown as it ended.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec
import sqlalchemy as sa

from companion.fleet.messages import Deed, Drive, EventKind, FleetEvent
from ground_station.adapters.store import audit_steps, day_steps
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import BEGAN
from ground_station.core.people.audit_chain import AuditRow
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.holds import Hold
from ground_station.core.schema.order_states import OrderState, Settled
from ground_station.core.schema.orders import (
    AssignmentRow,
    AssignmentState,
    Order,
    OrderRow,
    order_after,
    settled_as,
)
from ground_station.core.schema.sortie_rows import SortieRow, Visit


@dataclass(frozen=True, slots=True)
class PastAssignment:
    """An assignment with its times; `flew_us`: when its flight began, None: it did not."""

    row: AssignmentRow
    made_us: int
    ended_us: int | None
    flew_us: int | None
    confirmed_us: int | None

    def in_force(self, t_us: int) -> bool:
        """Whether it was made and not over."""
        return self.made_us <= t_us and (self.ended_us is None or t_us < self.ended_us)

    def at(self, t_us: int) -> AssignmentRow:
        """The row as it was."""
        confirmed = self.confirmed_us is not None and self.confirmed_us <= t_us
        row = replace(self.row, confirmed_by=self.row.confirmed_by if confirmed else None)
        if not self.in_force(t_us):
            return row
        flew = self.flew_us is not None and self.flew_us <= t_us
        state = AssignmentState.FLYING if flew else AssignmentState.ABOARD
        return replace(row, state=state, delivered=False, why="")


@dataclass(frozen=True, slots=True)
class PastHold:
    """A hold; `lifted_us` None: it is in force."""

    hold: Hold
    lifted_us: int | None


@dataclass(frozen=True, slots=True)
class PastEvent:
    """An event, and when a desk heard it."""

    heard_us: int
    event: FleetEvent


@dataclass(frozen=True, slots=True)
class PastPlan:
    """A plan, and when it was taken."""

    made_us: int
    plan: DayPlan
    wind: Forecast | None


@dataclass(frozen=True, slots=True)
class _Change:
    at_us: int
    state: OrderState
    why: str = ""


class PastStore:
    """All of one store, read once."""

    def __init__(self, database: Database) -> None:
        """Raises StoreError."""
        with database.read() as db:
            self.events = _events(db)
            audit = audit_steps.rows(db)
            self.began_us = _began(db)
            self.plans = _plans(db)
            self.visits = [
                Visit(row.stop, row.arrived_us, row.left_us)
                for row in db.execute(sa.select(t.visits).order_by(t.visits.c.arrived_us))
            ]
            self._drives = _drives(db)
            self._holds = _holds(db)
            orders = db.execute(sa.select(t.orders).order_by(t.orders.c.n)).all()
            made = db.execute(sa.select(t.assignments).order_by(t.assignments.c.n)).all()
            self._sorties = _sorties(db)
        self.assignments = self._with_times(made, audit)
        self._orders = [
            (
                msgspec.json.decode(row.content, type=Order),
                _changes(row, [a for a in self.assignments if a.row.order_id == row.id], audit),
            )
            for row in orders
        ]

    def _with_times(self, made: Sequence[sa.Row], audit: list[AuditRow]) -> list[PastAssignment]:
        confirmed = {
            row.entry.subject: row.entry.at_us for row in audit if row.entry.deed == "confirm"
        }
        flew = {row.id: row.launched_us for row in self._sorties}
        for heard in reversed(self.events):
            if heard.event.kind is EventKind.PHASE and "-> climb" in heard.event.text:
                flew[heard.event.assignment or ""] = heard.heard_us
        return [
            PastAssignment(
                row=(row := rows.assignment_row(found)),
                made_us=found.made_us,
                ended_us=found.ended_us,
                flew_us=flew.get(row.id),
                confirmed_us=confirmed.get(f"{row.vehicle}: {row.id}"),
            )
            for found in made
        ]

    @property
    def span_us(self) -> tuple[int, int] | None:
        """First and last time that something was written; None: nothing was."""
        found = [change.at_us for _, changes in self._orders for change in changes]
        found += [heard.heard_us for heard in self.events]
        found += [plan.made_us for plan in self.plans]
        found += [stamp for a in self.assignments for stamp in (a.made_us, a.ended_us) if stamp]
        return (min(found), max(found)) if found else None

    def orders(self, t_us: int) -> list[OrderRow]:
        """The orders that had come, as they were."""
        known = ((order, _at(changes, t_us)) for order, changes in self._orders)
        return [OrderRow(order, was.state, 0, was.why) for order, was in known if was is not None]

    def in_force(self, t_us: int) -> list[AssignmentRow]:
        """The assignments that were in force."""
        return [one.at(t_us) for one in self.assignments if one.in_force(t_us)]

    def holds(self, t_us: int) -> list[Hold]:
        """The holds that were in force."""
        return [
            past.hold
            for past in self._holds
            if past.hold.set_us <= t_us and (past.lifted_us is None or t_us < past.lifted_us)
        ]

    def plan(self, t_us: int) -> PastPlan | None:
        """The plan that was in force."""
        return next((plan for plan in reversed(self.plans) if plan.made_us <= t_us), None)

    def wind(self, t_us: int) -> Forecast | None:
        """The measured wind of the last plan that had one."""
        made = (plan.wind for plan in reversed(self.plans) if plan.made_us <= t_us)
        return next((wind for wind in made if wind is not None), None)

    def visits_until(self, t_us: int) -> list[Visit]:
        """The truck's visits, as they were."""
        begun = (visit for visit in self.visits if visit.arrived_us <= t_us)
        return [replace(visit, left_us=_if_past(visit.left_us, t_us)) for visit in begun]

    def visit(self, t_us: int) -> Visit | None:
        """Where the truck stood; None: nowhere."""
        there = (visit for visit in self.visits if visit.arrived_us <= t_us)
        return next((v for v in there if v.left_us is None or t_us < v.left_us), None)

    def next_stop(self, t_us: int) -> str | None:
        """The stop that the truck had been told to drive to, else the first that it came to."""
        told = [stop for at_us, stop in self._drives if at_us <= t_us]
        came = [visit.stop for visit in self.visits if visit.arrived_us > t_us]
        return next(iter((*told[-1:], *came)), None)

    def sorties(self, t_us: int) -> list[SortieRow]:
        """The sorties that had been begun, as they were."""
        times = {one.row.id: one for one in self.assignments}
        begun = (row for row in self._sorties if times[row.id].made_us <= t_us)
        return [self._sortie(row, times[row.id], t_us) for row in begun]

    def _sortie(self, row: SortieRow, times: PastAssignment, t_us: int) -> SortieRow:
        over = not times.in_force(t_us)
        moved_us = self._heard_us(row.id, EventKind.DECISION, "home_moved: ")
        moved = over if moved_us is None else moved_us <= t_us
        return replace(
            row,
            row=times.at(t_us),
            promised=row.promised if moved else row.sortie.home,
            asked=None,
            placed=_was(self._heard_us(row.id, EventKind.PLACED), row.placed, t_us),
            recovered=_was(self._heard_us(row.id, EventKind.RECOVERED), row.recovered, t_us),
            away=row.away and over,
            lapsed=row.lapsed and over,
            launched_us=_if_past(row.launched_us, t_us),
            landed_us=_if_past(row.landed_us, t_us),
            launching=False,
            recovering=False,
        )

    def _heard_us(self, assignment: str, kind: EventKind, words: str = "") -> int | None:
        found = (
            heard.heard_us
            for heard in self.events
            if heard.event.assignment == assignment
            and heard.event.kind is kind
            and heard.event.text.startswith(words)
        )
        return next(found, None)


def _was(heard_us: int | None, ended_so: bool, t_us: int) -> bool:
    return ended_so and heard_us is not None and heard_us <= t_us


def _if_past(stamp_us: int | None, t_us: int) -> int | None:
    return stamp_us if stamp_us is not None and stamp_us <= t_us else None


def _at(changes: list[_Change], t_us: int) -> _Change | None:
    found = bisect_right(changes, t_us, key=lambda change: change.at_us)
    return changes[found - 1] if found else None


def _changes(
    row: sa.Row, assignments: list[PastAssignment], audit: list[AuditRow]
) -> list[_Change]:
    """What became of an order, oldest first; the last is what the store has."""
    found = [_Change(row.taken_us, OrderState.OPEN)]
    for attempt, past in enumerate(assignments, start=1):
        found.append(_Change(past.made_us, OrderState.ASSIGNED))
        if past.ended_us is not None:
            state = order_after(past.row.state, past.row.delivered, attempt)
            found.append(_Change(past.ended_us, state, past.row.why))
    found += _persons_words(row.id, audit)
    found.sort(key=lambda change: change.at_us)
    found[-1] = _Change(found[-1].at_us, OrderState(row.state), row.why)
    return found


def _persons_words(order_id: str, audit: list[AuditRow]) -> Iterator[_Change]:
    for entry in (row.entry for row in audit if row.entry.subject == order_id):
        if entry.deed == "order":
            yield _Change(entry.at_us, OrderState(entry.answer), f"by {entry.who}")
        elif entry.deed == "settle":
            settled = Settled(entry.answer.partition(",")[0])
            yield _Change(entry.at_us, settled_as(settled)[1], entry.answer)


def _events(db: sa.Connection) -> list[PastEvent]:
    query = sa.select(t.events.c.heard_us, t.events.c.content).order_by(t.events.c.n)
    return [
        PastEvent(row.heard_us, msgspec.json.decode(row.content, type=FleetEvent))
        for row in db.execute(query)
    ]


def _began(db: sa.Connection) -> int | None:
    found = db.execute(sa.select(t.about.c.value).where(t.about.c.name == BEGAN)).scalar()
    return None if found is None else int(found)


def _plans(db: sa.Connection) -> list[PastPlan]:
    found = db.execute(sa.select(t.plans).order_by(t.plans.c.made_us, t.plans.c.revision))
    return [
        PastPlan(
            row.made_us,
            msgspec.json.decode(row.content, type=DayPlan),
            None if row.wind is None else msgspec.json.decode(row.wind, type=Forecast),
        )
        for row in found
    ]


def _drives(db: sa.Connection) -> list[tuple[int, str]]:
    query = sa.select(t.commands.c.made_us, t.commands.c.deed).order_by(t.commands.c.n)
    found = ((row.made_us, msgspec.json.decode(row.deed, type=Deed)) for row in db.execute(query))
    return [(made_us, deed.stop) for made_us, deed in found if isinstance(deed, Drive)]


def _holds(db: sa.Connection) -> list[PastHold]:
    found = db.execute(sa.select(t.holds).order_by(t.holds.c.n))
    return [
        PastHold(Hold(row.scope, row.reason, row.set_by, row.set_us), row.lifted_us)
        for row in found
    ]


def _sorties(db: sa.Connection) -> list[SortieRow]:
    query = (
        sa.select(t.assignments, t.sorties)
        .join(t.sorties, t.sorties.c.assignment == t.assignments.c.id)
        .order_by(t.assignments.c.n)
    )
    return [day_steps.sortie_row(row, ()) for row in db.execute(query)]
