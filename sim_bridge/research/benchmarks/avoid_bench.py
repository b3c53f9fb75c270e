"""What one decision costs on board: the safety filter with many neighbours, the actor's velocity.

The scenes are of one drone at 12 m/s with neighbours all about it that come towards it at up to
10 m/s; the nearest of them 30, 60, 90 and 140 m away in turn, so that in some the wish passes
and in others it has to be bent. The actor is asked as in flight, its view of a town drawn first.
"""

import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time_ns

import numpy as np
import shapely

from companion.core.separation.learned_policy import AvoidancePolicy
from companion.core.separation.policy_view import Around, wish_of
from companion.core.separation.separation_filter import FilterAction, SeparationFilter
from companion.core.separation.stopping_paths import Neighbours
from sim_bridge.research.avoidance.scenes import make_scene
from sim_bridge.research.benchmarks.timing import Samples
from sim_bridge.research.results.sheet import Sheet

SPEED_MPS, WISH_MPS = 12.0, (14.0, 3.0, 0.0)
NEAREST_M, SPREAD_M = (30.0, 60.0, 90.0, 140.0), 90.0
CLOSING_MPS = 10.0
AGE_S, POS_STD_M, ALT_STD_M, VEL_STD_MPS = 0.2, 2.0, 0.5, 0.1  # docs/reference/benchmarks.md
LAYER_DOWN_M = 8.0
VIEW_HALF_M = 220.0  # buildings farther off than the view's diagonal are not drawn
FILTER_WANTED_MS, ACTOR_WANTED_MS = 1.0, 5.0
COLD = 20  # first decisions that are not counted: caches fill


@dataclass(frozen=True)
class Costs:
    """Milliseconds of CPU of each decision of a kind."""

    what: str
    wanted_ms: float
    each_ms: list[float]

    def cells(self) -> list[str]:
        if not self.each_ms:
            return [self.what, "0", "-", "-", "-", f"{self.wanted_ms:g}"]
        each = Samples.of(self.each_ms)
        shown = [f"{ms:.2f}" for ms in (each.least, each.median, each.p99)]
        return [self.what, str(each.n), *shown, f"{self.wanted_ms:g}"]


def filter_costs(scenes: int, neighbours: int, seed: int) -> Iterator[tuple[FilterAction, float]]:
    """What the filter did in each scene, and what it took, ms."""
    separation, random = SeparationFilter(), np.random.default_rng([seed, neighbours])
    vel, layer = np.array([[SPEED_MPS, 0.0, 0.0]]), np.array([LAYER_DOWN_M])
    for scene in range(-COLD, scenes):
        heard = _crowd(random, neighbours, NEAREST_M[scene % len(NEAREST_M)])
        began = process_time_ns()
        found = separation.safe(np.zeros((1, 3)), vel, np.array([WISH_MPS]), heard, layer)
        took = process_time_ns() - began
        if scene >= 0:
            yield FilterAction(int(found.verdict[0])), 1e-6 * took


def _crowd(random: np.random.Generator, count: int, nearest_m: float) -> Neighbours:
    angle = random.uniform(0.0, 2.0 * np.pi, count)
    distance = random.uniform(nearest_m, nearest_m + SPREAD_M, count)
    ahead = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=-1)
    pos = distance[:, None] * ahead
    pos[:, 2] = random.uniform(-2.0, 2.0, count)
    vel = -random.uniform(0.0, CLOSING_MPS, count)[:, None] * ahead
    each = np.ones((1, count))
    return Neighbours(
        pos[None],
        vel[None],
        AGE_S * each,
        POS_STD_M * each,
        ALT_STD_M * each,
        VEL_STD_MPS * each,
        np.ones((1, count), dtype=bool),
    )


def actor_costs(
    policy: AvoidancePolicy, scenes: int, neighbours: int, seed: int
) -> Iterator[float]:
    """What the actor's wish takes, its view of a generated town included, ms."""
    random = np.random.default_rng([seed, neighbours, 1])
    boxes = make_scene(random).boxes_m
    town = [shapely.box(south, west, north, east) for south, west, north, east in boxes]
    for scene in range(-COLD, scenes):
        here, goal = random.uniform(-300.0, 300.0, 2), random.uniform(-380.0, 380.0, 2)
        near = shapely.Point(*here).buffer(VIEW_HALF_M)
        points = [tuple(p) for p in here + random.uniform(-150.0, 150.0, (2 * neighbours, 2))]
        around = Around(
            here=(float(here[0]), float(here[1])),
            goal=(float(goal[0]), float(goal[1])),
            truck=None,
            neighbours=points[:neighbours],
            goals=points[neighbours:],
            obstacles=[box for box in town if box.intersects(near)],
        )
        began = process_time_ns()
        wish_of(policy, around)
        took = process_time_ns() - began
        if scene >= 0:
            yield 1e-6 * took


def measured(
    policy: AvoidancePolicy,
    scenes: int,
    neighbours: int,
    seed: int,
    shown: Callable[[], None] = lambda: None,
) -> list[Costs]:
    """The filter where the wish passes and where it is bent, and the actor; `shown` each time."""
    passed: list[float] = []
    bent: list[float] = []
    for verdict, took_ms in filter_costs(scenes, neighbours, seed):
        (passed if verdict is FilterAction.PASSED else bent).append(took_ms)
        shown()
    asked = []
    for took_ms in actor_costs(policy, scenes, neighbours, seed):
        asked.append(took_ms)
        shown()
    return [
        Costs("filter, wish passed", FILTER_WANTED_MS, passed),
        Costs("filter, wish bent", FILTER_WANTED_MS, bent),
        Costs("actor with its view", ACTOR_WANTED_MS, asked),
    ]


def machine() -> str:
    """The processor, its cores, and what else runs on them."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    name = names[0] if names else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores{load}, numpy {np.__version__}"


def sheet(costs: list[Costs], neighbours: int) -> Sheet:
    """Least, median and 99 % of each kind."""
    head = ["a decision", "scenes", "least, ms", "median, ms", "99 %, ms", "wanted, ms"]
    note = f"CPU of one thread, {neighbours} neighbours. {machine()}."
    return Sheet("A decision on board", head, [cost.cells() for cost in costs], note)
