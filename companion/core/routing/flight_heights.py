"""Heights of a plan's waypoints, so that every line that may be flown keeps clear of the ground.

A line counts as low as its lower end: one autopilot climbs along it, another first. So both ends
of each line are at least as high as its ground asks; what is higher anyway stays as it is.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from companion.core.base.geo import Ned, horizontal_m
from companion.core.ground.clearance import GroundClearance
from companion.core.ground.ground_strip import NoGround

HIGHEST_M = 500.0
"""Above the depot, as the heights of a flight file."""

_STRAIGHT_UP_M = 20.0  # nearer waypoints: within what counts as reached, the vehicle climbs first
_TURN_EVERY_M = 50.0  # of a leg: where the vehicle may turn round into the way home


@dataclass(frozen=True, slots=True)
class LiftedWays:
    """A way out, a way back and a way from the launch pad to a home elsewhere, each at the heights
    that the ground asks for.
    """

    outbound: list[Ned]
    homeward: list[Ned]
    away: list[Ned]


@dataclass(frozen=True, slots=True)
class NoHeight:
    """Why there are no such heights, in words."""

    reason: str


class _Unliftable(Exception):
    pass


def lifted_over(
    ground: GroundClearance,
    outbound: list[Ned],
    homeward: list[Ned],
    away: list[Ned],
    entry: tuple[int, ...],
) -> LiftedWays | NoHeight:
    """The same ways, each waypoint as high as all lines ask that meet there.

    `outbound` begins over the depot, `homeward` over the customer; both first points take the
    height of the next: the vehicle climbs there straight up. From `outbound[i + 1]` the way home
    enters at `homeward[entry[i] + 1]`, and so it does from anywhere on the leg after that waypoint.
    """
    out, back = [-p[2] for p in outbound], [-p[2] for p in homeward]
    aside = [-p[2] for p in away]
    try:
        for points, heights in ((outbound, out), (homeward, back), (away, aside)):
            for i, (a, b) in enumerate(pairwise(points)):
                _lift(ground, a, b, (heights, i), (heights, i + 1))
        if away:
            _lift(ground, away[-1], homeward[-1], (aside, len(away) - 1), (back, len(back) - 1))
        for i, joined in enumerate(entry):
            there = homeward[joined + 1], (back, joined + 1)
            _lift(ground, outbound[i + 1], there[0], (out, i + 1), there[1])
            ahead = min(i + 2, len(outbound) - 1)
            for here in _along(outbound[i + 1], outbound[ahead]):
                _lift(ground, here, there[0], (out, i + 1), (out, ahead), there[1])
        for here in _along(outbound[0], outbound[1]):
            into = entry[0] + 1
            _lift(ground, here, homeward[into], (out, 1), (back, into))
    except _Unliftable as error:
        return NoHeight(str(error))
    out[0], back[0] = out[1], back[1]
    return LiftedWays(_at(outbound, out), _at(homeward, back), _at(away, aside))


def eased(
    ways: LiftedWays, entry: tuple[int, ...], climb_per_m: float, sink_per_m: float
) -> LiftedWays:
    """The same ways, none of the way home so steep that it is flown out of height.

    Metres of height for each metre of way. When the companion is dead nobody slows the vehicle
    down, and PX4 1.18 does not: it would pass a waypoint out of height and fly on. The lower end is
    lifted. The last leg may be steep: over home the vehicle stops.
    """
    out, back = [-p[2] for p in ways.outbound], [-p[2] for p in ways.homeward]
    aside = [-p[2] for p in ways.away]
    lines = [
        (horizontal_m(a, b), (heights, i), (heights, i + 1))
        for points, heights in ((ways.homeward[:-1], back), (ways.away, aside))
        for i, (a, b) in enumerate(pairwise(points))
    ]
    lines += [
        (horizontal_m(a, ways.homeward[joined + 1]), (out, i + 1), (back, joined + 1))
        for i, (a, joined) in enumerate(zip(ways.outbound[1:], entry, strict=True))
        if joined + 1 < len(back) - 1
    ]
    lines = [line for line in lines if line[0] > _STRAIGHT_UP_M]
    # Heights only rise, never above the highest: as many rounds as there are waypoints at most.
    for _ in range(len(out) + len(back) + len(aside)):
        for length_m, (a, i), (b, j) in lines:
            a[i] = max(a[i], b[j] - climb_per_m * length_m)
            b[j] = max(b[j], a[i] - sink_per_m * length_m)
    out[0], back[0] = out[1], back[1]
    return LiftedWays(_at(ways.outbound, out), _at(ways.homeward, back), _at(ways.away, aside))


def _lift(ground: GroundClearance, a: Ned, b: Ned, *heights: tuple[list[float], int]) -> None:
    """Lift these heights to what the line asks."""
    least_m = _least_height_m(ground, a, b)
    for up_m, i in heights:
        up_m[i] = max(up_m[i], least_m)


def _least_height_m(ground: GroundClearance, a: Ned, b: Ned) -> float:
    """Height above the depot at which this line may be planned; raises where there is none."""
    peak = ground.highest(a, b)
    if isinstance(peak, NoGround):
        raise _Unliftable(f"no height of the ground is known {peak.place}")
    least_m = ground.planned_over_m(peak)
    if least_m > HIGHEST_M:
        raise _Unliftable(
            f"the ground {peak.place} is {peak.up_m:.0f} m above it and asks for {least_m:.0f} m,"
            f" expected at most {HIGHEST_M:g} m"
        )
    return least_m


def seen_over(
    ground: GroundClearance, site_ground: Ned, level_m: float, points: list[Ned]
) -> tuple[tuple[int, ...], float]:
    """From which of the points a landing site may be flown to in a straight line, and how high
    over it that arrives.

    Points whose height the line does not clear are left out; `level_m` at least.
    """
    seen: list[int] = []
    for i, point in enumerate(points):
        try:
            least_m = _least_height_m(ground, point, site_ground)
        except _Unliftable:
            continue
        if least_m <= -point[2] + 1e-6:
            seen.append(i)
            level_m = max(level_m, least_m)
    return tuple(seen), level_m


def _along(a: Ned, b: Ned) -> list[Ned]:
    """Points from one to another, where a vehicle may turn round; the last is the other."""
    steps = math.ceil(horizontal_m(a, b) / _TURN_EVERY_M)
    return [
        (a[0] + (b[0] - a[0]) * k / steps, a[1] + (b[1] - a[1]) * k / steps, a[2])
        for k in range(1, steps + 1)
    ]


def _at(points: list[Ned], heights_m: list[float]) -> list[Ned]:
    return [(n, e, -up) for (n, e, _), up in zip(points, heights_m, strict=True)]
