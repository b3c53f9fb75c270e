"""A waypoint route with its corners rounded, for autopilots that fly straight lines between items.

A corner becomes a few waypoints on an arc that touches both legs and passes the old waypoint within
the tolerance: `R = tolerance / (1 / cos(turn / 2) - 1)`, less where a leg is too short. Autopilots
go on to the next item within an acceptance radius (PX4 NAV_ACC_RAD 10 m, ArduCopter WPNAV_RADIUS
2 m) and slow down for what turns there: points nearer than twice that are one point to PX4, so the
arc's are further apart, and its turns as small as that allows.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, ObstacleMap, course_rad, horizontal_m, wrap_pi

LEAST_TURN_RAD = math.radians(20.0)
"""Flatter corners stay: they cost 3 % of a stop (`route_energy`)."""

APART_M = 20.0
"""Between two waypoints of an arc: twice PX4's acceptance radius."""

_ROOM = 0.5  # share of a leg that the arc at either end may take
_MOST_POINTS = 8


@dataclass(frozen=True, slots=True)
class RoundCorner:
    """An arc instead of a waypoint, and how far from it that passes."""

    points: tuple[Ned, ...]
    radius_m: float
    off_m: float


def round_corner(before: Ned, here: Ned, after: Ned, tolerance_m: float) -> RoundCorner | None:
    """The arc in place of `here`; None where it would be no rounder than the corner."""
    into, out = course_rad(before, here), course_rad(here, after)
    turn = wrap_pi(out - into)
    if not LEAST_TURN_RAD < abs(turn) < math.pi - 1e-3:
        return None
    half = 0.5 * abs(turn)
    room_m = _ROOM * min(horizontal_m(before, here), horizontal_m(here, after))
    radius_m = min(tolerance_m / (1.0 / math.cos(half) - 1.0), room_m / math.tan(half))
    count = min(int(radius_m * abs(turn) / APART_M), _MOST_POINTS) + 1
    if count < 2:
        return None
    side = math.copysign(1.0, turn)
    touch_m = radius_m * math.tan(half)
    start = (here[0] - touch_m * math.cos(into), here[1] - touch_m * math.sin(into))
    centre = (
        start[0] - side * radius_m * math.sin(into),
        start[1] + side * radius_m * math.cos(into),
    )
    points: list[Ned] = []
    for number in range(count):
        course = into + turn * number / (count - 1)
        north = centre[0] + side * radius_m * math.sin(course)
        east = centre[1] - side * radius_m * math.cos(course)
        points.append((north, east, here[2]))
    return RoundCorner(tuple(points), radius_m, radius_m * (1.0 / math.cos(half) - 1.0))


def smooth_route(points: list[Ned], tolerance_m: float, obstacles: ObstacleMap) -> list[Ned]:
    """The route with every corner rounded that can be, clear of obstacles as before.

    Both ends stay. Raises LeewayError for a tolerance that is not above 0.
    """
    if not 0.0 < tolerance_m < math.inf:
        raise LeewayError(f"corner tolerance {tolerance_m!r} m: expected more than 0")
    if len(points) < 3:
        return list(points)
    smooth = points[:1]
    for before, here, after in zip(points, points[1:], points[2:], strict=False):
        arc = round_corner(before, here, after, tolerance_m)
        clear = arc is not None and all(
            obstacles.blocking(a, b) is None
            for a, b in pairwise((*smooth[-1:], *arc.points, after))
        )
        smooth += arc.points if arc is not None and clear else (here,)
    return [*smooth, points[-1]]


def largest_turn_rad(points: list[Ned]) -> float:
    """The sharpest corner of a route."""
    courses = [course_rad(a, b) for a, b in pairwise(points) if horizontal_m(a, b) > 0.0]
    return max((abs(wrap_pi(b - a)) for a, b in pairwise(courses)), default=0.0)
