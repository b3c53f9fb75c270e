"""Many episodes of drones over a town at once: the world of policies and trainer.

As in arXiv 2604.13441, IV-B, there is a decision every 2 s. Between decisions a low-level
controller with limited acceleration runs at 5 Hz. The true motion is the commanded one plus gusts;
neighbours are known 200 ms late and 2 m off (docs/reference/benchmarks.md). Arrays are (episodes,
agents, ...), north, east, down about the middle of the town; the flight height is 0.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bools, Floats
from companion.core.separation.separation_filter import SeparationFilter
from companion.core.separation.stopping_paths import Neighbours, SeparationParams
from sim_bridge.research.avoidance.scenes import HALF_SIDE_M, Scene, Start, cells_of, draw_start

DECISION_S = 2.0
TICK_S = 0.2
TICKS = round(DECISION_S / TICK_S)
INSTANTS = 4  # looked at in a tick by the judge of separation
GOAL_M = 20.0
MAX_SPEED_MPS = 15.0
MAX_AIRSPEED_MPS = 19.0
LATE_TICKS = 1  # 200 ms
REPORT_STD_M = 2.0
REPORT_VERTICAL_STD_M = 0.5
REPORT_S = 30.0  # GNSS errors wander slowly, so averaging does not help
VELOCITY_STD_MPS = 0.1
GUST_M = 0.15  # how far gusts push a vehicle off what it was told, each axis
GUST_S = 3.0
WIND_MAX_MPS = 8.0
LAYER_M = 8.0  # between the layers that the filter dodges to
LAYERS = np.array([-1.0, 1.0, 0.0, -2.0, 2.0])


@dataclass
class AvoidanceWorld:
    """Episodes in step with each other; `reset` draws them, `tick` flies 0.2 s."""

    scenes: list[Scene]
    agents: int
    wind: bool = True
    params: SeparationParams = field(default_factory=SeparationParams)

    def reset(self, seeds: list[int]) -> None:
        """Episode e follows from seeds[e] alone: scene, starts, goals, wind, every error."""
        self.random = [np.random.default_rng([20240, seed]) for seed in seeds]
        self.scene_of = np.array([int(r.integers(len(self.scenes))) for r in self.random])
        drawn = [
            draw_start(self.scenes[s], self.agents, r)
            for s, r in zip(self.scene_of, self.random, strict=True)
        ]
        count = len(seeds)
        self._lay_out(drawn)
        speed = np.array([r.uniform(0.0, WIND_MAX_MPS) for r in self.random]) * self.wind
        angle = np.array([r.uniform(0.0, 2.0 * np.pi) for r in self.random])
        self.wind_ne_mps = speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.report_error_m = self._noise() * [REPORT_STD_M, REPORT_STD_M, REPORT_VERTICAL_STD_M]
        self.gust_m = np.zeros((count, self.agents, 3))
        self.t_s = 0.0
        self.published = [(self.pos_m.copy(), self.vel_mps.copy())] * (LATE_TICKS + 1)
        self.apart = np.full((count, self.agents), np.inf)  # least, in cylinders, by truth

    def _lay_out(self, drawn: list[Start]) -> None:
        flat = np.stack([d.start_ne_m for d in drawn])
        self.pos_m = np.concatenate([flat, np.zeros_like(flat[..., :1])], axis=-1)
        self.start_m = self.pos_m.copy()
        self.vel_mps = np.zeros_like(self.pos_m)
        self.goal_ne_m = np.stack([d.goal_ne_m for d in drawn])
        self.returning = np.stack([d.returning for d in drawn])
        self.truck_ne_m = np.stack([self.scenes[s].truck_ne_m for s in self.scene_of])
        self.active = np.ones(flat.shape[:2], dtype=bool)
        self.arrived = np.zeros(flat.shape[:2], dtype=bool)
        self.hit_drone, self.hit_building = self.arrived.copy(), self.arrived.copy()
        self.arrived_s = np.full(flat.shape[:2], np.nan)
        self.layer_down_m = np.broadcast_to(
            LAYER_M * LAYERS[np.arange(self.agents) % len(LAYERS)], flat.shape[:2]
        )
        others = [[j for j in range(self.agents) if j != i] for i in range(self.agents)]
        self.others = np.array(others, dtype=np.int64).reshape(self.agents, self.agents - 1)
        self.clearance_rasters = np.stack([s.clearance_m for s in self.scenes])
        self.obstacle_rasters = np.stack([s.obstacle for s in self.scenes])

    def _noise(self) -> Floats:
        return np.stack([r.standard_normal((self.agents, 3)) for r in self.random])

    @property
    def true_pos_m(self) -> Floats:
        return self.pos_m + self.gust_m

    def reports(self) -> tuple[Floats, Floats]:
        """What every agent said of its position and velocity 200 ms ago; (E, N, 3) each."""
        pos, vel = self.published[0]
        return pos + self.report_error_m, vel

    def neighbours(self, rows: NDArray[np.int64]) -> Neighbours:
        """The reports as the filter of each agent (flat index) in `rows` hears them."""
        pos, vel = self.reports()
        e, i = np.divmod(rows, self.agents)
        j = self.others[i]
        shape = j.shape
        return Neighbours(
            pos[e[:, None], j],
            vel[e[:, None], j],
            np.full(shape, LATE_TICKS * TICK_S),
            np.full(shape, REPORT_STD_M),
            np.full(shape, REPORT_VERTICAL_STD_M),
            np.full(shape, VELOCITY_STD_MPS),
            self.active[e[:, None], j],
        )

    def clearance(self, points: Floats, agents: NDArray[np.int64]) -> Floats:
        """Metres from points (A, ..., 2 or 3) of these agents (flat) to the next building."""
        cells = cells_of(points[..., :2])
        scene = self.scene_of[agents // self.agents].reshape(-1, *[1] * (cells.ndim - 2))
        return self.clearance_rasters[scene, cells[..., 0], cells[..., 1]].astype(np.float64)

    def filtered(
        self,
        wanted_mps: Floats,
        separation: SeparationFilter,
        only: NDArray[np.int64] | None = None,
    ) -> tuple[Floats, Floats]:
        """Safe velocities (E, N, 3) and whose wish was not granted (E, N); of `only`, or of all."""
        rows = np.flatnonzero(self.active) if only is None else only
        found = separation.safe(
            self.pos_m.reshape(-1, 3)[rows],
            self.vel_mps.reshape(-1, 3)[rows],
            wanted_mps.reshape(-1, 3)[rows],
            self.neighbours(rows),
            self.layer_down_m.reshape(-1)[rows],
            lambda points, some: self.clearance(points, rows[some]),
        )
        safe = self.vel_mps.copy()
        safe.reshape(-1, 3)[rows] = found.vel_ned_mps
        refused = np.zeros(self.active.size)
        refused[rows] = found.verdict > 0
        return safe, refused.reshape(self.active.shape)

    def tick(self, velocity_mps: Floats) -> None:
        """Fly 0.2 s towards these velocities, as far as acceleration lets it, and judge."""
        new = self._attainable(velocity_mps)
        start, gust = self.pos_m, self.gust_m
        keep = np.exp(-TICK_S / GUST_S)
        self.gust_m = keep * gust + np.sqrt(1.0 - keep**2) * self._noise() * [GUST_M, GUST_M, 0.05]
        limits = [self.params.tracking_m / 1.5] * 2 + [self.params.tracking_vertical_m]
        self.gust_m = np.clip(self.gust_m, np.negative(limits), limits)
        for share in (np.arange(INSTANTS) + 1.0) / INSTANTS:
            moved = self.vel_mps * share + 0.5 * (new - self.vel_mps) * share**2
            self.pos_m = np.where(self.active[..., None], start + TICK_S * moved, start)
            self._judge(self.pos_m + gust + share * (self.gust_m - gust))
        self.vel_mps = np.where(self.active[..., None], new, 0.0)
        wander = np.exp(-TICK_S / REPORT_S)
        stds = np.array([REPORT_STD_M, REPORT_STD_M, REPORT_VERTICAL_STD_M])
        self.report_error_m = wander * self.report_error_m + (
            np.sqrt(1.0 - wander**2) * stds * self._noise()
        )
        self.published = [*self.published[1:], (self.true_pos_m, self.vel_mps.copy())]
        self.t_s += TICK_S
        self._arrivals()

    def _attainable(self, velocity_mps: Floats) -> Floats:
        p = self.params
        change = velocity_mps - self.vel_mps
        flat = np.linalg.norm(change[..., :2], axis=-1, keepdims=True)
        change[..., :2] *= np.minimum(1.0, p.accel_mps2 * TICK_S / np.maximum(flat, 1e-9))
        most = p.climb_accel_mps2 * TICK_S
        change[..., 2] = np.clip(change[..., 2], -most, most)
        return self.vel_mps + change

    def _judge(self, true_pos: Floats) -> None:
        away = true_pos[:, :, None] - true_pos[:, None]
        p = self.params
        apart = np.maximum(
            np.hypot(away[..., 0], away[..., 1]) / p.horizontal_m,
            np.abs(away[..., 2]) / p.vertical_m,
        )
        both = self.active[:, :, None] & self.active[:, None] & ~np.eye(self.agents, dtype=bool)
        least = np.where(both, apart, np.inf).min(axis=-1, initial=np.inf)
        self.apart = np.minimum(self.apart, least)
        self.hit_drone |= least < 1.0
        cells = cells_of(true_pos[..., :2])
        inside = self.obstacle_rasters[self.scene_of[:, None], cells[..., 0], cells[..., 1]] > 0
        self.hit_building |= inside & self.active

    def _arrivals(self) -> None:
        to_goal = np.linalg.norm(self.goal_ne_m - self.true_pos_m[..., :2], axis=-1)
        there = self.active & (to_goal < GOAL_M)
        self.arrived |= there
        self.arrived_s[there] = self.t_s
        self.active &= ~there

    def outside(self) -> Bools:
        return np.abs(self.pos_m[..., :2]).max(axis=-1) > HALF_SIDE_M + 60.0

    def velocity_of(self, heading_rad: Floats, speed_mps: Floats) -> Floats:
        """Ground velocity (E, N, 3), no faster than the airspeed allows, back to flight height."""
        ground = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=-1)
        wind = self.wind_ne_mps[:, None]
        along = (ground * wind).sum(-1)
        across = np.linalg.norm(wind - along[..., None] * ground, axis=-1)
        most = along + np.sqrt(np.maximum(MAX_AIRSPEED_MPS**2 - across**2, 0.0))
        speed = np.clip(speed_mps, 0.0, np.minimum(most, MAX_SPEED_MPS))
        down = np.clip(-0.5 * self.pos_m[..., 2:], -2.0, 2.0)
        return np.concatenate([speed[..., None] * ground, down], axis=-1)

    def to_goal(self) -> tuple[Floats, Floats]:
        """Bearing and distance of each agent's goal."""
        away = self.goal_ne_m - self.pos_m[..., :2]
        return np.arctan2(away[..., 1], away[..., 0]), np.linalg.norm(away, axis=-1)
