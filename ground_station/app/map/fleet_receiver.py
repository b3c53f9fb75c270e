"""Receives a fleet's states and keeps its status and tracks; it writes no data and sends only
requests for states.

Unlike a desk's exchange it stores no events: the map shows decisions that a desk has stored.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

from companion.core.base.geo import ne_offset_m
from companion.fleet.messages import State
from ground_station.app.desk.site.station_desk import StationMonitor
from ground_station.core.fleet.fleet_link import (
    Clock,
    DeskHeartbeatReceived,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
    StationWindReceived,
)
from ground_station.core.fleet.fleet_status import FLIGHT_PHASE_NAMES, FleetStatus
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.fleet.uploaded_route import MissionRoute, route_from_state
from ground_station.core.site_wind.site_wind import SiteWind

STATE_REQUEST_INTERVAL_S = 2.0
"""Minimum interval of state requests to all members."""

RESPONSE_TIMEOUT_S = 5.0
MIN_COURSE_DISTANCE_M = 3.0
"""Shorter moves are receiver noise: the course is kept."""

MAX_SAMPLES = 3600
"""Samples of each drone's margin and return probability: an hour of states."""

LatLon = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ReturnMarginSample:
    """Reported margin and return probability of a drone. `received_us`: receive time."""

    received_us: int
    margin_wh: float | None
    p_home: float | None


@dataclass(slots=True)
class VehicleTrack:
    """Course of a drone, its reported margins and probabilities, and its uploaded route."""

    course_deg: float | None = None
    received_us: int | None = None
    course_origin: LatLon | None = None
    margin_samples: deque[ReturnMarginSample] = field(
        default_factory=lambda: deque(maxlen=MAX_SAMPLES)
    )
    route: MissionRoute | None = None
    airborne_since_us: int | None = None
    """Start of the current flight, if it was observed."""

    def update_course_from_position(self, position_deg: LatLon) -> None:
        """Update the position."""
        if self.course_origin is None:
            self.course_origin = position_deg
            return
        north_m, east_m = ne_offset_m(*self.course_origin, *position_deg)
        if math.hypot(north_m, east_m) >= MIN_COURSE_DISTANCE_M:
            self.course_deg = math.degrees(math.atan2(east_m, north_m)) % 360.0
            self.course_origin = position_deg


class StateSource(Protocol):
    """Network access of a map. It has no method that sends a command."""

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Return all received messages; wait this long for the first."""
        ...

    def request_states(self, wait_s: float) -> None:
        """Request the latest state of every member."""
        ...


@dataclass(slots=True)
class FleetListener:
    """One listener. `wind`: wind field to update, if needed; `stations`: wind stations to process
    in addition.
    """

    fleet: StateSource
    clock: Clock
    status: FleetStatus
    wind: SiteWind | None = None
    stations: StationMonitor | None = None
    tracks: dict[str, VehicleTrack] = field(default_factory=dict)
    _states_required: bool = True
    _states_requested_s: float | None = None

    def receive_and_process_messages(self, wait_s: float) -> None:
        """Process received messages, waiting this long for the first."""
        for received in self.fleet.receive(wait_s):
            match received:
                case StateReceived():
                    self._process_state(received.state)
                case LivelinessChanged():
                    self.status.record_liveliness_change(
                        received.vehicle, received.instance_id, has_joined=received.has_joined
                    )
                    self._states_required = self._states_required or received.has_joined
                case StationWindReceived():
                    self._process_station(received.wind)
                case DeskHeartbeatReceived():
                    self.status.record_desk_heartbeat(received.heartbeat, self.clock)
                case MessageRejected():
                    self._states_required = True
                case _:
                    pass  # the desk processes events and responses
        if self.stations is not None:
            self.stations.poll_files_for_front_updates(self.clock.monotonic_s())
        self._request_states_if_due()

    def _process_station(self, wind: StationWind) -> None:
        if self.stations is not None:
            self.stations.process_station_report(wind)

    def get_or_create_track(self, vehicle: str) -> VehicleTrack:
        """Return a member's track; empty before its first state."""
        return self.tracks.setdefault(vehicle, VehicleTrack())

    def _process_state(self, state: State) -> None:
        now_s, now_us = self.clock.monotonic_s(), self.clock.epoch_us()
        self.status.record_state_and_new_doubts(state, now_s, now_us)
        if self.status.status_of(state.vehicle).state is not state:
            return  # an outdated state
        track = self.get_or_create_track(state.vehicle)
        track.received_us = now_us
        if state.lat_deg is not None and state.lon_deg is not None:
            track.update_course_from_position((state.lat_deg, state.lon_deg))
        track.route = route_from_state(state)
        if state.phase not in FLIGHT_PHASE_NAMES:
            track.airborne_since_us = None
        elif track.airborne_since_us is None:
            track.airborne_since_us = now_us
        if self.wind is not None:
            self.wind.update_from_state(state, now_s)
        if state.p_home is not None or state.margin_wh is not None:
            track.margin_samples.append(ReturnMarginSample(now_us, state.margin_wh, state.p_home))

    def _request_states_if_due(self) -> None:
        now_s = self.clock.monotonic_s()
        if self._states_required and (
            self._states_requested_s is None
            or now_s - self._states_requested_s >= STATE_REQUEST_INTERVAL_S
        ):
            self._states_required, self._states_requested_s = False, now_s
            self.fleet.request_states(RESPONSE_TIMEOUT_S)
