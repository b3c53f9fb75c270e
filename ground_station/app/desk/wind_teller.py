"""The desk's word to each vehicle that flies, or is about to: the winds that others feel.

It passes on tellings of those that it believes itself, nearest first, and a front as soon as it is
known. What a vehicle makes of them is the vehicle's to decide.
"""

import math
from dataclasses import dataclass, field
from heapq import nsmallest

import msgspec

from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.shared_winds import (
    MOST_AGE_S,
    MOST_TOLD,
    TOLD_EVERY_S,
    SharedWinds,
    ToldWind,
    told_front,
)
from companion.core.wind_field.tellings import WindTelling
from companion.fleet.messages import State
from ground_station.core.fleet.fleet_link import FleetLink
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.site_wind.site_fronts import FRONT_KEPT_S
from ground_station.core.site_wind.site_wind import SiteWind

FRONT_TOLD_TIMES = 3
"""A front that is new, better known or withdrawn is told so often: words may be lost."""


MOST_A_TURN = 50
"""Words in one turn of the desk: each is worked out and signed in less than a millisecond, and a
thousand members tell and are told meanwhile.
"""


@dataclass(slots=True)
class _Told:
    """What one vehicle was told last."""

    t_s: float = -math.inf
    front: FrontAhead | None = None
    """None: no front, or one that is withdrawn."""
    front_times: int = FRONT_TOLD_TIMES


@dataclass(slots=True)
class WindTeller:
    """One desk's. Times are of its own clock."""

    wind: SiteWind
    fleet: FleetLink
    _told: dict[str, _Told] = field(default_factory=dict)

    def turn(self, status: FleetStatus, now_s: float) -> None:
        """Tell all who are due."""
        fronts = self.wind.fronts_now(now_s)
        front = fronts[-1] if fronts else None
        due = self._due(status, front, now_s)
        believed = self.wind.believed(now_s, MOST_AGE_S) if due else []
        for told, state, heard_s in due:
            if front is not told.front:
                told.front, told.front_times = front, 0
            winds = self._word(state, heard_s, believed, told)
            if winds is not None:
                told.t_s = now_s
                told.front_times += 1
                self.fleet.tell_winds(winds)

    def _due(
        self, status: FleetStatus, front: FrontAhead | None, now_s: float
    ) -> list[tuple[_Told, State, float]]:
        """Who is to be told now, the longest untold first, with his state and when it was heard."""
        due: list[tuple[_Told, State, float]] = []
        for name in sorted(status.vehicles):
            seen = status.of(name)
            state = seen.state
            if state is None or seen.heard_s is None or not seen.present(now_s):
                continue
            told = self._told.setdefault(name, _Told())
            if told.front is not None and now_s - told.front.noticed_s > FRONT_KEPT_S:
                told.front = None  # it has left the site, and is not withdrawn
            new = front is not told.front
            if _may_fly(state) and (new or now_s - told.t_s >= TOLD_EVERY_S):
                due.append((told, state, seen.heard_s))
        due.sort(key=lambda one: one[0].t_s)
        return due[:MOST_A_TURN]

    def _word(
        self, state: State, heard_s: float, believed: list[WindTelling], told: _Told
    ) -> SharedWinds | None:
        """The word that rests on this state, heard at `heard_s`; None: there is nothing to tell."""
        assert state.lat_deg is not None
        assert state.lon_deg is not None
        north, east = here = self.wind.place_ne_m(state.lat_deg, state.lon_deg)
        others = [one for one in believed if one.member != state.vehicle]
        others = nsmallest(
            MOST_TOLD, others, key=lambda one: (math.dist(one.place_ne_m, here), one.member)
        )
        winds = [
            ToldWind.of(one, one.place_ne_m[0] - north, one.place_ne_m[1] - east, heard_s - one.t_s)
            for one in others
            if heard_s - one.t_s <= MOST_AGE_S
        ]
        front = msgspec.UNSET
        if told.front_times < FRONT_TOLD_TIMES:
            front = None if told.front is None else told_front(told.front, here, heard_s)
        if not winds and front is msgspec.UNSET:
            return None
        return SharedWinds(
            vehicle=state.vehicle,
            life=state.life,
            as_of_s=round(state.uptime_s, 1),
            lat_deg=round(state.lat_deg, 4),
            lon_deg=round(state.lon_deg, 4),
            told=winds,
            front=front,
        )


def _may_fly(state: State) -> bool:
    """Whether it flies, or has what to fly for, and is where its state says."""
    placed = state.lat_deg is not None and state.lon_deg is not None
    return placed and state.airframe != TRUCK and bool(state.armed or state.assignment)
