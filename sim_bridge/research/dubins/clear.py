"""A path between two poses that is clear of buildings and no-fly areas, or why there is none.

Obstacle screening first, then synthesis (arXiv 2604.13441, IV-C). The quickest path is used if it
is clear. Else the remedies are other words and wider turns, via-points at the obstacles' corners
(the planner's visibility graph), and the way over the obstacle. Each remedy's candidates are
joined and screened as one batch. The quickest clear path of all is kept.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import networkx as nx
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned, ObstacleMap, course_rad, horizontal_m
from sim_bridge.research.dubins.air_path import AirPaths
from sim_bridge.research.dubins.airplane import join_poses
from sim_bridge.research.dubins.limits import FlightLimits
from sim_bridge.research.dubins.words import WORDS

STEP_M = 5.0
"""Largest spacing over the ground of the points at which paths are screened."""

_WIDER = (1.0, 1.5, 2.0, 3.0)
_BEYOND = (0.1, 0.5, 1.0, 1.6)  # distance of via-points beyond the clearance, in turn radii
_OVER_M = 2.0  # extra height above the clearance when flying over


@dataclass(frozen=True, slots=True)
class ClearPath:
    """Legs flown one after another, from pose to pose; `remedy` names the remedy used, if any."""

    legs: AirPaths
    remedy: str

    @property
    def time_s(self) -> float:
        """Total duration."""
        return float(self.legs.time_s.sum())

    def points(self, step_m: float = STEP_M) -> Floats:
        """Points along the path, (k, 4): north, east, down m, air heading rad."""
        parts = [_sampled(self.legs.one(i), step_m)[0] for i in range(len(self.legs))]
        return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


@dataclass(frozen=True, slots=True)
class NoPath:
    """No clear path exists; `reason` in words."""

    reason: str


@dataclass(frozen=True, slots=True)
class _Chain:
    """A candidate: poses (m, 4) to join in sequence, with one radius and one word."""

    poses: Floats
    radius_m: float
    word: int | None = None


def clear_path(
    start: Floats,
    goal: Floats,
    limits: FlightLimits,
    wind_to_ne_mps: Floats,
    obstacles: ObstacleMap,
    ceiling_m: float | None = None,
) -> ClearPath | NoPath:
    """From pose to pose, (4,) each: north, east, down m, air heading rad.

    `ceiling_m` above the depot limits flight over an obstacle; None forbids it. Raises LeewayError
    for poses that are not finite and for wind as fast as the airspeed.
    """
    for name, pose in (("start", start), ("goal", goal)):
        place = (float(pose[0]), float(pose[1]), float(pose[2]))
        within = obstacles.blocking(place, place)
        if within is not None:
            height = (
                "a no-fly area" if math.isinf(within.height_m) else f"{within.height_m:g} m high"
            )
            return NoPath(
                f"{name}: stands within {obstacles.clearance_m:g} m of {within.name}, {height}"
            )
    direct = join_poses(start, goal, limits, wind_to_ne_mps)
    hit = int(obstacles.first_hits(_sampled(direct, STEP_M)[..., :3])[0])
    if hit < 0:
        return ClearPath(direct, "")
    remedies = _remedies(start, goal, limits, obstacles, ceiling_m)
    tried = [
        ClearPath(found, remedy)
        for remedy, chains in remedies
        if (found := _quickest_clear(chains, limits, wind_to_ne_mps, obstacles)) is not None
    ]
    if tried:
        return min(tried, key=lambda path: path.time_s)
    return NoPath(
        f"goal: no path with turns of {limits.turn_radius_m:.0f} m gets there clear of"
        f" {obstacles.obstacles[hit].name}: tried other words, wider turns, its corners"
        + (" and the way over it" if ceiling_m is not None else "")
    )


def _remedies(
    start: Floats,
    goal: Floats,
    limits: FlightLimits,
    obstacles: ObstacleMap,
    ceiling_m: float | None,
) -> Iterator[tuple[str, list[_Chain]]]:
    least = limits.turn_radius_m
    pair = np.stack([start, goal])
    yield (
        "another word or wider turns",
        [_Chain(pair, k * least, word) for k in _WIDER for word in range(len(WORDS))],
    )
    around = [c for b in _BEYOND for c in _around(start, goal, b * least, least, obstacles)]
    yield "via-points around it", around
    if ceiling_m is not None:
        yield "over it", _over(start, goal, least, obstacles, ceiling_m)


def _around(
    start: Floats, goal: Floats, beyond_m: float, radius_m: float, obstacles: ObstacleMap
) -> list[_Chain]:
    """The shortest route through the visibility graph, with several headings at its corners."""
    ends = [_place(start), _place(goal)]
    height_m = min(-ends[0][2], -ends[1][2])
    knots = list(ends)
    for ring in obstacles.outlines_ne_m(height_m, beyond_m):
        corners = [(n, e, -height_m) for n, e in ring]
        knots += [c for c in corners if obstacles.blocking(c, c) is None]
    graph: nx.Graph = nx.Graph()
    graph.add_nodes_from(range(len(knots)))
    for a in range(len(knots)):
        for b in range(a + 1, len(knots)):
            if obstacles.blocking(knots[a], knots[b]) is None:
                graph.add_edge(a, b, length_m=horizontal_m(knots[a], knots[b]))
    if not nx.has_path(graph, 0, 1):
        return []
    route = [knots[i] for i in nx.shortest_path(graph, 0, 1, weight="length_m")]
    return [
        _Chain(_posed(route, start, goal, share), k * radius_m)
        for share in (0.5, 0.0, 1.0)
        for k in (1.0, 1.5)
    ]


def _posed(route: list[Ned], start: Floats, goal: Floats, share: float) -> Floats:
    """Poses along a route: corner headings between both courses, heights interpolated by
    distance.
    """
    poses = [start]
    for before, here, after in zip(route, route[1:], route[2:], strict=False):
        into, out = course_rad(before, here), course_rad(here, after)
        turn = math.remainder(out - into, 2.0 * math.pi)
        poses.append(np.array([here[0], here[1], here[2], into + share * turn]))
    lengths = np.cumsum([horizontal_m(a, b) for a, b in pairwise(route)])
    for pose, done in zip(poses[1:], lengths, strict=False):
        pose[2] = start[2] + (goal[2] - start[2]) * done / lengths[-1]
    return np.stack([*poses, goal])


def _over(
    start: Floats, goal: Floats, radius_m: float, obstacles: ObstacleMap, ceiling_m: float
) -> list[_Chain]:
    """Climb at the start, fly above all obstacles between, descend at the goal."""
    top_m = obstacles.highest_m(_place(start), _place(goal))
    height_m = max(top_m + obstacles.clearance_up_m + _OVER_M, -start[2], -goal[2])
    if not height_m <= ceiling_m:
        return []
    up, down = start.copy(), goal.copy()
    up[2], down[2] = -height_m, -height_m
    chains = [np.stack([start, up, down, goal])]
    # Or climb straight ahead, for the distance that a gradient of one in four needs.
    for ahead in (4.0 * (height_m + start[2]), 4.0 * (height_m + goal[2])):
        forth, back = up.copy(), down.copy()
        forth[:2] += ahead * np.array([math.cos(start[3]), math.sin(start[3])])
        back[:2] -= ahead * np.array([math.cos(goal[3]), math.sin(goal[3])])
        chains += [np.stack([start, forth, down, goal]), np.stack([start, forth, back, goal])]
    return [_Chain(poses, radius_m) for poses in chains]


def _quickest_clear(
    chains: list[_Chain],
    limits: FlightLimits,
    wind_to_ne_mps: Floats,
    obstacles: ObstacleMap,
) -> AirPaths | None:
    if not chains:
        return None
    owner = np.concatenate([np.full(len(c.poses) - 1, i) for i, c in enumerate(chains)])
    words = np.concatenate(
        [np.full(len(c.poses) - 1, -1 if c.word is None else c.word) for c in chains]
    )
    legs = join_poses(
        np.concatenate([c.poses[:-1] for c in chains]),
        np.concatenate([c.poses[1:] for c in chains]),
        limits,
        wind_to_ne_mps,
        np.concatenate([np.full(len(c.poses) - 1, c.radius_m) for c in chains]),
        words,
    )
    hits = obstacles.first_hits(_sampled(legs, STEP_M)[..., :3]) >= 0
    blocked = np.bincount(owner, hits, minlength=len(chains)) > 0
    took = np.bincount(owner, legs.time_s, minlength=len(chains))
    took = np.where(blocked, np.inf, took)
    best = int(np.argmin(took))
    return legs.some(np.flatnonzero(owner == best)) if math.isfinite(took[best]) else None


def _sampled(paths: AirPaths, step_m: float) -> Floats:
    """Poses along each path, the same number for each: (n, k, 4)."""
    ground_mps = paths.level_mps + np.hypot(*paths.wind_to_ne_mps.T)
    longest_m = float(np.max(ground_mps * paths.time_s, initial=0.0))
    count = max(math.ceil(longest_m / step_m), 1) + 1
    return paths.at(paths.time_s[:, None] * np.linspace(0.0, 1.0, count))


def _place(pose: Floats) -> Ned:
    return float(pose[0]), float(pose[1]), float(pose[2])
