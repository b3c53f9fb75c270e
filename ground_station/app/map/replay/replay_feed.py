"""Responses to a page that shows the past: any moment, rebuilt on request."""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Collection
from functools import cached_property
from threading import Lock
from typing import Any

from msgspec.structs import replace

from companion.core.mission.event_text import DecisionEvent, PhaseEvent
from companion.fleet.messages import EventKind, State
from ground_station.adapters.store.decision_reader import ReceivedDecision
from ground_station.adapters.store.past_store import PastEvent, PastStore
from ground_station.app.map.fleet_receiver import ReturnMarginSample, VehicleTrack
from ground_station.app.map.flight_decisions import FlightDecisions
from ground_station.app.map.map_feed import thinned_margin_history_json
from ground_station.app.map.map_snapshot import MapSnapshot, StoreSnapshot
from ground_station.app.map.map_view import MapView
from ground_station.app.map.picture import Point
from ground_station.app.map.replay.past_flight import FlightRecordFiles, PastFlight
from ground_station.app.views.day_content import DayShown, DisplayRows
from ground_station.core.fleet.fleet_status import STANDBY, FleetStatus
from ground_station.core.fleet.truck_state import AT_STOP, EN_ROUTE, TRUCK
from ground_station.core.schema.orders import AssignmentRow

MARKED_KINDS = ("divert", "turn_back", "last_resort", "position_lost", "mission_lost", "suspended")
"""Decision kinds that are marked on the time line."""

NO_RECORD_TEXT = "shown from the desk's events, without position"
EMPTY_SPAN_US = (0, 1)


class ReplayDataSource:
    """Past of one fleet. Several threads call it."""

    def __init__(
        self, view: MapView, store: PastStore | None, files: tuple[FlightRecordFiles, ...]
    ) -> None:
        self._view, self._store, self._lock = view, store, Lock()
        events = defaultdict[str | None, list[PastEvent]](list)
        for received_events in () if store is None else store.events:
            events[received_events.event.assignment].append(received_events)
        self.flights = [PastFlight(one, events[one.assignment]) for one in files]
        self._decisions = self._combined_decisions()
        self._span_us = self._replay_time_span_us()

    def _combined_decisions(self) -> list[PastEvent]:
        """Return the desk's decisions; for flights unknown to the desk, those of their records."""
        received_events = [] if self._store is None else self._store.events
        found = [one for one in received_events if one.event.kind is EventKind.DECISION]
        known = {one.event.assignment for one in found}
        for flight in self.flights:
            if flight.assignment not in known:
                found += flight.rebuilt_decision_events()
        return sorted(found, key=lambda one: one.received_us)

    def _replay_time_span_us(self) -> tuple[int, int]:
        spans = [] if self._store is None else [self._store.time_span_us]
        if not any(spans):
            spans = [flight.record_time_span_us for flight in self.flights]
        known_spans = [span for span in spans if span is not None]
        if not known_spans:
            return EMPTY_SPAN_US
        return min(span[0] for span in known_spans), max(span[1] for span in known_spans)

    @cached_property
    def record_fault_texts(self) -> tuple[str, ...]:
        """Faults of the records, and missing ones; reads all records."""
        found = [
            fault for flight in self.flights if (fault := flight.record_fault_text) is not None
        ]
        return (*found, *self._missing_record_texts())

    def _missing_record_texts(self) -> list[str]:
        flown = [] if self._store is None else self._store.assignments
        known = {flight.assignment for flight in self.flights}
        rows = [one.row for one in flown if one.flight_start_us is not None]
        missing = [row for row in rows if row.id not in known and row.vehicle != TRUCK]
        if missing and not known:
            return [f"no records of flights (--records FOLDER): {NO_RECORD_TEXT}"]
        return [f"{row.vehicle} ({row.id}): no record: {NO_RECORD_TEXT}" for row in missing]

    def time_line_data(self) -> dict[str, Any]:
        """Return start, end and marked decisions of the past, for the page's time line."""
        first_us, last_us = self._span_us
        marks = [
            {"t_us": one.received_us, "words": f"{one.event.vehicle}: {one.event.text}"}
            for one in self._decisions
            if DecisionEvent.parse(one.event.text).kind in MARKED_KINDS
        ]
        return {"from_us": first_us, "to_us": last_us, "marks": marks}

    def picture_at(self, t_us: int) -> dict[str, Any]:
        """Return the picture at this time."""
        with self._lock:  # so that the records are read only once
            return self._view.build_picture(self._map_snapshot_at(t_us))

    def margin_history_until(self, vehicle: str, t_us: int) -> list[dict[str, Any]] | None:
        """Return a drone's margins and probabilities on this flight until this time."""
        with self._lock:
            flight = self._flight_at(vehicle, t_us)
            if flight is not None:
                return thinned_margin_history_json(list(flight.track_at(t_us).margin_samples))
            received_events = (
                one for one in self._decisions_until(t_us) if one.event.vehicle == vehicle
            )
            samples = [
                ReturnMarginSample(h.received_us, h.event.margin_wh, h.event.p_home)
                for h in received_events
            ]
            return thinned_margin_history_json(samples) or None

    def reachable_area_boundary_at(self, vehicle: str, t_us: int) -> list[Point] | None:
        """Return the ring within which a drone could still land."""
        with self._lock:
            snapshot = self._map_snapshot_at(t_us)
            vehicle_status = snapshot.status.vehicles.get(vehicle)
            if vehicle_status is None or vehicle_status.state is None:
                return None
            return self._view.reachable_area_boundary(vehicle_status.state, snapshot.store)

    # --- a moment ------------------------------------------------------------------------------

    def _map_snapshot_at(self, t_us: int) -> MapSnapshot:
        decisions = FlightDecisions()
        for one in self._decisions_until(t_us):
            decisions.record_decision(ReceivedDecision(one.received_us, one.event))
        store_snapshot = self._store_snapshot_at(t_us, decisions.releases)
        status, tracks = FleetStatus(), dict[str, VehicleTrack]()
        for state, track in self._states_and_tracks_at(store_snapshot.rows, t_us):
            status.record_liveliness_change(state.vehicle, state.instance_id, has_joined=True)
            status.record_state_and_new_doubts(state, t_us / 1e6, t_us)
            tracks[state.vehicle] = track
        return MapSnapshot(
            t_us / 1e6,
            status,
            tracks,
            decisions,
            store_snapshot,
            notes=self.record_fault_texts,
            epoch_us=t_us,
        )

    def _decisions_until(self, t_us: int) -> list[PastEvent]:
        end = bisect_right(self._decisions, t_us, key=lambda one: one.received_us)
        return self._decisions[:end]

    def _store_snapshot_at(self, t_us: int, released: Collection[str]) -> StoreSnapshot:
        past = self._store
        if past is None:
            return StoreSnapshot()
        plan = past.plan_in_force_at(t_us)
        day = None
        if plan is not None:
            start_us = past.start_us
            start_us = start_us if start_us is not None and start_us <= t_us else None
            visits = past.truck_visits_until(t_us)
            day = DayShown(plan.plan, past.sorties_at(t_us), start_us, t_us, visits)
        rows = DisplayRows(
            past.assignments_in_force_at(t_us),
            past.orders_at(t_us),
            day,
            past.holds_in_force_at(t_us),
        )
        return StoreSnapshot.from_rows(rows, past.measured_wind_at(t_us), released)

    def _states_and_tracks_at(
        self, rows: DisplayRows, t_us: int
    ) -> list[tuple[State, VehicleTrack]]:
        truck = (
            []
            if rows.day is None
            else [(self._truck_state_at(t_us), VehicleTrack(received_us=t_us))]
        )
        assignments = {row.vehicle: row for row in rows.assignments}
        names = {flight.vehicle for flight in self.flights} | assignments.keys() - {TRUCK}
        found = (
            self._drone_state_and_track_at(name, assignments.get(name), rows, t_us)
            for name in sorted(names)
        )
        return truck + [one for one in found if one is not None]

    def _drone_state_and_track_at(
        self, name: str, row: AssignmentRow | None, rows: DisplayRows, t_us: int
    ) -> tuple[State, VehicleTrack] | None:
        flight = self._flight_at(name, t_us)
        order = None if row is None else row.order_id
        state = None if flight is None else flight.state_at(t_us, order)
        if flight is not None and state is not None:
            return state, flight.track_at(t_us)
        sortie = None if rows.day is None else rows.day.active_sortie_of(name)
        if rows.day is not None and (sortie is None or sortie.launched_us is None):
            return None  # on the truck, or on its pad and switched off
        if row is not None:
            return self._state_from_events(row, t_us), VehicleTrack(received_us=t_us)
        return self._resting_state_and_track(name, t_us)

    def _flight_at(self, vehicle: str, t_us: int) -> PastFlight | None:
        own_flights = (
            one for one in self.flights if one.vehicle == vehicle and one.covers_time(t_us)
        )
        return next(own_flights, None)

    def _resting_state_and_track(self, name: str, t_us: int) -> tuple[State, VehicleTrack] | None:
        """Return the state of a drone at rest where its last flight ended."""
        before = [
            f
            for f in self.flights
            if f.vehicle == name and (f.record_time_span_us or (t_us,))[-1] < t_us
        ]
        if not before:
            return None
        last = max(before, key=lambda flight: flight.record_time_span_us or EMPTY_SPAN_US)
        state = last.state_at(t_us, None)
        if state is None:
            return None
        changes = {"phase": STANDBY, "assignment": None, "armed": False, "margin_wh": None}
        return replace(state, **changes), VehicleTrack(received_us=t_us)

    def _state_from_events(self, row: AssignmentRow, t_us: int) -> State:
        """Return the state from the desk's events: phase and probabilities, without position."""
        events = [] if self._store is None else self._store.events
        received = (one.event for one in events if one.received_us <= t_us)
        own_events = [e for e in received if (e.assignment, e.vehicle) == (row.id, row.vehicle)]
        phases = [event.text for event in own_events if event.kind is EventKind.PHASE]
        events_with_margin = [event for event in own_events if event.margin_wh is not None]
        phase = PhaseEvent.parse(phases[-1]).now if phases else "no record"
        return State(
            vehicle=row.vehicle,
            instance_id="record",
            uptime_s=0.0,
            epoch_us=t_us,
            airframe="recorded",
            max_payload_kg=0.0,
            phase=phase,
            log="record",
            last_seq=0,
            assignment=row.id,
            order=row.order_id,
            margin_wh=events_with_margin[-1].margin_wh if events_with_margin else None,
            p_home=events_with_margin[-1].p_home if events_with_margin else None,
        )

    def _truck_state_at(self, t_us: int) -> State:
        assert self._store is not None
        stop_times = self._store.truck_visit_at(t_us)
        return State(
            vehicle=TRUCK,
            instance_id="record",
            uptime_s=0.0,
            epoch_us=t_us,
            airframe=TRUCK,
            max_payload_kg=0.0,
            phase=EN_ROUTE if stop_times is None else AT_STOP,
            log="record",
            last_seq=0,
            stop=self._store.next_truck_stop_at(t_us) if stop_times is None else stop_times.stop,
        )
