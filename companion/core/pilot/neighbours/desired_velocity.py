"""The velocity that a vehicle near neighbours wants: straight to its item, or as the actor says.

Also the way past waypoints: set-points make the autopilot count none, so the mission is ordered on.
Without that, who may not hand back yet would wait over its waypoint for whoever waits for that
place.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from companion.core.base.geo import Ned
from companion.core.mission.actions import JumpTo
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.mission_items import Part
from companion.core.pilot.context import CruiseSpeed, FlightContext, ItemProgress
from companion.core.pilot.transitions import Phase
from companion.core.separation.learned_policy import AvoidancePolicy
from companion.core.separation.policy_view import DECISION_S, Around, Ne, wish_of
from companion.core.separation.setpoint_motion import FLEET, Floats, wish_to
from companion.core.separation.traffic_tracks import Report

LEG_PHASES = (Phase.OUTBOUND, Phase.RETURN, Phase.DIVERT)
SLOWEST_MPS, FASTEST_MPS = 3.0, 8.0
"""Of the desired velocity: near others it is slower than on the route, and stops in a third of the
way."""

ARRIVING_M = 20.0
"""The actor was trained to come this near to a goal, and no nearer."""

LOWEST_M = 10.0
"""Nobody dodges lower than this above the depot."""

REACHED_M = 3.0
"""Over the ground, from a waypoint of the way home that counts as passed: between what the
autopilots' own have by default (ArduCopter's WPNAV_RADIUS 2 m, PX4's NAV_ACC_RAD 10 m)."""

ASK_AGAIN_S = 1.5
MOST_ASKS = 3
"""So often a mission is ordered on past a waypoint; then it is handed back as it is."""


class TrafficView(Protocol):
    """Where neighbours are, and where they want to go."""

    @property
    def reports(self) -> Mapping[str, Report]:
        """Newest report of each neighbour, by name."""
        ...

    @property
    def goals(self) -> Mapping[str, Ne]:
        """Where neighbours say that they want to."""
        ...


@dataclass(slots=True)
class Passing:
    """Orders to go on past an item."""

    item: int
    asked: int
    asked_s: float


class DesiredVelocity:
    """Where the mission wants to be, and how fast to get there."""

    def __init__(
        self,
        progress: ItemProgress,
        speed: CruiseSpeed,
        traffic: TrafficView,
        policy: AvoidancePolicy | None,
    ) -> None:
        self._progress = progress
        self._speed = speed
        self._traffic = traffic
        self._policy = policy
        """The learned actor; `None`: straight to the item."""
        self._acted_s: float | None = None
        self._acted_mps: Floats | None = None
        self._passing: Passing | None = None

    def goal(self, context: FlightContext, here: Floats) -> Ned | None:
        """Where the mission wants to be; over a customer or a pad the height is kept meanwhile."""
        flown, jump_index = context.flight_plan, self._progress.jump_index
        index = jump_index if jump_index is not None else self._progress.index
        if flown is None or index is None:
            return None
        spot = flown.mission.spot_at(index)
        if spot is None:
            return None
        north, east, down = flown.spot_ned(spot)
        keeps = flown.mission.part_at(index) in (Part.DELIVER, Part.LAND, Part.RALLY_LAND)
        return north, east, min(float(here[2]), -LOWEST_M) if keeps else down

    def sees_goal(self, context: FlightContext, here: Floats) -> bool:
        """Whether the straight line there is clear."""
        goal = self.goal(context, here)
        assert context.flight_plan is not None
        return goal is not None and context.flight_plan.sees((here[0], here[1], here[2]), goal)

    def straight(self, here: Floats, goal: Ned) -> Floats:
        """Straight to the goal, at the speed of this leg."""
        speed_mps = min(max(self._speed.speed_mps or SLOWEST_MPS, SLOWEST_MPS), FASTEST_MPS)
        return wish_to((here[0], here[1], here[2]), goal, speed_mps, FLEET)

    def fastest_mps(self, velocity: Floats) -> float:
        """The speed to be reckoned with on this leg."""
        ground_mps = float(np.hypot(*velocity[:2]))
        return max(self._speed.speed_mps or 0.0, ground_mps, FASTEST_MPS)

    def desired(self, context: FlightContext, here: Floats, goal: Ned, straight: Floats) -> Floats:
        """What the actor says, asked every two seconds; near its goal straight on."""
        away_m = math.hypot(goal[0] - here[0], goal[1] - here[1])
        if self._policy is None or away_m < ARRIVING_M or context.phase not in LEG_PHASES:
            return straight
        if self._acted_mps is None or context.since_s(self._acted_s) >= DECISION_S - 1e-6:
            self._acted_s = context.t_s
            self._acted_mps = wish_of(self._policy, self._around(context, here, goal))
        return np.array([*self._acted_mps, straight[2]])

    def pass_by(self, context: FlightContext, here: Floats) -> bool:
        """Whether the mission is being ordered on past a waypoint that set-points have reached.

        As if the autopilot had reached it by itself; telemetry shows when it obeys. Meanwhile
        nothing is handed back: two orders of which item to fly would be one too many.
        """
        item, on = self._progress.index, self._item_after(context, here)
        if on is None or item is None:
            return False
        before = self._passing if self._passing and self._passing.item == item else None
        asked = before.asked if before else 0
        if before is None or context.t_s - before.asked_s >= ASK_AGAIN_S:
            if asked == MOST_ASKS:
                return False
            self._passing = Passing(item, asked + 1, context.t_s)
            context.do(JumpTo(on))
        return True

    def _around(self, context: FlightContext, here: Floats, goal: Ned) -> Around:
        flown = context.flight_plan
        assert flown is not None
        reports, goals = self._traffic.reports.values(), self._traffic.goals
        known = [goals[r.name] for r in reports if r.name in goals]
        home = flown.plan.landing_ned_m
        return Around(
            (float(here[0]), float(here[1])),
            (goal[0], goal[1]),
            None if context.outward else (home[0], home[1]),
            [(r.pos_ned_m[0], r.pos_ned_m[1]) for r in reports],
            known,
            flown.site.obstacles.grown_at(-float(here[2])),
        )

    def _item_after(self, context: FlightContext, here: Floats) -> int | None:
        """The item to go on to, where set-points have reached a waypoint of the way home.

        Outbound, leave to go on comes before the waypoint. The height at which it is passed does
        not matter, if the line on is clear.
        """
        flown, index = context.flight_plan, self._progress.index
        if flown is None or index is None or self._progress.jump_index is not None:
            return None
        if flown.mission.part_at(index) not in (Part.RETURN, Part.RALLY):
            return None
        goal, on = self.goal(context, here), flown.mission.next_place(index)
        if goal is None or on is None:
            return None
        if math.hypot(goal[0] - here[0], goal[1] - here[1]) > REACHED_M:
            return None
        return on if _line_on_is_clear(flown, here, on) else None


def _line_on_is_clear(flown: FlightPlan, here: Floats, on: int) -> bool:
    spot = flown.mission.items[on].spot
    assert spot is not None
    north, east, down = flown.spot_ned(spot)
    lands = flown.mission.part_at(on) in (Part.LAND, Part.RALLY_LAND)
    further = (north, east, float(here[2]) if lands else down)
    return flown.sees((here[0], here[1], here[2]), further)
