"""Listens to a fleet and keeps its status and tracks; it writes nothing and asks for states only.

Unlike a desk's exchange it takes no event into the store: what the map says of a decision is what
a desk has written down.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

from companion.core.base.geo import offset_m
from companion.fleet.messages import State
from ground_station.app.desk.station_desk import StationDesk
from ground_station.core.fleet.fleet_link import (
    Clock,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
    StationWindReceived,
)
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.route_aboard import RouteAboard, route_of
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.site_wind.site_wind import SiteWind

ASK_S = 2.0
"""All are asked for their states at most so often, however many join."""

ANSWER_S = 5.0
MOVED_M = 3.0
"""Shorter moves are the receiver's noise: the course stays."""

KEPT = 3600
"""Samples of each drone's promise: an hour of states."""

Place = tuple[float, float]
WindCov = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PromiseSample:
    """What a drone said of its promise. `heard_us`: when."""

    heard_us: int
    margin_wh: float | None
    p_home: float | None


@dataclass(slots=True)
class VehicleTrack:
    """Where a drone moves to, what it said of its promise, the way that is aboard.

    `wind_cov_m2ps2`: of its own estimate of the wind, [nn, ne, ee]; None: not told.
    """

    course_deg: float | None = None
    heard_us: int | None = None
    from_: Place | None = None
    promises: deque[PromiseSample] = field(default_factory=lambda: deque(maxlen=KEPT))
    route: RouteAboard | None = None
    wind_cov_m2ps2: WindCov | None = None

    def move(self, at: Place) -> None:
        """It is here now."""
        if self.from_ is None:
            self.from_ = at
            return
        north_m, east_m = offset_m(*self.from_, *at)
        if math.hypot(north_m, east_m) >= MOVED_M:
            self.course_deg = math.degrees(math.atan2(east_m, north_m)) % 360.0
            self.from_ = at


class StateSource(Protocol):
    """All that a map needs of a fleet's network: it has no way to send a command."""

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Everything that has come; waits this long for the first."""
        ...

    def ask_states(self, wait_s: float) -> None:
        """Ask every member for its newest state."""
        ...


@dataclass(slots=True)
class FleetEar:
    """One listener. `wind`: what the fleet tells of it, where somebody wants to know; `stations`:
    those that are heard beside it.
    """

    fleet: StateSource
    clock: Clock
    status: FleetStatus
    wind: SiteWind | None = None
    stations: StationDesk | None = None
    tracks: dict[str, VehicleTrack] = field(default_factory=dict)
    _states_wanted: bool = True
    _asked_s: float | None = None

    def listen(self, wait_s: float) -> None:
        """Take what has come, waiting this long for the first."""
        for received in self.fleet.receive(wait_s):
            match received:
                case StateReceived():
                    self._take_state(received.state)
                case LivelinessChanged():
                    self.status.on_liveliness(received.vehicle, received.life, up=received.up)
                    self._states_wanted = self._states_wanted or received.up
                case StationWindReceived():
                    self._take_station(received.wind)
                case MessageRejected():
                    self._states_wanted = True
                case _:
                    pass  # events and answers are the desk's
        if self.stations is not None:
            self.stations.turn(self.clock.monotonic_s())
        self._ask()

    def _take_station(self, wind: StationWind) -> None:
        if self.stations is not None:
            self.stations.take(wind)

    def track_of(self, vehicle: str) -> VehicleTrack:
        """A member's track; empty before it is heard."""
        return self.tracks.setdefault(vehicle, VehicleTrack())

    def _take_state(self, state: State) -> None:
        now_s, now_us = self.clock.monotonic_s(), self.clock.epoch_us()
        self.status.on_state(state, now_s, now_us)
        if self.status.of(state.vehicle).state is not state:
            return  # an old one
        track = self.track_of(state.vehicle)
        track.heard_us = now_us
        if state.lat_deg is not None and state.lon_deg is not None:
            track.move((state.lat_deg, state.lon_deg))
        track.route = route_of(state)
        track.wind_cov_m2ps2 = state.wind_cov_m2ps2 or None
        if self.wind is not None:
            self.wind.on_state(state, now_s)
        if state.p_home is not None or state.margin_wh is not None:
            track.promises.append(PromiseSample(now_us, state.margin_wh, state.p_home))

    def _ask(self) -> None:
        now_s = self.clock.monotonic_s()
        if self._states_wanted and (self._asked_s is None or now_s - self._asked_s >= ASK_S):
            self._states_wanted, self._asked_s = False, now_s
            self.fleet.ask_states(ANSWER_S)
