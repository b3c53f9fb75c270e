"""Rounding of a route's corners, for autopilots that fly straight lines between mission items.

A corner becomes a few waypoints on an arc tangent to both legs. The arc passes the old waypoint
within the tolerance: `R = tolerance / (1 / cos(turn / 2) - 1)`, less where a leg is too short.
Autopilots advance to the next item within an acceptance radius (PX4 NAV_ACC_RAD 10 m, ArduCopter
WPNAV_RADIUS 2 m) and slow down for the turn there. PX4 merges points nearer than twice that radius,
so the points of an arc keep a larger spacing.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, ObstacleMap, course_rad, horizontal_distance_m, wrap_pi

LEAST_TURN_RAD = math.radians(20.0)
"""Smallest turn that is rounded: flatter corners cost 3 % of a stop (`leg_energy`)."""

MIN_SPACING_M = 20.0
"""Minimum spacing of an arc's waypoints: twice PX4's acceptance radius."""

_LEG_SHARE = 0.5  # share of a leg available to the arc at either end
_MAX_POINTS = 8


@dataclass(frozen=True, slots=True)
class RoundCorner:
    """Arc that replaces a waypoint; `offset_m` is its distance from that waypoint."""

    points: tuple[Ned, ...]
    radius_m: float
    offset_m: float


def arc_at_corner(
    previous_point: Ned, corner: Ned, next_point: Ned, max_corner_offset_m: float
) -> RoundCorner | None:
    """Return the arc that replaces `corner`; None where it would have fewer than two points."""
    into, out = course_rad(previous_point, corner), course_rad(corner, next_point)
    turn = wrap_pi(out - into)
    if not LEAST_TURN_RAD < abs(turn) < math.pi - 1e-3:
        return None
    half = 0.5 * abs(turn)
    available_m = _LEG_SHARE * min(
        horizontal_distance_m(previous_point, corner), horizontal_distance_m(corner, next_point)
    )
    radius_m = min(max_corner_offset_m / (1.0 / math.cos(half) - 1.0), available_m / math.tan(half))
    count = min(int(radius_m * abs(turn) / MIN_SPACING_M), _MAX_POINTS) + 1
    if count < 2:
        return None
    side = math.copysign(1.0, turn)
    touch_m = radius_m * math.tan(half)
    start = (corner[0] - touch_m * math.cos(into), corner[1] - touch_m * math.sin(into))
    centre = (
        start[0] - side * radius_m * math.sin(into),
        start[1] + side * radius_m * math.cos(into),
    )
    points: list[Ned] = []
    for number in range(count):
        course = into + turn * number / (count - 1)
        north = centre[0] + side * radius_m * math.sin(course)
        east = centre[1] - side * radius_m * math.cos(course)
        points.append((north, east, corner[2]))
    return RoundCorner(tuple(points), radius_m, radius_m * (1.0 / math.cos(half) - 1.0))


def round_clear_corners(
    points: list[Ned], max_corner_offset_m: float, obstacles: ObstacleMap
) -> list[Ned]:
    """Round each corner whose arc is clear of obstacles. Both ends of the route stay.

    Raises LeewayError for a tolerance that is not above 0.
    """
    if not 0.0 < max_corner_offset_m < math.inf:
        raise LeewayError(f"corner tolerance {max_corner_offset_m!r} m: expected more than 0")
    if len(points) < 3:
        return list(points)
    smooth = points[:1]
    for before, here, after in zip(points, points[1:], points[2:], strict=False):
        arc = arc_at_corner(before, here, after, max_corner_offset_m)
        clear = arc is not None and all(
            obstacles.first_blocking_obstacle(a, b) is None
            for a, b in pairwise((*smooth[-1:], *arc.points, after))
        )
        smooth += arc.points if arc is not None and clear else (here,)
    return [*smooth, points[-1]]


def max_route_turn_rad(points: list[Ned]) -> float:
    """Return the largest turn of a route."""
    courses = [course_rad(a, b) for a, b in pairwise(points) if horizontal_distance_m(a, b) > 0.0]
    return max((abs(wrap_pi(b - a)) for a, b in pairwise(courses)), default=0.0)
