"""Dubins paths in wind: paths a second and their lengths, beside OMPL's.

The peer is OMPL (BSD; `pip install ompl`): its Dubins and trochoid state spaces, one pair of poses
at a time from Python, as anybody would call it. `dubins` 1.0.1 (2018) no longer builds on Python
3.11. Times are CPU seconds of one core.
"""

from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

import numpy as np

from companion.core.base.arrays import Floats
from sim_bridge.adapters.wall_clock import cpu_s
from sim_bridge.research.dubins.airplane import join_poses
from sim_bridge.research.dubins.limits import FlightLimits
from sim_bridge.research.results.sheet import Sheet

AIRSPEED_MPS, RADIUS_M, SIDE_M, HEIGHT_M = 15.0, 60.0, 800.0, 60.0
WINDS_MPS = (0.0, 5.0, 10.0)
PEER_PATHS = 1000
SAME_M = 1e-3


@dataclass(frozen=True)
class Compared:
    """One wind: paths a second, ours level and climbing and OMPL's; lengths against OMPL's."""

    wind_mps: float
    level_per_s: float
    climbing_per_s: float
    peer_per_s: float | None
    same: int
    shorter: int
    longer: int


def peer() -> ModuleType | None:
    """OMPL's state spaces, where it is installed."""
    try:
        return import_module("ompl.base")
    except ImportError:
        return None


def compare(wind_mps: float, paths: int, seed: int) -> Compared:
    """Ours on `paths` random pairs, OMPL on the first thousand of them."""
    random = np.random.default_rng([seed, int(wind_mps * 10)])
    limits = FlightLimits(AIRSPEED_MPS, RADIUS_M)
    pairs = [_poses(random, paths) for _ in range(2)]
    wind = (wind_mps, 0.0)
    climbing_s = _timed(pairs, limits, wind)[1]
    level = [p * [1.0, 1.0, 0.0, 1.0] for p in pairs]
    ours, level_s = _timed(level, limits, wind)
    base = peer()
    if base is None:
        return Compared(wind_mps, paths / level_s, paths / climbing_s, None, 0, 0, 0)
    some = [p[:PEER_PATHS] for p in level]
    began_s = cpu_s()
    theirs = _ompl_m(base, some[0], some[1], wind_mps)
    peer_s = cpu_s() - began_s
    more = ours[: len(theirs)] - theirs
    return Compared(
        wind_mps,
        paths / level_s,
        paths / climbing_s,
        len(theirs) / peer_s,
        int(np.sum(np.abs(more) <= SAME_M)),
        int(np.sum(more < -SAME_M)),
        int(np.sum(more > SAME_M)),
    )


def _timed(
    pairs: list[Floats], limits: FlightLimits, wind: tuple[float, float]
) -> tuple[Floats, float]:
    began_s = cpu_s()
    lengths = join_poses(pairs[0], pairs[1], limits, wind).air_length_m
    return lengths, cpu_s() - began_s


def _poses(random: np.random.Generator, count: int) -> Floats:
    return np.column_stack(
        [
            random.uniform(0.0, SIDE_M, (count, 2)),
            random.uniform(-HEIGHT_M, HEIGHT_M, count),
            random.uniform(0.0, 2.0 * np.pi, count),
        ]
    )


def _ompl_m(base: ModuleType, start: Floats, goal: Floats, wind_mps: float) -> Floats:
    space = (
        base.TrochoidStateSpace(RADIUS_M, wind_mps / AIRSPEED_MPS, 0.0)
        if wind_mps > 0.0
        else base.DubinsStateSpace(RADIUS_M)
    )
    bounds = base.RealVectorBounds(2)
    bounds.setLow(-1e6)
    bounds.setHigh(1e6)
    space.setBounds(bounds)
    a, b = space.allocState(), space.allocState()
    lengths = np.empty(len(start))
    for i, (from_, to) in enumerate(zip(start, goal, strict=True)):
        for state, pose in ((a, from_), (b, to)):
            state.setX(float(pose[0]))
            state.setY(float(pose[1]))
            state.setYaw(float(pose[3]))
        lengths[i] = space.distance(a, b)
    return lengths


def sheet(rows: list[Compared]) -> Sheet:
    """Speeds, ratios and lengths."""
    head = ["wind m/s", "level, paths/s", "climbing, paths/s", "OMPL, paths/s", "ours / OMPL"]
    head += ["as long", "ours shorter", "ours longer"]
    cells = []
    for row in rows:
        first = [f"{row.wind_mps:g}", f"{row.level_per_s:.0f}", f"{row.climbing_per_s:.0f}"]
        if row.peer_per_s is None:
            cells.append([*first, *["ompl is not installed"] * 5])
            continue
        ratio = row.level_per_s / row.peer_per_s
        counts = (str(row.same), str(row.shorter), str(row.longer))
        cells.append([*first, f"{row.peer_per_s:.0f}", f"{ratio:.2g}", *counts])
    note = (
        f"CPU time of one core; {AIRSPEED_MPS:g} m/s, turns of {RADIUS_M:g} m, poses in a square"
        f" of {SIDE_M:g} m, heights within {HEIGHT_M:g} m where it climbs. Lengths: level paths"
        f" against OMPL's Dubins (no wind) and trochoids, within {SAME_M * 1000:g} mm."
    )
    return Sheet("Dubins paths in wind", head, cells, note)
