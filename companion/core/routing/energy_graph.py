"""The directed waypoint graph whose edges cost energy that depends on wind and payload.

Edges are sorted by (tail, head), so that the out-edges of a vertex are one slice and ties fall to
the lowest head.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.arrays import Floats, Ints
from companion.core.vehicle.wind_triangle import ground_speeds_mps

WH_PER_J = 1.0 / 3600.0
LEAST_SHARE = 0.25


@dataclass(frozen=True)
class EnergyGraph:
    """Waypoints, directed edges, depot and target, and what flying an edge takes.

    Shapes: vertices_m (V, 3) east, north, up; tail and head (E,); power_w is (loaded, empty).
    """

    vertices_m: Floats
    tail: Ints
    head: Ints
    depot: int
    target: int
    airspeed_mps: float
    power_w: tuple[float, float]
    wind_factor: Floats | None = None
    """What obstacles make of the wind on each edge: factors on its speed for D equal sectors of
    where it blows to, the first centred on east; shape (E, D). None: open ground."""
    turning_s: Floats | None = None
    """What turning into each edge is counted to cost, seconds; less than 0 where corners are cut;
    shape (E,). None: nothing. An edge never takes less than `LEAST_SHARE` of its length's time."""

    @property
    def vertex_count(self) -> int:
        return len(self.vertices_m)

    @property
    def edge_count(self) -> int:
        return len(self.tail)

    @cached_property
    def out_start(self) -> Ints:
        """Out-edges of vertex v are out_start[v] to out_start[v + 1] - 1; shape (V + 1,)."""
        return np.searchsorted(self.tail, np.arange(self.vertex_count + 1))

    @cached_property
    def out_edges(self) -> Ints:
        """Out-edges of each vertex, padded with -1; shape (V, largest out-degree, at least 1)."""
        degree = np.diff(self.out_start)
        width = max(1, int(degree.max(initial=0)))
        slots = np.arange(width)
        return np.where(slots < degree[:, None], self.out_start[:-1, None] + slots, -1)

    @cached_property
    def length_m(self) -> Floats:
        """3-D length of each edge; shape (E,)."""
        return np.sqrt(np.sum(self._span_m**2, axis=1))

    @cached_property
    def course_en(self) -> Floats:
        """Horizontal unit vector of each edge, zero for a vertical one; shape (E, 2)."""
        across = np.hypot(self._span_m[:, 0], self._span_m[:, 1])
        return self._span_m[:, :2] / np.where(across > 0.0, across, 1.0)[:, None]

    @cached_property
    def _span_m(self) -> Floats:
        return self.vertices_m[self.head] - self.vertices_m[self.tail]

    def ground_speed_mps(self, wind_en_mps: ArrayLike) -> Floats:
        """Ground speed on every edge in each wind, NaN where infeasible; shape (E, *winds).

        `wind_en_mps` has shape (*winds, 2). Paper III-A: V_G = sqrt(V_A^2 - W_perp^2) + W_par,
        infeasible where |W_perp| > V_A or V_G <= 0. A vertical edge has all wind across it.
        """
        wind = np.asarray(wind_en_mps, dtype=float)
        factor = None
        if self.wind_factor is not None:
            factor = self.wind_factor[:, sector_of(wind, self.wind_factor.shape[1]).reshape(-1)]
        return along_course_mps(self.course_en, wind, self.airspeed_mps, factor)

    def duration_s(self, wind_en_mps: ArrayLike) -> Floats:
        """Seconds that each edge takes in each wind, infinite where infeasible; (E, *winds).

        An edge of no length takes no time in any wind.
        """
        speed = self.ground_speed_mps(wind_en_mps)
        length = self.length_m.reshape(-1, *(1,) * (speed.ndim - 1))
        duration = length / np.where(np.isnan(speed), 1.0, speed)
        if self.turning_s is not None:
            turning = self.turning_s.reshape(length.shape)
            duration = np.maximum(duration + turning, LEAST_SHARE * duration)
        return np.where((length > 0.0) & np.isnan(speed), np.inf, duration)

    def energy_wh(self, wind_en_mps: ArrayLike, delivered: bool) -> Floats:
        """`EnergyCost(e, w)`: Wh of each edge in each wind, infinite where infeasible."""
        return self.duration_s(wind_en_mps) * (self.power_w[int(delivered)] * WH_PER_J)

    def energy_gradient_wh_per_mps(self, wind_en_mps: ArrayLike, delivered: bool) -> Floats:
        """dE/dw of each edge at one wind (2,); zero where infeasible; shape (E, 2).

        E = P L / V_G, so dE/dw = -E / V_G (u + dV_A,par/dw); V_A,par = sqrt(V_A^2 - W_perp^2).
        """
        wind = np.asarray(wind_en_mps, dtype=float)
        speed = self.ground_speed_mps(wind)
        across = -self.course_en[:, 1] * wind[0] + self.course_en[:, 0] * wind[1]
        normal = np.stack([-self.course_en[:, 1], self.course_en[:, 0]], axis=1)
        head = np.sqrt(np.maximum(self.airspeed_mps**2 - across**2, 1e-12))
        slope = self.course_en - (across / head)[:, None] * normal
        energy = self.energy_wh(wind, delivered)
        usable = np.isfinite(energy) & ~np.isnan(speed)
        rate = np.where(usable, -energy, 0.0) / np.where(usable, speed, 1.0)
        return rate[:, None] * slope

    def wind_length_m(self, wind_en_mps: ArrayLike) -> Floats:
        """`L_wind = max(0, E(w) / E(calm) - 1) L_geo`; infinite where infeasible; (E, *winds)."""
        duration = self.duration_s(wind_en_mps)
        length = self.length_m.reshape(-1, *(1,) * (duration.ndim - 1))
        return np.maximum(0.0, duration * self.airspeed_mps - length)

    def synthetic_length_m(self, wind_en_mps: ArrayLike, risk_weight: float) -> Floats:
        """The paper's `L_SE = L_geo + lambda L_wind`; shape (E, *winds)."""
        excess = self.wind_length_m(wind_en_mps)
        length = self.length_m.reshape(-1, *(1,) * (excess.ndim - 1))
        return length + (risk_weight * excess if risk_weight > 0.0 else 0.0)

    def route_energy_std_wh(
        self, edges: ArrayLike, wind_en_mps: ArrayLike, cov_m2ps2: ArrayLike, delivered: ArrayLike
    ) -> float:
        """Std of a route's energy when ONE wind error moves every leg: |sum_e dE_e/dw|_Sigma.

        `delivered` says for each edge of the route whether it is flown empty.
        """
        edges = np.asarray(edges, dtype=int)
        empty = np.broadcast_to(np.asarray(delivered, dtype=bool), edges.shape)
        by_load = [self.energy_gradient_wh_per_mps(wind_en_mps, load) for load in (False, True)]
        total = np.where(empty[:, None], by_load[1][edges], by_load[0][edges]).sum(axis=0)
        return float(np.sqrt(total @ np.asarray(cov_m2ps2, dtype=float) @ total))


def sector_of(wind_en_mps: Floats, sectors: int) -> Ints:
    """Which of `sectors` equal sectors each wind blows to, the first centred on east; (...)."""
    turn = np.arctan2(wind_en_mps[..., 1], wind_en_mps[..., 0]) / (2.0 * np.pi)
    return np.floor(turn * sectors + 0.5).astype(np.int64) % sectors


def along_course_mps(
    course_en: Floats, wind: Floats, airspeed_mps: float, factor: Floats | None = None
) -> Floats:
    """Ground speed along each course (E, 2) in each wind (*winds, 2); NaN where infeasible.

    `factor` (E, winds) scales each wind on each course.
    """
    flat = wind.reshape(-1, 2).T
    along = course_en @ flat
    calm_or_vertical = np.all(course_en == 0.0, axis=1)
    normal = np.stack([-course_en[:, 1], course_en[:, 0]], axis=1)
    across = normal @ flat
    across[calm_or_vertical] = np.hypot(flat[0], flat[1])
    if factor is not None:
        along, across = along * factor, across * factor
    speed = ground_speeds_mps(airspeed_mps, along, across)
    return speed.reshape(len(course_en), *wind.shape[:-1])


@dataclass(frozen=True)
class Pruned:
    """A graph without the edges that no mission can use; `edge_of`: places in the whole."""

    graph: EnergyGraph
    edge_of: Ints


def prune(graph: EnergyGraph, energy_wh: Floats, budget_wh: float) -> Pruned:
    """Leave out edges from which, at the least energy of any wind, no mission could still end well.

    `energy_wh` (2, E, S) loaded and empty. The policy from the depot is the same without them.
    """
    loaded, empty = energy_wh.min(axis=2)
    away = least_energy_wh(graph, loaded, graph.depot, to_goal=False)
    turn = least_energy_wh(graph, loaded, graph.depot, to_goal=True)
    deliver = least_energy_wh(graph, loaded, graph.target, to_goal=True)
    home = least_energy_wh(graph, empty, graph.depot, to_goal=True)
    beyond = least_energy_wh(graph, empty, graph.target, to_goal=False)
    onward = np.minimum(turn, deliver + home[graph.target])
    out = away[graph.tail] + loaded + onward[graph.head]
    back = away[graph.target] + beyond[graph.tail] + empty + home[graph.head]
    kept = np.flatnonzero(np.minimum(out, back) <= budget_wh)
    kept = kept if len(kept) else np.arange(1)  # arrays of nothing serve nobody
    factor = None if graph.wind_factor is None else graph.wind_factor[kept]
    turning = None if graph.turning_s is None else graph.turning_s[kept]
    left = replace(
        graph,
        tail=graph.tail[kept],
        head=graph.head[kept],
        wind_factor=factor,
        turning_s=turning,
    )
    return Pruned(left, kept)


def least_energy_wh(graph: EnergyGraph, edge_wh: Floats, place: int, to_goal: bool) -> Floats:
    """Least energy from every vertex to `place`, or from it to every vertex; (V,)."""
    ends = (graph.tail, graph.head) if to_goal else (graph.head, graph.tail)
    least = np.full(graph.vertex_count, np.inf)
    least[place] = 0.0
    for _ in range(graph.vertex_count):
        through = edge_wh + least[ends[1]]
        following = least.copy()
        np.minimum.at(following, ends[0], through)
        if np.array_equal(following, least):
            break
        least = following
    return least
