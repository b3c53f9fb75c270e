"""Many episodes of drones over a town in parallel: the world of policies and trainer.

As in arXiv 2604.13441, IV-B, there is a decision every 2 s. Between decisions a low-level
controller with limited acceleration runs at 5 Hz. The true motion is the commanded one plus gusts.
Reports of neighbours are 200 ms late and 2 m off (docs/reference/benchmarks.md). Arrays are
(episodes, agents, ...), north, east, down from the town's centre; the flight height is 0.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats
from companion.core.separation.separation_filter import SeparationFilter
from companion.core.separation.stopping_paths import Neighbours, SeparationParams
from sim_bridge.research.avoidance.scenes import (
    DroneLayout,
    Scene,
    draw_drone_starts_and_goals,
    raster_cell_indices,
)

DECISION_S = 2.0
TICK_S = 0.2
TICKS = round(DECISION_S / TICK_S)
SUBSTEPS = 4  # separation checks per tick
GOAL_RADIUS_M = 20.0
MAX_SPEED_MPS = 15.0
MAX_AIRSPEED_MPS = 19.0
REPORT_DELAY_TICKS = 1  # 200 ms
REPORT_STD_M = 2.0
REPORT_VERTICAL_STD_M = 0.5
REPORT_ERROR_TIME_CONSTANT_S = 30.0  # GNSS errors drift slowly, so averaging does not reduce them
VELOCITY_STD_MPS = 0.1
GUST_M = 0.15  # displacement from the commanded position by gusts, per axis
GUST_TIME_CONSTANT_S = 3.0
WIND_MAX_MPS = 8.0
LAYER_M = 8.0  # between the altitude layers of the filter's vertical evasion
LAYERS = np.array([-1.0, 1.0, 0.0, -2.0, 2.0])


@dataclass
class AvoidanceWorld:
    """Episodes in lockstep; `start_random_episodes` draws them, `tick` flies 0.2 s."""

    scenes: list[Scene]
    agents: int
    wind: bool = True
    params: SeparationParams = field(default_factory=SeparationParams)

    def start_random_episodes(self, seed_by_episode: list[int]) -> None:
        """Draw episode e from seeds[e] alone: scene, starts, goals, wind and all errors."""
        self.random = [np.random.default_rng([20240, seed]) for seed in seed_by_episode]
        self.scene_of = np.array([int(r.integers(len(self.scenes))) for r in self.random])
        drawn = [
            draw_drone_starts_and_goals(self.scenes[s], self.agents, r)
            for s, r in zip(self.scene_of, self.random, strict=True)
        ]
        count = len(seed_by_episode)
        self._initialize_state(drawn)
        speed = np.array([r.uniform(0.0, WIND_MAX_MPS) for r in self.random]) * self.wind
        angle = np.array([r.uniform(0.0, 2.0 * np.pi) for r in self.random])
        self.wind_ne_mps = speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.report_error_m = self._draw_standard_normals() * [
            REPORT_STD_M,
            REPORT_STD_M,
            REPORT_VERTICAL_STD_M,
        ]
        self.gust_m = np.zeros((count, self.agents, 3))
        self.t_s = 0.0
        self.report_queue = [(self.pos_m.copy(), self.vel_mps.copy())] * (REPORT_DELAY_TICKS + 1)
        self.min_separation = np.full(
            (count, self.agents), np.inf
        )  # true minimum, in separation cylinders

    def _initialize_state(self, drone_layouts: list[DroneLayout]) -> None:
        flat = np.stack([d.start_ne_m for d in drone_layouts])
        self.pos_m = np.concatenate([flat, np.zeros_like(flat[..., :1])], axis=-1)
        self.vel_mps = np.zeros_like(self.pos_m)
        self.goal_ne_m = np.stack([d.goal_ne_m for d in drone_layouts])
        self.returning = np.stack([d.returning for d in drone_layouts])
        self.truck_ne_m = np.stack([self.scenes[s].truck_ne_m for s in self.scene_of])
        self.active = np.ones(flat.shape[:2], dtype=bool)
        self.arrived = np.zeros(flat.shape[:2], dtype=bool)
        self.hit_drone, self.hit_obstacle = self.arrived.copy(), self.arrived.copy()
        self.arrived_s = np.full(flat.shape[:2], np.nan)
        self.layer_down_m = np.broadcast_to(
            LAYER_M * LAYERS[np.arange(self.agents) % len(LAYERS)], flat.shape[:2]
        )
        others = [[j for j in range(self.agents) if j != i] for i in range(self.agents)]
        self.others = np.array(others, dtype=np.int64).reshape(self.agents, self.agents - 1)
        self.clearance_rasters = np.stack([s.clearance_m for s in self.scenes])
        self.obstacle_rasters = np.stack([s.obstacle for s in self.scenes])

    def _draw_standard_normals(self) -> Floats:
        return np.stack([r.standard_normal((self.agents, 3)) for r in self.random])

    @property
    def true_pos_m(self) -> Floats:
        return self.pos_m + self.gust_m

    def delayed_reported_pos_and_vel(self) -> tuple[Floats, Floats]:
        """Return every agent's reported position and velocity, 200 ms old; (E, N, 3) each."""
        pos, vel = self.report_queue[0]
        return pos + self.report_error_m, vel

    def neighbour_reports(self, flat_agent_indices: NDArray[np.int64]) -> Neighbours:
        """Return the reports that the filter of each of `flat_agent_indices` receives."""
        pos, vel = self.delayed_reported_pos_and_vel()
        e, i = np.divmod(flat_agent_indices, self.agents)
        j = self.others[i]
        shape = j.shape
        return Neighbours(
            pos[e[:, None], j],
            vel[e[:, None], j],
            np.full(shape, REPORT_DELAY_TICKS * TICK_S),
            np.full(shape, REPORT_STD_M),
            np.full(shape, REPORT_VERTICAL_STD_M),
            np.full(shape, VELOCITY_STD_MPS),
            self.active[e[:, None], j],
        )

    def building_clearance_m(self, points: Floats, flat_agent_indices: NDArray[np.int64]) -> Floats:
        """Return metres from points (A, ..., 2 or 3) of these agents (flat) to a building."""
        cells = raster_cell_indices(points[..., :2])
        scene = self.scene_of[flat_agent_indices // self.agents].reshape(
            -1, *[1] * (cells.ndim - 2)
        )
        return self.clearance_rasters[scene, cells[..., 0], cells[..., 1]].astype(np.float64)

    def filter_velocities(
        self,
        desired_mps: Floats,
        separation: SeparationFilter,
        flat_agent_indices: NDArray[np.int64] | None = None,
    ) -> Floats:
        """Return safe velocities (E, N, 3) of the agents in `flat_agent_indices`, or of all."""
        rows = np.flatnonzero(self.active) if flat_agent_indices is None else flat_agent_indices
        found = separation.nearest_safe_velocities(
            self.pos_m.reshape(-1, 3)[rows],
            self.vel_mps.reshape(-1, 3)[rows],
            desired_mps.reshape(-1, 3)[rows],
            self.neighbour_reports(rows),
            self.layer_down_m.reshape(-1)[rows],
            lambda points, selection: self.building_clearance_m(points, rows[selection]),
        )
        safe = self.vel_mps.copy()
        safe.reshape(-1, 3)[rows] = found.vel_ned_mps
        return safe

    def tick(self, desired_velocity_mps: Floats) -> None:
        """Fly 0.2 s towards these velocities within the acceleration limits. Record conflicts."""
        new = self._acceleration_limited_velocity_mps(desired_velocity_mps)
        start, gust = self.pos_m, self.gust_m
        keep = np.exp(-TICK_S / GUST_TIME_CONSTANT_S)
        self.gust_m = keep * gust + np.sqrt(1.0 - keep**2) * self._draw_standard_normals() * [
            GUST_M,
            GUST_M,
            0.05,
        ]
        limits = [self.params.tracking_m / 1.5] * 2 + [self.params.tracking_vertical_m]
        self.gust_m = np.clip(self.gust_m, np.negative(limits), limits)
        for share in (np.arange(SUBSTEPS) + 1.0) / SUBSTEPS:
            moved = self.vel_mps * share + 0.5 * (new - self.vel_mps) * share**2
            self.pos_m = np.where(self.active[..., None], start + TICK_S * moved, start)
            self._record_conflicts(self.pos_m + gust + share * (self.gust_m - gust))
        self.vel_mps = np.where(self.active[..., None], new, 0.0)
        wander = np.exp(-TICK_S / REPORT_ERROR_TIME_CONSTANT_S)
        stds = np.array([REPORT_STD_M, REPORT_STD_M, REPORT_VERTICAL_STD_M])
        self.report_error_m = wander * self.report_error_m + (
            np.sqrt(1.0 - wander**2) * stds * self._draw_standard_normals()
        )
        self.report_queue = [*self.report_queue[1:], (self.true_pos_m, self.vel_mps.copy())]
        self.t_s += TICK_S
        self._record_arrivals()

    def _acceleration_limited_velocity_mps(self, desired_velocity_mps: Floats) -> Floats:
        p = self.params
        change = desired_velocity_mps - self.vel_mps
        flat = np.linalg.norm(change[..., :2], axis=-1, keepdims=True)
        change[..., :2] *= np.minimum(1.0, p.accel_mps2 * TICK_S / np.maximum(flat, 1e-9))
        most = p.climb_accel_mps2 * TICK_S
        change[..., 2] = np.clip(change[..., 2], -most, most)
        return self.vel_mps + change

    def _record_conflicts(self, true_pos: Floats) -> None:
        away = true_pos[:, :, None] - true_pos[:, None]
        p = self.params
        separations = np.maximum(
            np.hypot(away[..., 0], away[..., 1]) / p.horizontal_m,
            np.abs(away[..., 2]) / p.vertical_m,
        )
        both = self.active[:, :, None] & self.active[:, None] & ~np.eye(self.agents, dtype=bool)
        least = np.where(both, separations, np.inf).min(axis=-1, initial=np.inf)
        self.min_separation = np.minimum(self.min_separation, least)
        self.hit_drone |= least < 1.0
        cells = raster_cell_indices(true_pos[..., :2])
        inside = self.obstacle_rasters[self.scene_of[:, None], cells[..., 0], cells[..., 1]] > 0
        self.hit_obstacle |= inside & self.active

    def _record_arrivals(self) -> None:
        goal_distance_m = np.linalg.norm(self.goal_ne_m - self.true_pos_m[..., :2], axis=-1)
        arriving = self.active & (goal_distance_m < GOAL_RADIUS_M)
        self.arrived |= arriving
        self.arrived_s[arriving] = self.t_s
        self.active &= ~arriving

    def attainable_velocity_mps(self, heading_rad: Floats, speed_mps: Floats) -> Floats:
        """Return ground velocity (E, N, 3), limited by airspeed, with return to flight height."""
        ground = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=-1)
        wind = self.wind_ne_mps[:, None]
        tailwind = (ground * wind).sum(-1)
        across = np.linalg.norm(wind - tailwind[..., None] * ground, axis=-1)
        most = tailwind + np.sqrt(np.maximum(MAX_AIRSPEED_MPS**2 - across**2, 0.0))
        speed = np.clip(speed_mps, 0.0, np.minimum(most, MAX_SPEED_MPS))
        down = np.clip(-0.5 * self.pos_m[..., 2:], -2.0, 2.0)
        return np.concatenate([speed[..., None] * ground, down], axis=-1)

    def goal_bearing_rad_and_distance_m(self) -> tuple[Floats, Floats]:
        """Return bearing and distance of each agent's goal."""
        away = self.goal_ne_m - self.pos_m[..., :2]
        return np.arctan2(away[..., 1], away[..., 0]), np.linalg.norm(away, axis=-1)
