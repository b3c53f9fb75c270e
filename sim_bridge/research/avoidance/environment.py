"""The paper's decision problem (arXiv 2604.13441, IV-B) over a batch of worlds.

Observation: 155 x 155 cells about the drone in three binary channels (obstacles, neighbours,
neighbours' goals), and two vectors in metres: to one's own goal, and from the truck to its goal
(zero while the objective is a customer). The paper leaves open which way is up: `ViewFrame.NORTH`,
or `ViewFrame.GOAL`, where up (and heading 0) is the way to the goal, so that one lesson serves
every direction. The truck's own goal is where it will be met. Here it stands, so the vector that
the paper gives a returning drone is the truck's place as the drone sees it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bytes, Floats
from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance.scenes import CELL_M, VIEW_CELLS, cells_of
from sim_bridge.research.avoidance.ways_around import WaysAround
from sim_bridge.research.avoidance.world import (
    DECISION_S,
    GOAL_M,
    MAX_SPEED_MPS,
    TICKS,
    AvoidanceWorld,
)

CHANNELS = 3
MARK_CELLS = 1  # a neighbour or a goal is a square of 3 x 3 cells
AT_ONCE = 16  # views drawn at once, so that the working set stays in cache


class ViewFrame(StrEnum):
    """What is up in the field of view, and heading 0 of an action."""

    NORTH = "north"
    GOAL = "goal"


@dataclass(frozen=True, slots=True)
class PaperReward:
    """The paper's reward (IV-B): every constant is its own; `wind_lambda` is its lambda."""

    step: float = -0.2
    goal: float = 20.0
    progress_per_m: float = 0.02
    obstacle: float = -2.0
    near_k2: float = -400.0
    near_k3: float = 50.0
    wind_lambda: float = 0.2

    def __call__(self, flown: "DecisionResult") -> Floats:
        squared = flown.distance_m**2
        near = np.where(flown.seen, self.near_k2 / (squared + self.near_k3), 0.0).sum(axis=-1)
        return (
            self.step
            + self.goal * flown.arrived
            + self.progress_per_m * flown.progress_m
            + self.obstacle * flown.hit_building
            + near
            - self.wind_lambda * flown.wind_cost
        )


@dataclass(frozen=True, slots=True)
class SharperReward:
    """Ours: who is far costs nothing, who is near a lot, and progress is worth its time.

    The paper's proximity term is -0.03 for a neighbour 110 m away and -5 at 5 m, for ever; summed
    over seven neighbours in view it outweighs the goal, so staying away from everybody pays.
    """

    step: float = -0.1
    goal: float = 5.0
    progress_per_m: float = 1.0 / 30.0
    obstacle: float = -4.0
    near_m: float = 30.0
    near: float = -3.0
    collision: float = -5.0
    refused: float = -0.5

    def __call__(self, flown: "DecisionResult") -> Floats:
        closeness = np.maximum(1.0 - flown.nearest_m / self.near_m, 0.0) ** 2
        return (
            self.step
            + self.goal * flown.arrived
            + self.progress_per_m * flown.progress_m
            + self.obstacle * flown.hit_building
            + self.near * closeness
            + self.collision * flown.hit_drone
            + self.refused * flown.refused
        )


@dataclass(frozen=True, slots=True)
class SwiftReward:
    """Ours, in seconds: what a decision costs is the time it did not save, and collisions.

    Progress is measured along the shortest way round the buildings (known in training only), so it
    is a potential (Ng, Harada and Russell, ICML 1999): the best policy is the quickest one that
    meets nobody, and a detour pays at once what it is worth. Flying as fast as one may along that
    way costs nothing.
    """

    fastest_mps: float = MAX_SPEED_MPS
    obstacle: float = -6.0
    near_m: float = 18.0
    near: float = -2.0
    collision: float = -6.0

    def __call__(self, flown: "DecisionResult") -> Floats:
        closeness = np.maximum(1.0 - flown.nearest_m / self.near_m, 0.0) ** 2
        saved_s = (flown.way_m + GOAL_M * flown.arrived) / self.fastest_mps
        return (
            np.where(flown.arrived > 0.0, 0.5, 1.0) * -DECISION_S  # on average half of it is flown
            + saved_s
            + self.obstacle * flown.hit_building
            + self.near * closeness
            + self.collision * flown.hit_drone
        )


Reward = Callable[["DecisionResult"], Floats]
REWARDS: dict[str, Reward] = {
    "paper": PaperReward(),
    "sharper": SharperReward(),
    "swift": SwiftReward(),
}


@dataclass(frozen=True)
class DecisionResult:
    """What one decision came to; arrays (E, N), distances (E, N, N)."""

    arrived: Floats
    progress_m: Floats  # as the crow flies
    way_m: Floats  # progress along the shortest way round the buildings
    hit_building: Floats
    hit_drone: Floats
    distance_m: Floats
    seen: NDArray[np.bool_]
    nearest_m: Floats  # over the whole step
    wind_cost: Floats
    refused: Floats


@dataclass(frozen=True)
class Observation:
    """`view` (E, N, 3, 155, 155) of 0 and 1; `vectors_m` (E, N, 4): goal, truck's goal."""

    view: Bytes
    vectors_m: NDArray[np.float32]


@dataclass
class AvoidEnvironment:
    """`observe`, `step(actions)`; actions (E, N, 2) in [-1, 1]: heading over pi, and speed."""

    world: AvoidanceWorld
    reward: Reward = field(default_factory=PaperReward)
    frame: ViewFrame = ViewFrame.NORTH
    separation: SeparationFilter | None = None
    power_w: Callable[[Floats], Floats] | None = None
    ways: WaysAround | None = None  # without: the way is as the crow flies
    _way: tuple[Floats, Floats] | None = field(default=None, init=False)
    _from_corners_m: Floats | None = field(default=None, init=False)

    def reset(self, seeds: list[int]) -> None:
        self.world.reset(seeds)
        self._from_corners_m = None
        self._way = self._way_now()

    def _way_now(self) -> tuple[Floats, Floats]:
        """North-based bearing and length of each agent's way to its goal; (E, N) each."""
        w = self.world
        if self.ways is None:
            return w.to_goal()
        scene_of, goal = np.repeat(w.scene_of, w.agents), w.goal_ne_m.reshape(-1, 2)
        if self._from_corners_m is None:
            self._from_corners_m = self.ways.from_corners_m(scene_of, goal)
        bearing, length = self.ways.next_leg(
            scene_of, w.pos_m[..., :2].reshape(-1, 2), goal, self._from_corners_m
        )
        return bearing.reshape(w.active.shape), length.reshape(w.active.shape)

    def taught(self) -> Floats:
        """The actions (E, N, 2) that lead along the shortest way at full speed."""
        off = (self._way or self._way_now())[0] - up_of(self.world, self.frame)
        heading = (off + np.pi) % (2.0 * np.pi) - np.pi
        return np.stack([heading / np.pi, np.ones_like(heading)], axis=-1)

    def observe(self) -> Observation:
        return observe(self.world, self.frame)

    def step(self, actions: Floats) -> Floats:
        """Fly 2 s by these actions; the rewards (E, N), zero for who was done before."""
        w = self.world
        active, distance, way = w.active.copy(), w.to_goal()[1], (self._way or self._way_now())[1]
        hits = w.hit_building.copy(), w.hit_drone.copy()
        w.hit_building[:], w.hit_drone[:] = False, False
        apart = w.apart
        w.apart = np.full(active.shape, np.inf)
        refused, wind_cost = np.zeros(active.shape), np.zeros(active.shape)
        heading = heading_of(w, actions, self.frame)
        for _ in range(TICKS):
            wanted = w.velocity_of(heading, speed_of(actions))
            if self.separation is not None:
                wanted, not_granted = w.filtered(wanted, self.separation)
                refused += not_granted / TICKS
            w.tick(wanted)
            wind_cost += self._wind_cost() * w.active / TICKS
        self._way = self._way_now()
        flown = self._flown(active, distance, way - self._way[1], refused, wind_cost)
        w.apart = np.minimum(w.apart, apart)
        w.hit_building |= hits[0]
        w.hit_drone |= hits[1]
        return np.where(active, self.reward(flown), 0.0)

    def _flown(
        self,
        active: NDArray[np.bool_],
        before: Floats,
        way_m: Floats,
        refused: Floats,
        wind: Floats,
    ) -> DecisionResult:
        w = self.world
        away = w.pos_m[:, :, None, :2] - w.pos_m[:, None, :, :2]
        distance = np.linalg.norm(away, axis=-1)
        others = active[:, :, None] & w.active[:, None] & ~np.eye(w.agents, dtype=bool)
        return DecisionResult(
            arrived=(active & ~w.active).astype(float),
            progress_m=before - w.to_goal()[1],
            way_m=way_m,
            hit_building=w.hit_building.astype(float),
            hit_drone=w.hit_drone.astype(float),
            distance_m=distance,
            seen=others & (np.abs(away).max(axis=-1) < CELL_M * VIEW_CELLS / 2),
            nearest_m=w.apart * w.params.horizontal_m,
            wind_cost=wind,
            refused=refused,
        )

    def _wind_cost(self) -> Floats:
        """L_wind: what the wind adds to the power of this ground speed, in hover powers."""
        if self.power_w is None:
            return np.zeros(self.world.active.shape)
        ground = self.world.vel_mps[..., :2]
        air = np.linalg.norm(ground - self.world.wind_ne_mps[:, None], axis=-1)
        still = np.linalg.norm(ground, axis=-1)
        return (self.power_w(air) - self.power_w(still)) / self.power_w(np.zeros(1))


def speed_of(actions: Floats) -> Floats:
    return 0.5 * (np.clip(actions[..., 1], -1.0, 1.0) + 1.0) * MAX_SPEED_MPS


def heading_of(world: AvoidanceWorld, actions: Floats, frame: ViewFrame) -> Floats:
    """North-based headings (E, N) of actions that are taken in this frame."""
    return up_of(world, frame) + np.pi * np.clip(actions[..., 0], -1.0, 1.0)


def up_of(world: AvoidanceWorld, frame: ViewFrame) -> Floats:
    """Which bearing is up; (E, N)."""
    return world.to_goal()[0] if frame is ViewFrame.GOAL else np.zeros(world.active.shape)


def observe(world: AvoidanceWorld, frame: ViewFrame) -> Observation:
    """What every agent sees; views of agents that are done are left empty."""
    shape = world.active.shape
    view = np.zeros((*shape, CHANNELS, VIEW_CELLS, VIEW_CELLS), dtype=np.uint8)
    up = up_of(world, frame)
    agents = np.argwhere(world.active)
    for first in range(0, len(agents), AT_ONCE):
        e, i = agents[first : first + AT_ONCE].T
        view[e, i, 0] = _obstacles(world, e, i, up[e, i])
    said = world.reports()[0][..., :2]
    for channel, points in ((1, said), (2, world.goal_ne_m)):
        _mark(view[:, :, channel], world, points, up)
    return Observation(view, _vectors(world, up))


def _offsets() -> Floats:
    """Cells' centres about the drone, metres: up and right; row 0 is the farthest up."""
    span = (np.arange(VIEW_CELLS, dtype=np.float64) - VIEW_CELLS // 2) * CELL_M
    up, right = np.meshgrid(-span, span, indexing="ij")
    return np.stack([up, right], axis=-1)


OFFSETS_M = _offsets().astype(np.float32)


def _obstacles(
    world: AvoidanceWorld, e: NDArray[np.int64], i: NDArray[np.int64], up: Floats
) -> Bytes:
    c, s = (f(up).astype(np.float32)[:, None, None] / CELL_M for f in (np.cos, np.sin))
    here = (world.pos_m[e, i, :2] - _origin_m()).astype(np.float32)[:, None, None] / CELL_M
    rows = (here[..., 0] + c * OFFSETS_M[..., 0] - s * OFFSETS_M[..., 1]).astype(np.int32)
    columns = (here[..., 1] + s * OFFSETS_M[..., 0] + c * OFFSETS_M[..., 1]).astype(np.int32)
    rasters = world.obstacle_rasters
    side = rasters.shape[1]
    np.clip(rows, 0, side - 1, out=rows)
    np.clip(columns, 0, side - 1, out=columns)
    flat = (world.scene_of[e][:, None, None].astype(np.int32) * side + rows) * side + columns
    return rasters.reshape(-1)[flat]


def _origin_m() -> Floats:
    """North-east of the raster's first corner."""
    corner = np.zeros(2)
    return -CELL_M * cells_of(corner).astype(np.float64)


def _mark(view: Bytes, world: AvoidanceWorld, points_ne_m: Floats, up: Floats) -> None:
    """Set squares about the neighbours' points in every agent's view, in place."""
    away = points_ne_m[:, None] - world.pos_m[:, :, None, :2]
    c, s = np.cos(up)[..., None], np.sin(up)[..., None]
    ahead = c * away[..., 0] + s * away[..., 1]
    right = -s * away[..., 0] + c * away[..., 1]
    row = np.rint(VIEW_CELLS // 2 - ahead / CELL_M).astype(np.int64)
    column = np.rint(VIEW_CELLS // 2 + right / CELL_M).astype(np.int64)
    others = world.active[:, :, None] & world.active[:, None] & ~np.eye(world.agents, dtype=bool)
    for dr in range(-MARK_CELLS, MARK_CELLS + 1):
        for dc in range(-MARK_CELLS, MARK_CELLS + 1):
            r, k = row + dr, column + dc
            seen = others & (r >= 0) & (r < VIEW_CELLS) & (k >= 0) & (k < VIEW_CELLS)
            e, i, j = np.nonzero(seen)
            view[e, i, r[e, i, j], k[e, i, j]] = 1


def _vectors(world: AvoidanceWorld, up: Floats) -> NDArray[np.float32]:
    goal = world.goal_ne_m - world.pos_m[..., :2]
    truck = world.truck_ne_m[:, None] - world.pos_m[..., :2]
    truck = np.where(world.returning[..., None], truck, 0.0)
    c, s = np.cos(up), np.sin(up)
    turned = [
        part
        for v in (goal, truck)
        for part in (c * v[..., 0] + s * v[..., 1], -s * v[..., 0] + c * v[..., 1])
    ]
    return (np.stack(turned, axis=-1) * world.active[..., None]).astype(np.float32)
