"""Where a vehicle near neighbours wants to be: straight to its item, or as the actor says."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from companion.core.base.geo import Ned
from companion.core.mission.mission_items import Part
from companion.core.pilot.transitions import Phase
from companion.core.separation.policy_view import DECISION_S, Around, wish_of
from companion.core.separation.setpoint_motion import Floats

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

LEG_PHASES = (Phase.OUTBOUND, Phase.RETURN, Phase.DIVERT)
SLOWEST_MPS, FASTEST_MPS = 3.0, 8.0
"""Of the wish: who is near others is slower than the route, and stops in a third of the way."""

ARRIVING_M = 20.0
"""The actor was trained to come this near to a goal, and no nearer."""

LOWEST_M = 10.0
"""Nobody dodges lower than this above the depot."""


def acted(pilot: Pilot, here: Floats, goal: Ned, straight: Floats) -> Floats:
    """What the actor wishes over the ground, asked every two seconds; near its goal straight on."""
    apart, t_s = pilot.apart, pilot.now.t_s
    away_m = math.hypot(goal[0] - here[0], goal[1] - here[1])
    if apart.policy is None or away_m < ARRIVING_M or pilot.phase not in LEG_PHASES:
        return straight
    if apart.acted_mps is None or t_s - apart.acted_s >= DECISION_S - 1e-6:
        apart.acted_s = t_s
        apart.acted_mps = wish_of(apart.policy, _around(pilot, here, goal))
    return np.array([*apart.acted_mps, straight[2]])


def _around(pilot: Pilot, here: Floats, goal: Ned) -> Around:
    assert pilot.flown is not None
    reports = [track.report for track in pilot.apart.tracks.tracks.values()]
    known = [pilot.apart.goals[r.name] for r in reports if r.name in pilot.apart.goals]
    home = pilot.flown.plan.landing_ned_m
    return Around(
        (float(here[0]), float(here[1])),
        (goal[0], goal[1]),
        None if pilot.outward else (home[0], home[1]),
        [(r.pos_ned_m[0], r.pos_ned_m[1]) for r in reports],
        known,
        pilot.flown.site.obstacles.grown_at(-float(here[2])),
    )


def target(pilot: Pilot, here: Floats) -> Ned | None:
    """Where the mission wants to be; over a customer or a pad the height is kept meanwhile."""
    flown, air = pilot.flown, pilot.air
    index = air.jump.index if air.jump is not None else air.index
    if flown is None or index is None:
        return None
    spot = flown.mission.spot_at(index)
    if spot is None:
        return None
    north, east, down = flown.spot_ned(spot)
    keeps = flown.mission.part_at(index) in (Part.DELIVER, Part.LAND, Part.RALLY_LAND)
    return north, east, min(float(here[2]), -LOWEST_M) if keeps else down


def sees(pilot: Pilot, here: Floats) -> bool:
    """Whether the straight line there is clear."""
    goal = target(pilot, here)
    assert pilot.flown is not None
    return goal is not None and pilot.flown.sees((here[0], here[1], here[2]), goal)


def speed_mps(pilot: Pilot) -> float:
    """Ground speed of the wish."""
    return min(max(pilot.air.speed_mps or SLOWEST_MPS, SLOWEST_MPS), FASTEST_MPS)
