"""The remaining mission at a moment of a recorded flight, with its flight file or without one."""

import math
from dataclasses import replace
from typing import Protocol

from companion.core.base.geo import LocalFrame, Ned, horizontal_m
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import DROP_S, FlightPlan, ned_of
from companion.core.mission.mission_items import Part
from companion.core.pilot.parcel_release import observe_hover, watch_for
from companion.core.pilot.return_decision import rally_in_sight
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.return_budget.remaining_from_plan import (
    ahead_away,
    ahead_delivering,
    ahead_outbound,
    ahead_returning,
)
from companion.core.return_budget.remaining_mission import Ahead, Stage, WayHome
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy

GOES_ON_S = 30.0
"""Without a plan the gate is asked: and if it goes on like this for so long, and then home?"""

HOVERS_MPS = 1.0
REACHED_M = 20.0
LEFT_M = 30.0
GIVES_UP_M = 100.0
SINKS_M = 5.0
TAKE_OFF = "take-off"


class Route(Protocol):
    """Follows a recorded flight and tells what is ahead of it. `stage` names where it is."""

    stage: str

    def look(self, now: TelemetryState) -> Ned | None: ...
    def ahead(self, here: Ned, payload_kg: float) -> Ahead: ...


class Unplanned:
    """No plan is known: home is the take-off point, straight, at the height it has."""

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self._velocity_ne_mps = (0.0, 0.0)
        self.stage = "in flight"

    def look(self, now: TelemetryState) -> Ned | None:
        """Take the moment in; returns where the vehicle is."""
        if now.position is None:
            return None
        self._velocity_ne_mps = (now.position.vel_n_mps, now.position.vel_e_mps)
        return ned_of(self._frame, now.position)

    def ahead(self, here: Ned, payload_kg: float) -> Ahead:
        """The way home from here, and from where it will be if it goes on like this."""
        north, east = self._velocity_ne_mps
        speed = math.hypot(north, east)
        if speed > HOVERS_MPS:
            there = (here[0] + GOES_ON_S * north, here[1] + GOES_ON_S * east, here[2])
            on = Leg(LegKind.CRUISE, here, there, payload_kg, ground_speed_mps=speed)
        else:
            there = here
            on = Leg(LegKind.HOVER, here, here, payload_kg, GOES_ON_S)
        stage = Stage((on,), (_straight_home(there, payload_kg),), delivers=True)
        return Ahead((_straight_home(here, payload_kg),), (stage,))


def _straight_home(here: Ned, payload_kg: float) -> WayHome:
    over = (0.0, 0.0, here[2])
    land = Leg(LegKind.LAND, over, (0.0, 0.0, 0.0), payload_kg)
    if horizontal_m(here, over) <= HOVERS_MPS:
        return WayHome(TAKE_OFF, (land,))
    return WayHome(TAKE_OFF, (Leg(LegKind.CRUISE, here, over, payload_kg), land))


class Planned:
    """The flight file's plan. Where on it the vehicle is, the mission's progress tells, where the
    log has it and it is our mission; else the way it has flown.
    """

    def __init__(self, flown: FlightPlan, flight: Flight, route_energy: RouteEnergy) -> None:
        self._flown = flown
        self._drop_height_m = flight.mission.drop_height_m
        self._settle_s = flight.mission.wind_settle_s
        self._settled_s: float | None = None
        self._now_s = 0.0
        self._drop = _Drop(route_energy, flight.vehicle.payload_kg)
        self._leg = 0
        self._return_index: int | None = None
        self._away_index: int | None = None
        self._nearest_m = math.inf
        self._landing = False
        self._rally: str | None = None
        self.delivered = ""
        self.another_mission: int | None = None
        self.stage = "settle"

    @property
    def step(self) -> str:
        """The stage with the leg: another one is another decision."""
        return f"outbound {self._leg}" if self.stage == "outbound" else self.stage

    @property
    def outward(self) -> bool:
        """Flying away from home, or about to: a closed gate means something."""
        return self.stage in ("settle", "outbound", "deliver") and not self.delivered

    def look(self, now: TelemetryState) -> Ned | None:
        """Take the moment in; returns where the vehicle is."""
        if now.position is None:
            return None
        self._now_s = now.t_s
        here = self._flown.ned_of(now.position)
        before = self.stage
        if not self._by_progress(now):
            self._by_place(here)
        if self.stage in ("deliver", "release") and not self.delivered:
            self.delivered = self._drop.look(now, released=self.stage == "release")
        elif before == "release":
            self.delivered = self.delivered or self._drop.look(now, released=True)
        return here

    def ahead(self, here: Ned, payload_kg: float) -> Ahead:
        """What the plan still holds."""
        plan, drop_m = self._flown.plan, self._drop_height_m
        if self.stage == "settle":
            settled_s = 0.0 if self._settled_s is None else self._now_s - self._settled_s
            left_s = max(0.0, self._settle_s - settled_s)
            return ahead_outbound(plan, here, 0, payload_kg, drop_m, DROP_S, left_s)
        if self.stage == "outbound":
            return ahead_outbound(plan, here, self._leg, payload_kg, drop_m, DROP_S)
        if self.stage in ("deliver", "release") and not self.delivered:
            return ahead_delivering(plan, here, payload_kg, drop_m, DROP_S)
        delivered = bool(self.delivered)
        if self._away_index is not None:
            return ahead_away(plan, here, self._away_index, payload_kg, delivered)
        index = None if self._landing else self._nearest_return(here)
        return ahead_returning(plan, here, index, payload_kg, delivered, self._rally)

    @property
    def landing(self) -> str:
        """The name of where the plan's way back ends."""
        return self._flown.plan.landing

    @property
    def items(self) -> int:
        """How many items the plan's mission has."""
        return len(self._flown.mission.items)

    def sees(self, rally: str, here: Ned) -> bool:
        """Tell whether the straight line to a rally point is clear."""
        return rally_in_sight(self._flown, rally, here)

    def depot_only(self, here: Ned, payload_kg: float) -> Ahead | None:
        """The same without the rally points: `None` where no way leads to the depot."""
        ahead = self.ahead(here, payload_kg)
        landing = self._flown.plan.landing
        ways = tuple(way for way in ahead.ways_home_now if way.landing == landing)
        return Ahead(ways, (), bool(self.delivered)) if ways else None

    def _nearest_return(self, here: Ned) -> int:
        if self._return_index is not None:
            return self._return_index
        points = self._flown.plan.return_ned_m
        return min(range(len(points)), key=lambda i: horizontal_m(here, points[i]))

    def _by_progress(self, now: TelemetryState) -> bool:
        """Follow MISSION_CURRENT; False where the log has none of our mission."""
        mission, progress = self._flown.mission, now.progress
        if progress is None or progress.index is None:
            return False
        if progress.total is not None and progress.total != len(mission.items):
            self.another_mission = progress.total
            return False
        index = progress.index
        self._away_index = mission.away.index(index) if index in mission.away else None
        match mission.part_at(index):
            case Part.RETURN if index not in mission.returning:
                self.stage = "return"
            case Part.TAKEOFF | Part.SETTLE:
                self.stage = "settle"
                if index >= mission.settle and self._settled_s is None:
                    self._settled_s = now.t_s
            case Part.OUTBOUND:
                self.stage = "outbound"
                if index in mission.outbound:
                    self._leg = mission.outbound.index(index)
            case Part.DELIVER:
                self.stage = "deliver"
            case Part.RELEASE:
                self.stage = "release"
            case Part.RETURN:
                self.stage = "return"
                self._return_index = max(0, mission.returning.index(index) - 1)
            case Part.RALLY:
                self.stage, self._rally = "divert", self._rally_at(index)
                self._promise(self._rally)
                self._return_index = None
            case Part.RALLY_LAND:
                self.stage, self._landing = "land", True
                self._rally = self._rally_at(index) or self._rally
            case Part.LAND | Part.END:
                self.stage, self._landing = "land", True
            case None:
                return False
        return True

    def _promise(self, stop: str | None) -> None:
        """A stop that was flown to had been promised."""
        if stop is not None:
            plan = self._flown.plan.promised(stop)
            self._flown = replace(self._flown, plan=plan)

    def _rally_at(self, index: int) -> str | None:
        return self._flown.site_of_item(index)

    def _by_place(self, here: Ned) -> None:
        """Follow the way that was flown along the plan's points."""
        points = self._flown.plan.outbound_ned_m
        last = len(points) - 1
        if self.stage == "settle" and horizontal_m(here, (0.0, 0.0, 0.0)) > REACHED_M:
            self.stage = "outbound"
        if self.stage == "outbound":
            away_m = horizontal_m(here, points[last])
            self._nearest_m = min(self._nearest_m, away_m)
            while self._leg < last and (
                away_m < horizontal_m(points[self._leg], points[last])
                or horizontal_m(here, points[self._leg]) < REACHED_M
            ):
                self._leg += 1
            if away_m < REACHED_M and here[2] > points[last][2] + SINKS_M:
                self.stage = "deliver"
            elif away_m > self._nearest_m + GIVES_UP_M:
                self.stage = "return"
        elif self.stage == "deliver":
            drop_down_m = self._flown.plan.customer_ned_m[2] - self._drop_height_m
            if here[2] > drop_down_m - SINKS_M:
                self.stage = "release"
        elif self.stage == "release" and horizontal_m(here, points[last]) > LEFT_M:
            self.stage = "return"


class _Drop:
    """Whether the parcel went, by the companion's own watch."""

    def __init__(self, route_energy: RouteEnergy, payload_kg: float) -> None:
        self._watch = watch_for(route_energy, payload_kg) if payload_kg > 0.0 else None

    def look(self, now: TelemetryState, *, released: bool) -> str:
        """Take the moment in; returns what shows that the parcel went, `""` while nothing does."""
        if self._watch is None:
            return "there was no parcel to weigh" if released else ""
        if released:
            self._watch.begin(now.t_s)
        observe_hover(self._watch, now)
        return self._watch.evidence(now.t_s) or ""
