"""Answers for a page that shows the past: any moment of it, rebuilt when it is asked for."""

from bisect import bisect_right
from collections import defaultdict
from functools import cached_property
from threading import Lock
from typing import Any

from msgspec.structs import replace

from companion.fleet.messages import EventKind, State
from ground_station.adapters.store.decision_reader import HeardDecision
from ground_station.adapters.store.past_store import PastEvent, PastStore
from ground_station.app.map.fleet_ear import PromiseSample, VehicleTrack
from ground_station.app.map.flight_decisions import FlightDecisions
from ground_station.app.map.map_feed import history_of
from ground_station.app.map.map_view import MapView, Moment, StoreReading
from ground_station.app.map.picture import Point
from ground_station.app.map.replay.past_flight import PastFlight, RecordFiles
from ground_station.app.views.watched_rows import DayShown, WatchRows
from ground_station.core.fleet.fleet_status import STANDBY, FleetStatus
from ground_station.core.fleet.truck_state import AT_STOP, DRIVING, TRUCK
from ground_station.core.schema.orders import AssignmentRow

MARKS = ("divert", "turn_back", "last_resort", "position_lost", "mission_lost", "suspended")
"""Decisions that are marked on the scrubber."""

UNRECORDED = "shown by what the desk was told, without its place"
NO_SPAN = (0, 1)


class ReplayFeed:
    """The past of one fleet. Its answers are asked for by several threads."""

    def __init__(
        self, view: MapView, store: PastStore | None, files: tuple[RecordFiles, ...]
    ) -> None:
        self._view, self._store, self._lock = view, store, Lock()
        events = defaultdict[str | None, list[PastEvent]](list)
        for heard in () if store is None else store.events:
            events[heard.event.assignment].append(heard)
        self.flights = [PastFlight(one, events[one.assignment]) for one in files]
        self._decisions = self._all_decisions()
        self._span_us = self._whole_span()

    def _all_decisions(self) -> list[PastEvent]:
        """The desk's; of flights that no desk heard, their own records'."""
        heard = [] if self._store is None else self._store.events
        found = [one for one in heard if one.event.kind is EventKind.DECISION]
        known = {one.event.assignment for one in found}
        for flight in self.flights:
            if flight.assignment not in known:
                found += flight.decisions()
        return sorted(found, key=lambda one: one.heard_us)

    def _whole_span(self) -> tuple[int, int]:
        spans = [] if self._store is None else [self._store.span_us]
        if not any(spans):
            spans = [flight.span_us for flight in self.flights]
        there = [span for span in spans if span is not None]
        if not there:
            return NO_SPAN
        return min(span[0] for span in there), max(span[1] for span in there)

    @cached_property
    def troubles(self) -> tuple[str, ...]:
        """What is wrong with the records, and which are missing; reads them all."""
        found = [words for flight in self.flights if (words := flight.trouble) is not None]
        return (*found, *self._missing())

    def _missing(self) -> list[str]:
        flown = [] if self._store is None else self._store.assignments
        known = {flight.assignment for flight in self.flights}
        rows = [one.row for one in flown if one.flew_us is not None]
        missing = [row for row in rows if row.id not in known and row.vehicle != TRUCK]
        if missing and not known:
            return [f"no records of flights (--records FOLDER): {UNRECORDED}"]
        return [f"{row.vehicle} ({row.id}): no record: {UNRECORDED}" for row in missing]

    def span(self) -> dict[str, Any]:
        """From when to when, and what happened: for the page's scrubber."""
        first_us, last_us = self._span_us
        marks = [
            {"t_us": one.heard_us, "words": f"{one.event.vehicle}: {one.event.text}"}
            for one in self._decisions
            if one.event.text.partition(": ")[0] in MARKS
        ]
        return {"from_us": first_us, "to_us": last_us, "marks": marks}

    def moment(self, t_us: int) -> dict[str, Any]:
        """The picture of this time."""
        with self._lock:  # the records are read once
            return self._view.picture(self._moment(t_us))

    def history(self, vehicle: str, t_us: int) -> list[dict[str, Any]] | None:
        """What a drone had said of its promise on this flight."""
        with self._lock:
            flight = self._flight(vehicle, t_us)
            if flight is not None:
                return history_of(list(flight.track(t_us).promises))
            heard = (one for one in self._until(t_us) if one.event.vehicle == vehicle)
            samples = [PromiseSample(h.heard_us, h.event.margin_wh, h.event.p_home) for h in heard]
            return history_of(samples) or None

    def reach(self, vehicle: str, t_us: int) -> list[Point] | None:
        """Where a drone could still have landed."""
        with self._lock:
            moment = self._moment(t_us)
            seen = moment.status.vehicles.get(vehicle)
            if seen is None or seen.state is None:
                return None
            return self._view.reach(seen.state, moment.read)

    # --- a moment ------------------------------------------------------------------------------

    def _moment(self, t_us: int) -> Moment:
        read = self._read(t_us)
        status, tracks = FleetStatus(), dict[str, VehicleTrack]()
        for state, track in self._states(read.rows, t_us):
            status.on_liveliness(state.vehicle, state.life, up=True)
            status.on_state(state, t_us / 1e6, t_us)
            tracks[state.vehicle] = track
        decisions = FlightDecisions()
        for one in self._until(t_us):
            decisions.note(HeardDecision(one.heard_us, one.event))
        return Moment(t_us / 1e6, status, tracks, decisions, read, notes=self.troubles)

    def _until(self, t_us: int) -> list[PastEvent]:
        end = bisect_right(self._decisions, t_us, key=lambda one: one.heard_us)
        return self._decisions[:end]

    def _read(self, t_us: int) -> StoreReading:
        past = self._store
        if past is None:
            return StoreReading()
        plan = past.plan(t_us)
        day = None
        if plan is not None:
            began = past.began_us
            began = began if began is not None and began <= t_us else None
            visits = past.visits_until(t_us)
            day = DayShown(plan.plan, past.sorties(t_us), began, t_us, visits)
        rows = WatchRows(past.in_force(t_us), past.orders(t_us), day, past.holds(t_us))
        return StoreReading.of(rows, past.wind(t_us))

    def _states(self, rows: WatchRows, t_us: int) -> list[tuple[State, VehicleTrack]]:
        truck = [] if rows.day is None else [(self._truck(t_us), VehicleTrack(heard_us=t_us))]
        held = {row.vehicle: row for row in rows.assignments}
        names = {flight.vehicle for flight in self.flights} | held.keys() - {TRUCK}
        found = (self._drone(name, held.get(name), rows, t_us) for name in sorted(names))
        return truck + [one for one in found if one is not None]

    def _drone(
        self, name: str, row: AssignmentRow | None, rows: WatchRows, t_us: int
    ) -> tuple[State, VehicleTrack] | None:
        flight = self._flight(name, t_us)
        order = None if row is None else row.order_id
        state = None if flight is None else flight.state(t_us, order)
        if flight is not None and state is not None:
            return state, flight.track(t_us)
        sortie = None if rows.day is None else rows.day.sortie(name)
        if rows.day is not None and (sortie is None or sortie.launched_us is None):
            return None  # on the truck, or on its pad and not switched on
        if row is not None:
            return self._without_record(row, t_us), VehicleTrack(heard_us=t_us)
        return self._at_rest(name, t_us)

    def _flight(self, vehicle: str, t_us: int) -> PastFlight | None:
        mine = (one for one in self.flights if one.vehicle == vehicle and one.covers(t_us))
        return next(mine, None)

    def _at_rest(self, name: str, t_us: int) -> tuple[State, VehicleTrack] | None:
        """A drone that stands where its last flight ended."""
        before = [
            f for f in self.flights if f.vehicle == name and (f.span_us or (t_us,))[-1] < t_us
        ]
        if not before:
            return None
        last = max(before, key=lambda flight: flight.span_us or NO_SPAN)
        state = last.state(t_us, None)
        if state is None:
            return None
        changes = {"phase": STANDBY, "assignment": None, "armed": False, "margin_wh": None}
        return replace(state, **changes), VehicleTrack(heard_us=t_us)

    def _without_record(self, row: AssignmentRow, t_us: int) -> State:
        """What the desk was told, where there is no record: phase and promise, but no place."""
        events = [] if self._store is None else self._store.events
        told = (one.event for one in events if one.heard_us <= t_us)
        mine = [e for e in told if (e.assignment, e.vehicle) == (row.id, row.vehicle)]
        phases = [event.text for event in mine if event.kind is EventKind.PHASE]
        priced = [event for event in mine if event.margin_wh is not None]
        phase = phases[-1].partition("-> ")[2].partition(":")[0] if phases else "no record"
        return State(
            vehicle=row.vehicle,
            life="record",
            uptime_s=0.0,
            epoch_us=t_us,
            airframe="recorded",
            max_payload_kg=0.0,
            phase=phase,
            log="record",
            last_seq=0,
            assignment=row.id,
            order=row.order_id,
            margin_wh=priced[-1].margin_wh if priced else None,
            p_home=priced[-1].p_home if priced else None,
        )

    def _truck(self, t_us: int) -> State:
        assert self._store is not None
        visit = self._store.visit(t_us)
        return State(
            vehicle=TRUCK,
            life="record",
            uptime_s=0.0,
            epoch_us=t_us,
            airframe=TRUCK,
            max_payload_kg=0.0,
            phase=DRIVING if visit is None else AT_STOP,
            log="record",
            last_seq=0,
            stop=self._store.next_stop(t_us) if visit is None else visit.stop,
        )
