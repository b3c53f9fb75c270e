"""Remaining mission as input of the gate: stages between decision points, and routes home."""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.geo import course_rad, horizontal_distance_m, wrap_pi
from companion.core.routing.leg_energy import MIN_LEG_M, Leg, LegKind

_MERGE_M = 450.0  # straight cruise legs are merged up to this length
_MERGE_TURN_RAD = math.radians(3.0)
_MAX_DECISION_POINTS = 6  # maximum number of decision points after thinning


@dataclass(frozen=True, slots=True)
class ReturnRoute:
    """Route to a landing site: its name ("depot" or a rally point's) and its legs to the ground.

    `unattended_sequence`: the same legs without further commands (fixed ground speeds).
    """

    landing: str
    leg_sequence: tuple[Leg, ...]
    unattended_sequence: tuple[Leg, ...] = ()


@dataclass(frozen=True, slots=True)
class Stage:
    """Legs to the next decision point, and the routes home from there, the preferred first.

    `delivers` is true for the stage that ends with the parcel released.
    """

    leg_sequence: tuple[Leg, ...]
    return_routes: tuple[ReturnRoute, ...]
    delivers: bool = False


@dataclass(frozen=True, slots=True)
class RemainingMission:
    """Remaining mission: routes home from the current position, and the stages to fly.

    `stages` is empty on the return flight, where `delivered` is true after a delivery.
    """

    current_return_routes: tuple[ReturnRoute, ...]
    stages: tuple[Stage, ...] = ()
    delivered: bool = False

    def __post_init__(self) -> None:
        routes = (self.current_return_routes, *(stage.return_routes for stage in self.stages))
        if not all(routes):
            raise ValueError("remaining mission: decision point without a route home")


def with_min_airspeed(remaining: RemainingMission, airspeed_mps: float) -> RemainingMission:
    """Return the mission with this least airspeed on every cruise leg of commanded speed."""

    def legs_with_min_airspeed(legs: tuple[Leg, ...]) -> tuple[Leg, ...]:
        return tuple(
            replace(leg, airspeed_mps=airspeed_mps)
            if leg.kind is LegKind.CRUISE and leg.ground_speed_mps is None
            else leg
            for leg in legs
        )

    def routes_with_min_airspeed(routes: tuple[ReturnRoute, ...]) -> tuple[ReturnRoute, ...]:
        return tuple(
            replace(route, leg_sequence=legs_with_min_airspeed(route.leg_sequence))
            for route in routes
        )

    stages = tuple(
        replace(
            stage,
            leg_sequence=legs_with_min_airspeed(stage.leg_sequence),
            return_routes=routes_with_min_airspeed(stage.return_routes),
        )
        for stage in remaining.stages
    )
    return replace(
        remaining,
        current_return_routes=routes_with_min_airspeed(remaining.current_return_routes),
        stages=stages,
    )


def reduce_decision_points(remaining: RemainingMission) -> RemainingMission:
    """Reduce the mission to `_MAX_DECISION_POINTS` decision points: the next, the last two, some
    others.

    A gate that decides less often has a slightly lower P(home), so the result is conservative.
    """
    count = len(remaining.stages)
    if count <= _MAX_DECISION_POINTS:
        return remaining
    kept = {0, count - 2, count - 1}
    kept |= {round(i) for i in np.linspace(0, count - 2, _MAX_DECISION_POINTS - 1)}
    stages: list[Stage] = []
    leg_list: tuple[Leg, ...] = ()
    for i, stage in enumerate(remaining.stages):
        leg_list += stage.leg_sequence
        if i in kept:
            stages.append(replace(stage, leg_sequence=leg_list))
            leg_list = ()
    return replace(remaining, stages=tuple(stages))


def merge_straight_cruise_legs(leg_list: tuple[Leg, ...]) -> list[Leg]:
    """Merge straight cruise legs. Each merged leg is evaluated at its midpoint wind."""
    merged: list[Leg] = []
    for leg in leg_list:
        before = merged[-1] if merged else None
        if before is not None and _can_merge_legs(before, leg):
            merged[-1] = replace(before, to_ned_m=leg.to_ned_m)
        else:
            merged.append(leg)
    return merged


def _can_merge_legs(previous_leg: Leg, leg: Leg) -> bool:
    if previous_leg.kind is not LegKind.CRUISE or leg.kind is not LegKind.CRUISE:
        return False
    same_settings = (
        previous_leg.payload_kg,
        previous_leg.airspeed_mps,
        previous_leg.ground_speed_mps,
    ) == (
        leg.payload_kg,
        leg.airspeed_mps,
        leg.ground_speed_mps,
    )
    if not same_settings or previous_leg.to_ned_m != leg.from_ned_m:
        return False
    if horizontal_distance_m(previous_leg.from_ned_m, leg.to_ned_m) > _MERGE_M:
        return False
    rises_m = [
        previous_leg.to_ned_m[2] - previous_leg.from_ned_m[2],
        leg.to_ned_m[2] - leg.from_ned_m[2],
    ]
    if rises_m[0] * rises_m[1] < 0.0 and min(map(abs, rises_m)) > MIN_LEG_M:
        return False  # over a ridge: the descent does not recover the energy of the climb
    before_rad = course_rad(previous_leg.from_ned_m, previous_leg.to_ned_m)
    turn_rad = wrap_pi(course_rad(leg.from_ned_m, leg.to_ned_m) - before_rad)
    return abs(turn_rad) < _MERGE_TURN_RAD
