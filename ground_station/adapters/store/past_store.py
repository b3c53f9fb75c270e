"""Past states of a day, reconstructed from the time stamps of a store's rows.

A change without a time stamp (a note, a doubt of the plan) appears in its final state.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec
import sqlalchemy as sa

from companion.core.mission.event_text import DecisionEvent, PhaseEvent
from companion.core.pilot.transitions import Phase
from companion.fleet.messages import CommandAction, Drive, EventKind, FleetEvent
from ground_station.adapters.store import audit_steps, day_steps
from ground_station.adapters.store import order_steps as rows
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.about_steps import about_value
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.shift import days
from ground_station.core.people.audit_chain import AuditRow
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.holds import Hold
from ground_station.core.schema.order_states import OrderState, ParcelOutcome
from ground_station.core.schema.orders import (
    AssignmentRow,
    AssignmentState,
    Order,
    OrderRow,
    assignment_and_order_state_after_outcome,
    order_state_after_assignment,
)
from ground_station.core.schema.sortie_rows import SortieRow, StopTimes

_END_OF_TIME_US = 2**62


@dataclass(frozen=True, slots=True)
class PastAssignment:
    """An assignment with its times; `flight_start_us`: start of its flight, None if it did not
    fly.
    """

    row: AssignmentRow
    created_us: int
    ended_us: int | None
    flight_start_us: int | None
    confirmed_us: int | None

    def is_in_force_at(self, t_us: int) -> bool:
        """Return whether it was made and not over at this time."""
        return self.created_us <= t_us and (self.ended_us is None or t_us < self.ended_us)

    def row_at(self, t_us: int) -> AssignmentRow:
        """Return the row at this time."""
        confirmed = self.confirmed_us is not None and self.confirmed_us <= t_us
        row = replace(self.row, confirmed_by=self.row.confirmed_by if confirmed else None)
        if not self.is_in_force_at(t_us):
            return row
        flew = self.flight_start_us is not None and self.flight_start_us <= t_us
        state = AssignmentState.IN_FLIGHT if flew else AssignmentState.UPLOADED
        return replace(row, state=state, delivered=False, reason="")


@dataclass(frozen=True, slots=True)
class PastHold:
    """A hold; `lifted_us` is None while it is in force."""

    hold: Hold
    lifted_us: int | None


@dataclass(frozen=True, slots=True)
class PastEvent:
    """An event, and when a desk received it."""

    received_us: int
    event: FleetEvent


@dataclass(frozen=True, slots=True)
class PastPlan:
    """A plan, and when it was stored."""

    stored_us: int
    plan: DayPlan
    wind: Forecast | None


@dataclass(frozen=True, slots=True)
class _StateChange:
    at_us: int
    state: OrderState
    reason: str = ""


class PastStore:
    """Complete content of one day of a store, read once: of the database's past day, else of the
    current one.
    """

    def __init__(self, database: Database) -> None:
        """Raises StoreError."""
        day = database.day
        with database.read() as db:
            events = sa.select(t.events.c.heard_us, t.events.c.content).order_by(t.events.c.n)
            events = events.where(days.during(t.events.c.heard_us, day))
            self.events = [
                PastEvent(row.heard_us, msgspec.json.decode(row.content, type=FleetEvent))
                for row in db.execute(events)
            ]
            audit = audit_steps.read_audit_rows(db)
            self.start_us: int | None = about_value(db, days.day_start_key(day), int)
            self.plans = _read_past_plans(db, day)
            visits, here = days.visits_of(day)
            self.visits = [
                StopTimes(row.stop, row.arrived_us, row.left_us)
                for row in db.execute(sa.select(visits).where(here).order_by(visits.c.arrived_us))
            ]
            self._drives = _read_drive_orders(db, day)
            self._hold_history = [
                PastHold(Hold(row.scope, row.reason, row.set_by, row.set_us), row.lifted_us)
                for row in db.execute(sa.select(t.hold_table).order_by(t.hold_table.c.n))
            ]
            self._began_us: int = db.scalar(days.start_us_of(day)) or 0
            end_us = _END_OF_TIME_US if day is None else db.scalar(sa.select(days.end_us_of(day)))
            carried = days.carried_over_from(db, day)
            of_day = sa.select(t.orders).where(days.is_order_of(day))
            orders = db.execute(of_day.order_by(t.orders.c.n)).all()
            made = days.during(t.assignments.c.made_us, day)
            records = db.execute(
                sa.select(t.assignments).where(made).order_by(t.assignments.c.n)
            ).all()
            self._sorties = day_steps.read_sorties_without_responses(db, day)
        self.assignments = self._timed_assignments(records, audit)
        self._orders = [
            (
                msgspec.json.decode(row.content, type=Order),
                _order_state_changes(
                    row,
                    [a for a in self.assignments if a.row.order_id == row.id],
                    [one for one in audit if one.entry.at_us < (end_us or 0)],
                    is_final=row.id not in carried,
                ),
            )
            for row in orders
        ]

    def _timed_assignments(
        self, assignment_rows: Sequence[sa.Row], audit: list[AuditRow]
    ) -> list[PastAssignment]:
        confirmed = {
            row.entry.subject: row.entry.at_us for row in audit if row.entry.deed == "confirm"
        }
        flew = {row.id: row.launched_us for row in self._sorties}
        for past_event in reversed(self.events):
            if (
                past_event.event.kind is EventKind.PHASE
                and PhaseEvent.parse(past_event.event.text).now == Phase.CLIMB.value
            ):
                flew[past_event.event.assignment or ""] = past_event.received_us
        return [
            PastAssignment(
                row=(row := rows.assignment_from_database_row(found)),
                created_us=found.made_us,
                ended_us=found.ended_us,
                flight_start_us=flew.get(row.id),
                confirmed_us=confirmed.get(f"{row.vehicle}: {row.id}"),
            )
            for found in assignment_rows
        ]

    @property
    def time_span_us(self) -> tuple[int, int] | None:
        """Return the first and last time stamp; None for an empty store."""
        found = [change.at_us for _, changes in self._orders for change in changes]
        found += [past_event.received_us for past_event in self.events]
        found += [plan.stored_us for plan in self.plans]
        found += [stamp for a in self.assignments for stamp in (a.created_us, a.ended_us) if stamp]
        return (max(min(found), self._began_us), max(found)) if found else None

    def orders_at(self, t_us: int) -> list[OrderRow]:
        """Return the orders known at this time, in their state then."""
        known = ((order, _last_change_until(changes, t_us)) for order, changes in self._orders)
        return [
            OrderRow(order, was.state, 0, was.reason) for order, was in known if was is not None
        ]

    def assignments_in_force_at(self, t_us: int) -> list[AssignmentRow]:
        """Return the assignments in force at this time."""
        return [one.row_at(t_us) for one in self.assignments if one.is_in_force_at(t_us)]

    def holds_in_force_at(self, t_us: int) -> list[Hold]:
        """Return the holds in force at this time."""
        return [
            past.hold
            for past in self._hold_history
            if past.hold.set_us <= t_us and (past.lifted_us is None or t_us < past.lifted_us)
        ]

    def plan_in_force_at(self, t_us: int) -> PastPlan | None:
        """Return the plan in force at this time."""
        return next((plan for plan in reversed(self.plans) if plan.stored_us <= t_us), None)

    def measured_wind_at(self, t_us: int) -> Forecast | None:
        """Return the measured wind of the latest plan that has one."""
        records = (plan.wind for plan in reversed(self.plans) if plan.stored_us <= t_us)
        return next((wind for wind in records if wind is not None), None)

    def truck_visits_until(self, t_us: int) -> list[StopTimes]:
        """Return the truck's visits up to this time."""
        begun = (stop_times for stop_times in self.visits if stop_times.arrived_us <= t_us)
        return [
            replace(stop_times, departed_us=_stamp_if_past(stop_times.departed_us, t_us))
            for stop_times in begun
        ]

    def truck_visit_at(self, t_us: int) -> StopTimes | None:
        """Return the truck's visit at this time, None while it drives."""
        previous_stops = (stop_times for stop_times in self.visits if stop_times.arrived_us <= t_us)
        return next(
            (v for v in previous_stops if v.departed_us is None or t_us < v.departed_us), None
        )

    def next_truck_stop_at(self, t_us: int) -> str | None:
        """Return the last stop ordered by this time, else the next stop that the truck reached."""
        ordered_stops = [stop for at_us, stop in self._drives if at_us <= t_us]
        later_stops = [
            stop_times.stop for stop_times in self.visits if stop_times.arrived_us > t_us
        ]
        return next(iter((*ordered_stops[-1:], *later_stops)), None)

    def sorties_at(self, t_us: int) -> list[SortieRow]:
        """Return the sorties assigned by this time, in their state then."""
        times = {one.row.id: one for one in self.assignments}
        begun = (row for row in self._sorties if times[row.id].created_us <= t_us)
        return [self._sortie_at(row, times[row.id], t_us) for row in begun]

    def _sortie_at(self, row: SortieRow, past_assignment: PastAssignment, t_us: int) -> SortieRow:
        over = not past_assignment.is_in_force_at(t_us)
        moved_us = self._first_event_received_us(row.id, EventKind.DECISION, "home_moved")
        moved = over if moved_us is None else moved_us <= t_us
        return replace(
            row,
            assignment=past_assignment.row_at(t_us),
            promised_stop=row.promised_stop if moved else row.sortie.home,
            requested_stop=None,
            put_on_pad=_was_flag_set_at(
                self._first_event_received_us(row.id, EventKind.DRONE_ON_PAD), row.put_on_pad, t_us
            ),
            recovered=_was_flag_set_at(
                self._first_event_received_us(row.id, EventKind.RECOVERED), row.recovered, t_us
            ),
            is_off_site=row.is_off_site and over,
            is_overdue=row.is_overdue and over,
            launched_us=_stamp_if_past(row.launched_us, t_us),
            landed_us=_stamp_if_past(row.landed_us, t_us),
            launch_pending=False,
            recovery_ordered=False,
        )

    def _first_event_received_us(
        self, assignment: str, kind: EventKind, decision_kind: str = ""
    ) -> int | None:
        found = (
            past_event.received_us
            for past_event in self.events
            if past_event.event.assignment == assignment
            and past_event.event.kind is kind
            and decision_kind in ("", DecisionEvent.parse(past_event.event.text).kind)
        )
        return next(found, None)


def _was_flag_set_at(received_us: int | None, final_value: bool, t_us: int) -> bool:
    return final_value and received_us is not None and received_us <= t_us


def _stamp_if_past(stamp_us: int | None, t_us: int) -> int | None:
    return stamp_us if stamp_us is not None and stamp_us <= t_us else None


def _last_change_until(changes: list[_StateChange], t_us: int) -> _StateChange | None:
    found = bisect_right(changes, t_us, key=lambda change: change.at_us)
    return changes[found - 1] if found else None


def _order_state_changes(
    order_row: sa.Row,
    assignments: list[PastAssignment],
    audit: list[AuditRow],
    *,
    is_final: bool,
) -> list[_StateChange]:
    """Return the state changes of an order, oldest first; `is_final`: the last is the store's
    state.
    """
    found = [_StateChange(order_row.taken_us, OrderState.OPEN)]
    for attempt, past in enumerate(assignments, start=1):
        found.append(_StateChange(past.created_us, OrderState.ASSIGNED))
        if past.ended_us is not None:
            state = order_state_after_assignment(past.row.state, past.row.delivered, attempt)
            found.append(_StateChange(past.ended_us, state, past.row.reason))
    found += _operator_order_state_changes(order_row.id, audit)
    found.sort(key=lambda change: change.at_us)
    if is_final:
        found[-1] = _StateChange(found[-1].at_us, OrderState(order_row.state), order_row.why)
    return found


def _operator_order_state_changes(order_id: str, audit: list[AuditRow]) -> Iterator[_StateChange]:
    for entry in (row.entry for row in audit if row.entry.subject == order_id):
        if entry.deed == "order":
            state, _, reason = entry.answer.partition(": ")
            by = ", ".join(filter(None, (reason, f"by {entry.who}")))
            yield _StateChange(entry.at_us, OrderState(state), by)
        elif entry.deed == "settle":
            settled = ParcelOutcome(entry.answer.partition(",")[0])
            yield _StateChange(
                entry.at_us, assignment_and_order_state_after_outcome(settled)[1], entry.answer
            )


def _read_past_plans(db: sa.Connection, day: str | None) -> list[PastPlan]:
    plans, here = days.plans_of(day)
    found = db.execute(sa.select(plans).where(here).order_by(plans.c.made_us, plans.c.revision))
    return [
        PastPlan(
            row.made_us,
            msgspec.json.decode(row.content, type=DayPlan),
            None if row.wind is None else msgspec.json.decode(row.wind, type=Forecast),
        )
        for row in found
    ]


def _read_drive_orders(db: sa.Connection, day: str | None) -> list[tuple[int, str]]:
    query = sa.select(t.commands.c.made_us, t.commands.c.deed).order_by(t.commands.c.n)
    query = query.where(days.during(t.commands.c.made_us, day))
    found = (
        (row.made_us, msgspec.json.decode(row.deed, type=CommandAction))
        for row in db.execute(query)
    )
    return [(created_us, action.stop) for created_us, action in found if isinstance(action, Drive)]
