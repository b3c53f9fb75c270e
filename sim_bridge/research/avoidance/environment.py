"""The paper's decision problem (arXiv 2604.13441, IV-B) over a batch of worlds.

Observation: 155 x 155 cells around the drone in three binary channels (obstacles, neighbours,
neighbours' goals), and two vectors in metres: to the drone's goal, and from the truck to its goal
(zero while the objective is a customer). The paper does not define the orientation of the view:
here up (and heading 0) is the bearing of the goal, so that one policy serves every direction. The
truck's goal is the rendezvous point. The truck is stationary here, so the vector of a returning
drone is the truck's position relative to the drone.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bytes, Floats
from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance.obstacle_paths import ObstaclePaths
from sim_bridge.research.avoidance.scenes import CELL_M, VIEW_CELLS, raster_cell_indices
from sim_bridge.research.avoidance.world import (
    DECISION_S,
    GOAL_RADIUS_M,
    MAX_SPEED_MPS,
    TICKS,
    AvoidanceWorld,
)

CHANNELS = 3
MARK_CELLS = 1  # marks a neighbour or a goal with a square of 3 x 3 cells
OBSERVATION_BATCH = 16  # views per batch, so that the working set stays in cache


@dataclass(frozen=True, slots=True)
class PaperReward:
    """The paper's reward (IV-B) with its constants; `wind_lambda` is its lambda."""

    step: float = -0.2
    goal: float = 20.0
    progress_per_m: float = 0.02
    obstacle: float = -2.0
    near_k2: float = -400.0
    near_k3: float = 50.0
    wind_lambda: float = 0.2

    def __call__(self, result: "DecisionResult") -> Floats:
        squared = result.distance_m**2
        near = np.where(result.seen, self.near_k2 / (squared + self.near_k3), 0.0).sum(axis=-1)
        return (
            self.step
            + self.goal * result.arrived
            + self.progress_per_m * result.progress_m
            + self.obstacle * result.hit_obstacle
            + near
            - self.wind_lambda * result.wind_cost
        )


@dataclass(frozen=True, slots=True)
class SwiftReward:
    """Reward of this project, in seconds: the time that a decision did not save, and collisions.

    Progress is measured along the shortest path around the buildings (known in training only). It
    is a potential (Ng, Harada and Russell, ICML 1999): the best policy is the fastest one without
    conflicts, and a detour is rewarded immediately. Flight at maximum speed along that path costs
    nothing.
    """

    fastest_mps: float = MAX_SPEED_MPS
    obstacle: float = -6.0
    near_m: float = 18.0
    near: float = -2.0
    collision: float = -6.0

    def __call__(self, result: "DecisionResult") -> Floats:
        closeness = np.maximum(1.0 - result.nearest_m / self.near_m, 0.0) ** 2
        saved_s = (result.path_progress_m + GOAL_RADIUS_M * result.arrived) / self.fastest_mps
        return (
            np.where(result.arrived > 0.0, 0.5, 1.0)
            * -DECISION_S  # on average half a step is flown
            + saved_s
            + self.obstacle * result.hit_obstacle
            + self.near * closeness
            + self.collision * result.hit_drone
        )


Reward = Callable[["DecisionResult"], Floats]
REWARDS: dict[str, Reward] = {
    "paper": PaperReward(),
    "swift": SwiftReward(),
}


@dataclass(frozen=True)
class DecisionResult:
    """Result of one decision; arrays (E, N), distances (E, N, N)."""

    arrived: Floats
    progress_m: Floats  # in a straight line
    path_progress_m: Floats  # progress along the shortest path around the buildings
    hit_obstacle: Floats
    hit_drone: Floats
    distance_m: Floats
    seen: NDArray[np.bool_]
    nearest_m: Floats  # over the whole step
    wind_cost: Floats


@dataclass(frozen=True)
class PolicyObservation:
    """`view` (E, N, 3, 155, 155) of 0 and 1; `vectors_m` (E, N, 4): goal, truck's goal."""

    view: Bytes
    vectors_m: NDArray[np.float32]


@dataclass
class AvoidanceEnvironment:
    """Decision environment; actions (E, N, 2) in [-1, 1]: heading over pi, and speed."""

    world: AvoidanceWorld
    reward: Reward = field(default_factory=PaperReward)
    separation: SeparationFilter | None = None
    power_w: Callable[[Floats], Floats] | None = None
    obstacle_paths: ObstaclePaths | None = None  # None: the path is the straight line
    _path: tuple[Floats, Floats] | None = field(default=None, init=False)
    _corner_to_goal_m: Floats | None = field(default=None, init=False)

    def reset(self, seeds: list[int]) -> None:
        self.world.start_random_episodes(seeds)
        self._corner_to_goal_m = None
        self._path = self._path_bearing_rad_and_length_m()

    def _path_bearing_rad_and_length_m(self) -> tuple[Floats, Floats]:
        """Return north-based bearing and length of each agent's path to its goal; (E, N) each."""
        w = self.world
        if self.obstacle_paths is None:
            return w.goal_bearing_rad_and_distance_m()
        scene_of, goal = np.repeat(w.scene_of, w.agents), w.goal_ne_m.reshape(-1, 2)
        if self._corner_to_goal_m is None:
            self._corner_to_goal_m = self.obstacle_paths.shortest_corner_to_goal_lengths_m(
                scene_of, goal
            )
        bearing, length = self.obstacle_paths.initial_bearing_and_path_length(
            scene_of, w.pos_m[..., :2].reshape(-1, 2), goal, self._corner_to_goal_m
        )
        return bearing.reshape(w.active.shape), length.reshape(w.active.shape)

    def shortest_path_actions(self) -> Floats:
        """Return the actions (E, N, 2) that follow the shortest path at full speed."""
        path_bearing = (self._path or self._path_bearing_rad_and_length_m())[0]
        off = path_bearing - self.world.goal_bearing_rad_and_distance_m()[0]
        heading = (off + np.pi) % (2.0 * np.pi) - np.pi
        return np.stack([heading / np.pi, np.ones_like(heading)], axis=-1)

    def fly_decision_and_return_rewards(self, actions: Floats) -> Floats:
        """Fly 2 s with these actions. Return the rewards (E, N), zero for agents already done."""
        w = self.world
        active, distance, path = (
            w.active.copy(),
            w.goal_bearing_rad_and_distance_m()[1],
            (self._path or self._path_bearing_rad_and_length_m())[1],
        )
        hits = w.hit_obstacle.copy(), w.hit_drone.copy()
        w.hit_obstacle[:], w.hit_drone[:] = False, False
        min_separation = w.min_separation
        w.min_separation = np.full(active.shape, np.inf)
        wind_cost = np.zeros(active.shape)
        heading = action_headings_rad(w, actions)
        for _ in range(TICKS):
            velocity_mps = w.attainable_velocity_mps(heading, action_speeds_mps(actions))
            if self.separation is not None:
                velocity_mps = w.filter_velocities(velocity_mps, self.separation)
            w.tick(velocity_mps)
            wind_cost += self._wind_power_in_hover_powers() * w.active / TICKS
        self._path = self._path_bearing_rad_and_length_m()
        result = self._evaluate_decision(active, distance, path - self._path[1], wind_cost)
        w.min_separation = np.minimum(w.min_separation, min_separation)
        w.hit_obstacle |= hits[0]
        w.hit_drone |= hits[1]
        return np.where(active, self.reward(result), 0.0)

    def _evaluate_decision(
        self,
        active: NDArray[np.bool_],
        distance_before_m: Floats,
        path_progress_m: Floats,
        wind_cost: Floats,
    ) -> DecisionResult:
        w = self.world
        away = w.pos_m[:, :, None, :2] - w.pos_m[:, None, :, :2]
        distance = np.linalg.norm(away, axis=-1)
        others = active[:, :, None] & w.active[:, None] & ~np.eye(w.agents, dtype=bool)
        return DecisionResult(
            arrived=(active & ~w.active).astype(float),
            progress_m=distance_before_m - w.goal_bearing_rad_and_distance_m()[1],
            path_progress_m=path_progress_m,
            hit_obstacle=w.hit_obstacle.astype(float),
            hit_drone=w.hit_drone.astype(float),
            distance_m=distance,
            seen=others & (np.abs(away).max(axis=-1) < CELL_M * VIEW_CELLS / 2),
            nearest_m=w.min_separation * w.params.horizontal_m,
            wind_cost=wind_cost,
        )

    def _wind_power_in_hover_powers(self) -> Floats:
        """L_wind: power that the wind adds at this ground speed, as a multiple of hover power."""
        if self.power_w is None:
            return np.zeros(self.world.active.shape)
        ground = self.world.vel_mps[..., :2]
        air = np.linalg.norm(ground - self.world.wind_ne_mps[:, None], axis=-1)
        still = np.linalg.norm(ground, axis=-1)
        return (self.power_w(air) - self.power_w(still)) / self.power_w(np.zeros(1))


def action_speeds_mps(actions: Floats) -> Floats:
    return 0.5 * (np.clip(actions[..., 1], -1.0, 1.0) + 1.0) * MAX_SPEED_MPS


def action_headings_rad(world: AvoidanceWorld, actions: Floats) -> Floats:
    """Return the north-based headings (E, N) of actions."""
    up = world.goal_bearing_rad_and_distance_m()[0]
    return up + np.pi * np.clip(actions[..., 0], -1.0, 1.0)


def observe_all_agents(world: AvoidanceWorld) -> PolicyObservation:
    """Return the observation of every agent. The views of agents that are done stay empty."""
    shape = world.active.shape
    view = np.zeros((*shape, CHANNELS, VIEW_CELLS, VIEW_CELLS), dtype=np.uint8)
    up = world.goal_bearing_rad_and_distance_m()[0]
    agents = np.argwhere(world.active)
    for first in range(0, len(agents), OBSERVATION_BATCH):
        e, i = agents[first : first + OBSERVATION_BATCH].T
        view[e, i, 0] = _obstacle_channel(world, e, i, up[e, i])
    reported = world.delayed_reported_pos_and_vel()[0][..., :2]
    for channel, points in ((1, reported), (2, world.goal_ne_m)):
        _mark_neighbour_points_in_place(view[:, :, channel], world, points, up)
    return PolicyObservation(view, _goal_and_truck_vectors_m(world, up))


_SPAN_M = (np.arange(VIEW_CELLS, dtype=np.float64) - VIEW_CELLS // 2) * CELL_M
OFFSETS_M = np.stack(np.meshgrid(-_SPAN_M, _SPAN_M, indexing="ij"), axis=-1).astype(np.float32)
"""Cell centres relative to the drone, m: up and right; row 0 is the topmost."""

RASTER_ORIGIN_NE_M = -CELL_M * raster_cell_indices(np.zeros(2)).astype(np.float64)
"""North-east position of the raster's first corner."""


def _obstacle_channel(
    world: AvoidanceWorld,
    episode_index: NDArray[np.int64],
    agent_index: NDArray[np.int64],
    up_bearing_rad: Floats,
) -> Bytes:
    c, s = (f(up_bearing_rad).astype(np.float32)[:, None, None] / CELL_M for f in (np.cos, np.sin))
    here = (world.pos_m[episode_index, agent_index, :2] - RASTER_ORIGIN_NE_M).astype(np.float32)[
        :, None, None
    ] / CELL_M
    rows = (here[..., 0] + c * OFFSETS_M[..., 0] - s * OFFSETS_M[..., 1]).astype(np.int32)
    columns = (here[..., 1] + s * OFFSETS_M[..., 0] + c * OFFSETS_M[..., 1]).astype(np.int32)
    rasters = world.obstacle_rasters
    side = rasters.shape[1]
    np.clip(rows, 0, side - 1, out=rows)
    np.clip(columns, 0, side - 1, out=columns)
    flat = (
        world.scene_of[episode_index][:, None, None].astype(np.int32) * side + rows
    ) * side + columns
    return rasters.reshape(-1)[flat]


def _mark_neighbour_points_in_place(
    view: Bytes, world: AvoidanceWorld, points_ne_m: Floats, up_bearing_rad: Floats
) -> None:
    """Mark the neighbours' points with squares in every agent's view, in place."""
    away = points_ne_m[:, None] - world.pos_m[:, :, None, :2]
    c, s = np.cos(up_bearing_rad)[..., None], np.sin(up_bearing_rad)[..., None]
    forward = c * away[..., 0] + s * away[..., 1]
    right = -s * away[..., 0] + c * away[..., 1]
    row = np.rint(VIEW_CELLS // 2 - forward / CELL_M).astype(np.int64)
    column = np.rint(VIEW_CELLS // 2 + right / CELL_M).astype(np.int64)
    others = world.active[:, :, None] & world.active[:, None] & ~np.eye(world.agents, dtype=bool)
    for dr in range(-MARK_CELLS, MARK_CELLS + 1):
        for dc in range(-MARK_CELLS, MARK_CELLS + 1):
            r, k = row + dr, column + dc
            seen = others & (r >= 0) & (r < VIEW_CELLS) & (k >= 0) & (k < VIEW_CELLS)
            e, i, j = np.nonzero(seen)
            view[e, i, r[e, i, j], k[e, i, j]] = 1


def _goal_and_truck_vectors_m(world: AvoidanceWorld, up_bearing_rad: Floats) -> NDArray[np.float32]:
    goal = world.goal_ne_m - world.pos_m[..., :2]
    truck = world.truck_ne_m[:, None] - world.pos_m[..., :2]
    truck = np.where(world.returning[..., None], truck, 0.0)
    c, s = np.cos(up_bearing_rad), np.sin(up_bearing_rad)
    rotated = [
        part
        for v in (goal, truck)
        for part in (c * v[..., 0] + s * v[..., 1], -s * v[..., 0] + c * v[..., 1])
    ]
    return (np.stack(rotated, axis=-1) * world.active[..., None]).astype(np.float32)
