"""Heights of a plan's waypoints, so that every line that may be flown is clear of the ground.

A line is as low as its lower end, because one autopilot climbs along it and another at its start.
So both ends of each line are at least as high as its ground requires. Higher ends stay.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from companion.core.base.geo import Ned, horizontal_distance_m
from companion.core.ground.clearance import GroundClearance
from companion.core.ground.ground_strip import UnknownGround

MAX_HEIGHT_M = 500.0
"""Maximum height above the depot, as in a flight file."""

_VERTICAL_CLIMB_M = 20.0  # nearer waypoints lie within the acceptance radius: vertical climb first
_TURN_SPACING_M = 50.0  # spacing of the points of a leg at which the vehicle may turn back


@dataclass(frozen=True, slots=True)
class RaisedRoutes:
    """Outbound route, return route and the route from the launch pad to another home, each at the
    heights that the ground requires.
    """

    outbound: list[Ned]
    homeward: list[Ned]
    away: list[Ned]


@dataclass(frozen=True, slots=True)
class NoHeight:
    """No permitted heights, with the reason as text."""

    reason: str


class _NoPermittedHeight(Exception):
    pass


def raise_waypoints_over_ground(
    ground: GroundClearance,
    outbound: list[Ned],
    homeward: list[Ned],
    launch_pad_to_home: list[Ned],
    return_entry_indices: tuple[int, ...],
) -> RaisedRoutes | NoHeight:
    """Raise each waypoint to the height that all lines through it require.

    `outbound` begins over the depot, `homeward` over the customer; both first points get the height
    of the next, because the vehicle climbs vertically there. From `outbound[i + 1]`, and from the
    leg after it, the return route is joined at `homeward[return_entry_indices[i] + 1]`.
    """
    out, back = [-p[2] for p in outbound], [-p[2] for p in homeward]
    aside = [-p[2] for p in launch_pad_to_home]
    try:
        for points, heights in ((outbound, out), (homeward, back), (launch_pad_to_home, aside)):
            for i, (a, b) in enumerate(pairwise(points)):
                _raise_line_end_heights_in_place(ground, a, b, (heights, i), (heights, i + 1))
        if launch_pad_to_home:
            _raise_line_end_heights_in_place(
                ground,
                launch_pad_to_home[-1],
                homeward[-1],
                (aside, len(launch_pad_to_home) - 1),
                (back, len(back) - 1),
            )
        for i, joined in enumerate(return_entry_indices):
            entry_end = homeward[joined + 1], (back, joined + 1)
            _raise_line_end_heights_in_place(
                ground, outbound[i + 1], entry_end[0], (out, i + 1), entry_end[1]
            )
            next_index = min(i + 2, len(outbound) - 1)
            for here in _sample_turn_back_points(outbound[i + 1], outbound[next_index]):
                _raise_line_end_heights_in_place(
                    ground, here, entry_end[0], (out, i + 1), (out, next_index), entry_end[1]
                )
        for here in _sample_turn_back_points(outbound[0], outbound[1]):
            into = return_entry_indices[0] + 1
            _raise_line_end_heights_in_place(ground, here, homeward[into], (out, 1), (back, into))
    except _NoPermittedHeight as error:
        return NoHeight(str(error))
    out[0], back[0] = out[1], back[1]
    return RaisedRoutes(
        _points_at_heights(outbound, out),
        _points_at_heights(homeward, back),
        _points_at_heights(launch_pad_to_home, aside),
    )


def raise_waypoints_to_limit_return_slopes(
    routes: RaisedRoutes,
    return_entry_indices: tuple[int, ...],
    climb_per_m: float,
    sink_per_m: float,
) -> RaisedRoutes:
    """Limit the slopes of the return route by raising the lower end of each steep leg.

    `climb_per_m` and `sink_per_m`: metres of height per metre of distance. Without the companion
    PX4 1.18 does not slow down on a steep leg: it passes the waypoint before it has reached its
    height. The last leg may be steep, because the vehicle stops over home.
    """
    out, back = [-p[2] for p in routes.outbound], [-p[2] for p in routes.homeward]
    aside = [-p[2] for p in routes.away]
    lines = [
        (horizontal_distance_m(a, b), (heights, i), (heights, i + 1))
        for points, heights in ((routes.homeward[:-1], back), (routes.away, aside))
        for i, (a, b) in enumerate(pairwise(points))
    ]
    lines += [
        (horizontal_distance_m(a, routes.homeward[joined + 1]), (out, i + 1), (back, joined + 1))
        for i, (a, joined) in enumerate(zip(routes.outbound[1:], return_entry_indices, strict=True))
        if joined + 1 < len(back) - 1
    ]
    lines = [line for line in lines if line[0] > _VERTICAL_CLIMB_M]
    # Heights only rise, never above the highest, so one pass per waypoint is enough.
    for _ in range(len(out) + len(back) + len(aside)):
        for length_m, (a, i), (b, j) in lines:
            a[i] = max(a[i], b[j] - climb_per_m * length_m)
            b[j] = max(b[j], a[i] - sink_per_m * length_m)
    out[0], back[0] = out[1], back[1]
    return RaisedRoutes(
        _points_at_heights(routes.outbound, out),
        _points_at_heights(routes.homeward, back),
        _points_at_heights(routes.away, aside),
    )


def _raise_line_end_heights_in_place(
    ground: GroundClearance, a: Ned, b: Ned, *height_list_and_index_pairs: tuple[list[float], int]
) -> None:
    """Raise these heights to the least height of the line."""
    least_m = _least_height_over_line_m(ground, a, b)
    for up_m, i in height_list_and_index_pairs:
        up_m[i] = max(up_m[i], least_m)


def _least_height_over_line_m(ground: GroundClearance, a: Ned, b: Ned) -> float:
    """Return the least height above the depot for this line. Raises _Unliftable without one."""
    peak = ground.highest_ground_in_corridor(a, b)
    if isinstance(peak, UnknownGround):
        raise _NoPermittedHeight(f"no terrain height is known {peak.position_text}")
    least_m = ground.plan_height_over_m(peak)
    if least_m > MAX_HEIGHT_M:
        raise _NoPermittedHeight(
            f"the ground {peak.position_text} is {peak.up_m:.0f} m above it and requires"
            f" {least_m:.0f} m,"
            f" expected at most {MAX_HEIGHT_M:g} m"
        )
    return least_m


def visible_point_indices_and_arrival_height_m(
    ground: GroundClearance,
    landing_site_ground: Ned,
    least_arrival_height_m: float,
    points: list[Ned],
) -> tuple[tuple[int, ...], float]:
    """Return indices of points with a straight line to a landing site that clears the ground, and
    the arrival height over the site, at least `least_arrival_height_m`.

    A point that is lower than its line requires is excluded.
    """
    seen: list[int] = []
    for i, point in enumerate(points):
        try:
            least_m = _least_height_over_line_m(ground, point, landing_site_ground)
        except _NoPermittedHeight:
            continue
        if least_m <= -point[2] + 1e-6:
            seen.append(i)
            least_arrival_height_m = max(least_arrival_height_m, least_m)
    return tuple(seen), least_arrival_height_m


def _sample_turn_back_points(a: Ned, b: Ned) -> list[Ned]:
    """Return the points of a leg at which a vehicle may turn back; the last is `b`."""
    steps = math.ceil(horizontal_distance_m(a, b) / _TURN_SPACING_M)
    return [
        (a[0] + (b[0] - a[0]) * k / steps, a[1] + (b[1] - a[1]) * k / steps, a[2])
        for k in range(1, steps + 1)
    ]


def _points_at_heights(points: list[Ned], heights_m: list[float]) -> list[Ned]:
    return [(n, e, -up) for (n, e, _), up in zip(points, heights_m, strict=True)]
