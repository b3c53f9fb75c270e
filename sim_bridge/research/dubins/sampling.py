"""A path as autopilots accept it: sparse mission items, or set-points at a fixed rate.

An autopilot advances within its acceptance radius of a mission item. Items closer than two radii
act as one (PX4: NAV_ACC_RAD 10 m; ArduCopter: WPNAV_RADIUS 2 m). It slows down for a turn at an
item: `v = sqrt(a d / tan(turn / 2))` within `d` of it (PX4, computeMaxSpeedInWaypoint). Set-points
carry position and ground velocity, so the motion between two of them is defined.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned
from sim_bridge.research.dubins.air_path import PARTS, AirPaths

LARGEST_TURN_RAD = math.radians(15.0)
"""Largest turn at one mission item, if the acceptance radius allows."""

_ON_A_LINE_RAD = math.radians(0.5)


@dataclass(frozen=True, slots=True)
class SetPoints:
    """`t_s` (k,) from the path's start; `pos_ned_m`, `vel_ned_mps` (k, 3); air `heading_rad`
    (k,).
    """

    t_s: Floats
    pos_ned_m: Floats
    vel_ned_mps: Floats
    heading_rad: Floats


def set_points(legs: AirPaths, period_s: float) -> SetPoints:
    """Sample legs flown in sequence, every `period_s` and at the end.

    Raises LeewayError for a period that is not finite and above 0.
    """
    if not 0.0 < period_s < math.inf:
        raise LeewayError(f"period_s = {period_s!r}: expected more than 0")
    parts: list[Floats] = []
    begun_s = 0.0
    for index in range(len(legs)):
        leg = legs.one(index)
        took_s = float(leg.time_s[0])
        first_s = math.ceil(begun_s / period_s - 1e-9) * period_s - begun_s
        inside = np.arange(first_s, took_s, period_s)
        last = index == len(legs) - 1
        times = np.append(inside, took_s) if last else inside
        parts.append(np.column_stack([times + begun_s, *_flown(leg, times)]))
        begun_s += took_s
    table = np.concatenate(parts)
    return SetPoints(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7])


def mission_points(legs: AirPaths, accept_radius_m: float) -> list[Ned]:
    """Waypoints (NED m) for straight legs between them; without the start, ending at the goal.

    In turns there is one item per `LARGEST_TURN_RAD`, but never closer than two acceptance radii.
    Straights have items only at their ends. Raises LeewayError for a radius that is not above 0.
    """
    if not 0.0 < accept_radius_m < math.inf:
        raise LeewayError(f"accept_radius_m = {accept_radius_m!r}: expected more than 0")
    points: list[Ned] = []
    for index in range(len(legs)):
        leg = legs.one(index)
        for here in leg.at(_item_times_s(leg)[None, :])[0]:
            place = (float(here[0]), float(here[1]), float(here[2]))
            if points and math.dist(points[-1][:2], place[:2]) < 2.0 * accept_radius_m:
                continue
            points.append(place)
    end = legs.one(len(legs) - 1).end()[0]
    goal = (float(end[0]), float(end[1]), float(end[2]))
    while points and math.dist(points[-1][:2], goal[:2]) < 2.0 * accept_radius_m:
        points.pop()
    return [*points, goal]


def _item_times_s(leg: AirPaths) -> Floats:
    """Times of a leg's part ends, with turns divided into equal pieces."""
    times: list[float] = []
    done_m = 0.0
    for part in range(PARTS):
        length_m = float(leg.length_m[0, part])
        angle = length_m / float(leg.radius_m[0]) if leg.turn[0, part] else 0.0
        if length_m > 0.0 and not 0.0 < angle < _ON_A_LINE_RAD:
            pieces = max(math.ceil(angle / LARGEST_TURN_RAD), 1)
            times += [done_m + length_m * k / pieces for k in range(1, pieces + 1)]
        done_m += length_m
    return np.array(times) / float(leg.level_mps[0])


def _flown(leg: AirPaths, times_s: Floats) -> list[Floats]:
    pose = leg.at(times_s[None, :])[0]
    heading, level = pose[:, 3], float(leg.level_mps[0])
    wind = leg.wind_to_ne_mps[0]
    return [
        *pose[:, :3].T,
        level * np.cos(heading) + wind[0],
        level * np.sin(heading) + wind[1],
        np.full(len(times_s), -float(leg.climb_mps[0])),
        heading,
    ]
