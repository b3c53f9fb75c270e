"""Directed waypoint graph with edge energies that depend on wind and payload.

Edges are sorted by (tail, head), so that the out-edges of a vertex are one slice and ties resolve
to the lowest head.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.arrays import Floats, Ints
from companion.core.vehicle.wind_triangle import ground_speeds_mps

WH_PER_J = 1.0 / 3600.0
MIN_DURATION_FRAC = 0.25


@dataclass(frozen=True)
class EnergyGraph:
    """Waypoints, directed edges, depot and target, with speed and power for the edges.

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
    """Factor of obstacles on the wind speed at each edge, for D equal sectors of the direction that
    the wind blows to, the first centred on east; shape (E, D). None: open ground."""
    turn_s: Floats | None = None
    """Time added for the turn into each edge, negative where corners are cut; shape (E,). None: 0.
    The duration of an edge is at least `MIN_DURATION_FRAC` of that of its length."""

    @property
    def vertex_count(self) -> int:
        return len(self.vertices_m)

    @property
    def edge_count(self) -> int:
        return len(self.tail)

    @cached_property
    def out_edge_start_by_vertex(self) -> Ints:
        """Out-edges of vertex v are out_start[v] to out_start[v + 1] - 1; shape (V + 1,)."""
        return np.searchsorted(self.tail, np.arange(self.vertex_count + 1))

    @cached_property
    def out_edges_by_vertex(self) -> Ints:
        """Out-edges of each vertex, padded with -1; shape (V, largest out-degree, at least 1)."""
        edge_counts = np.diff(self.out_edge_start_by_vertex)
        width = max(1, int(edge_counts.max(initial=0)))
        slots = np.arange(width)
        return np.where(
            slots < edge_counts[:, None], self.out_edge_start_by_vertex[:-1, None] + slots, -1
        )

    @cached_property
    def edge_length_m(self) -> Floats:
        """3-D length of each edge; shape (E,)."""
        return np.sqrt(np.sum(self._edge_displacement_enu_m**2, axis=1))

    @cached_property
    def edge_course_unit_vector_en(self) -> Floats:
        """Horizontal unit vector of each edge, zero for a vertical one; shape (E, 2)."""
        across = np.hypot(self._edge_displacement_enu_m[:, 0], self._edge_displacement_enu_m[:, 1])
        return self._edge_displacement_enu_m[:, :2] / np.where(across > 0.0, across, 1.0)[:, None]

    @cached_property
    def _edge_displacement_enu_m(self) -> Floats:
        return self.vertices_m[self.head] - self.vertices_m[self.tail]

    def edge_ground_speed_mps(self, wind_en_mps: ArrayLike) -> Floats:
        """Return ground speed on every edge in each wind, NaN if infeasible; shape (E, *winds).

        `wind_en_mps` has shape (*winds, 2). Paper III-A: V_G = sqrt(V_A^2 - W_perp^2) + W_par,
        infeasible where |W_perp| > V_A or V_G <= 0. A vertical edge has all wind across it.
        """
        wind = np.asarray(wind_en_mps, dtype=float)
        factor = None
        if self.wind_factor is not None:
            factor = self.wind_factor[
                :, wind_sector_indices(wind, self.wind_factor.shape[1]).reshape(-1)
            ]
        return course_ground_speeds_mps(
            self.edge_course_unit_vector_en, wind, self.airspeed_mps, factor
        )

    def edge_duration_s(self, wind_en_mps: ArrayLike) -> Floats:
        """Return the duration of each edge in each wind, infinite if infeasible; (E, *winds).

        An edge of length 0 takes 0 s in any wind.
        """
        speed = self.edge_ground_speed_mps(wind_en_mps)
        length = self.edge_length_m.reshape(-1, *(1,) * (speed.ndim - 1))
        duration = length / np.where(np.isnan(speed), 1.0, speed)
        if self.turn_s is not None:
            turn_s = self.turn_s.reshape(length.shape)
            duration = np.maximum(duration + turn_s, MIN_DURATION_FRAC * duration)
        return np.where((length > 0.0) & np.isnan(speed), np.inf, duration)

    def edge_energy_wh(self, wind_en_mps: ArrayLike, delivered: bool) -> Floats:
        """Return `EnergyCost(e, w)` of each edge in each wind, infinite if infeasible."""
        return self.edge_duration_s(wind_en_mps) * (self.power_w[int(delivered)] * WH_PER_J)

    def edge_energy_gradient_wh_per_mps(self, wind_en_mps: ArrayLike, delivered: bool) -> Floats:
        """Return dE/dw of each edge at one wind (2,); zero if infeasible; shape (E, 2).

        E = P L / V_G, so dE/dw = -E / V_G (u + dV_A,par/dw); V_A,par = sqrt(V_A^2 - W_perp^2).
        """
        wind = np.asarray(wind_en_mps, dtype=float)
        speed = self.edge_ground_speed_mps(wind)
        across = (
            -self.edge_course_unit_vector_en[:, 1] * wind[0]
            + self.edge_course_unit_vector_en[:, 0] * wind[1]
        )
        normal = np.stack(
            [-self.edge_course_unit_vector_en[:, 1], self.edge_course_unit_vector_en[:, 0]], axis=1
        )
        head = np.sqrt(np.maximum(self.airspeed_mps**2 - across**2, 1e-12))
        slope = self.edge_course_unit_vector_en - (across / head)[:, None] * normal
        energy = self.edge_energy_wh(wind, delivered)
        usable = np.isfinite(energy) & ~np.isnan(speed)
        rate = np.where(usable, -energy, 0.0) / np.where(usable, speed, 1.0)
        return rate[:, None] * slope

    def edge_excess_length_from_wind_m(self, wind_en_mps: ArrayLike) -> Floats:
        """Return `L_wind = max(0, E(w) / E(calm) - 1) L_geo`, inf if infeasible; (E, *winds)."""
        duration = self.edge_duration_s(wind_en_mps)
        length = self.edge_length_m.reshape(-1, *(1,) * (duration.ndim - 1))
        return np.maximum(0.0, duration * self.airspeed_mps - length)

    def edge_synthetic_length_m(self, wind_en_mps: ArrayLike, risk_weight: float) -> Floats:
        """Return the paper's `L_SE = L_geo + lambda L_wind`; shape (E, *winds)."""
        excess = self.edge_excess_length_from_wind_m(wind_en_mps)
        length = self.edge_length_m.reshape(-1, *(1,) * (excess.ndim - 1))
        return length + (risk_weight * excess if risk_weight > 0.0 else 0.0)

    def route_energy_std_wh(
        self,
        route_edge_indices: ArrayLike,
        wind_en_mps: ArrayLike,
        wind_cov_en_m2ps2: ArrayLike,
        delivered_by_edge: ArrayLike,
    ) -> float:
        """Return std of a route's energy if ONE wind error affects all legs: |sum_e dE_e/dw|_Sigma.

        `delivered_by_edge` is true for each edge of the route that is flown empty.
        """
        route_edge_indices = np.asarray(route_edge_indices, dtype=int)
        empty = np.broadcast_to(np.asarray(delivered_by_edge, dtype=bool), route_edge_indices.shape)
        by_load = [
            self.edge_energy_gradient_wh_per_mps(wind_en_mps, load) for load in (False, True)
        ]
        total = np.where(
            empty[:, None], by_load[1][route_edge_indices], by_load[0][route_edge_indices]
        ).sum(axis=0)
        return float(np.sqrt(total @ np.asarray(wind_cov_en_m2ps2, dtype=float) @ total))


def wind_sector_indices(wind_en_mps: Floats, sector_count: int) -> Ints:
    """Return the index of the sector each wind blows to, the first centred on east; (...)."""
    turn = np.arctan2(wind_en_mps[..., 1], wind_en_mps[..., 0]) / (2.0 * np.pi)
    return np.floor(turn * sector_count + 0.5).astype(np.int64) % sector_count


def course_ground_speeds_mps(
    course_en: Floats,
    wind_en_mps: Floats,
    airspeed_mps: float,
    wind_speed_factor: Floats | None = None,
) -> Floats:
    """Return ground speed on each course (E, 2) in each wind (*winds, 2); NaN if infeasible.

    `wind_speed_factor` (E, winds) scales each wind on each course.
    """
    flat = wind_en_mps.reshape(-1, 2).T
    tailwind = course_en @ flat
    calm_or_vertical = np.all(course_en == 0.0, axis=1)
    normal = np.stack([-course_en[:, 1], course_en[:, 0]], axis=1)
    across = normal @ flat
    across[calm_or_vertical] = np.hypot(flat[0], flat[1])
    if wind_speed_factor is not None:
        tailwind, across = tailwind * wind_speed_factor, across * wind_speed_factor
    speed = ground_speeds_mps(airspeed_mps, tailwind, across)
    return speed.reshape(len(course_en), *wind_en_mps.shape[:-1])


@dataclass(frozen=True)
class PrunedGraph:
    """Graph without the edges that no mission can use; `original_edge`: their indices before
    pruning.
    """

    graph: EnergyGraph
    original_edge: Ints


def prune_edges_unusable_within_budget(
    graph: EnergyGraph, edge_energy_wh_by_load_and_wind: Floats, budget_wh: float
) -> PrunedGraph:
    """Remove edges that no mission within the budget can use, at the least energy of all winds.

    `edge_energy_wh_by_load_and_wind` is (2, E, S), loaded and empty. The policy from the depot does
    not change.
    """
    loaded, empty = edge_energy_wh_by_load_and_wind.min(axis=2)
    away = least_energy_to_or_from_vertex_wh(graph, loaded, graph.depot, to_vertex=False)
    turn = least_energy_to_or_from_vertex_wh(graph, loaded, graph.depot, to_vertex=True)
    deliver = least_energy_to_or_from_vertex_wh(graph, loaded, graph.target, to_vertex=True)
    home = least_energy_to_or_from_vertex_wh(graph, empty, graph.depot, to_vertex=True)
    from_target = least_energy_to_or_from_vertex_wh(graph, empty, graph.target, to_vertex=False)
    onward = np.minimum(turn, deliver + home[graph.target])
    out = away[graph.tail] + loaded + onward[graph.head]
    back = away[graph.target] + from_target[graph.tail] + empty + home[graph.head]
    kept = np.flatnonzero(np.minimum(out, back) <= budget_wh)
    kept = kept if len(kept) else np.arange(1)  # keep one edge: empty arrays fail later
    factor = None if graph.wind_factor is None else graph.wind_factor[kept]
    turn_s = None if graph.turn_s is None else graph.turn_s[kept]
    left = replace(
        graph,
        tail=graph.tail[kept],
        head=graph.head[kept],
        wind_factor=factor,
        turn_s=turn_s,
    )
    return PrunedGraph(left, kept)


def least_energy_to_or_from_vertex_wh(
    graph: EnergyGraph, edge_energy_wh: Floats, vertex: int, to_vertex: bool
) -> Floats:
    """Return the least energy from every vertex to `vertex`, or from it to every vertex; (V,)."""
    ends = (graph.tail, graph.head) if to_vertex else (graph.head, graph.tail)
    least = np.full(graph.vertex_count, np.inf)
    least[vertex] = 0.0
    for _ in range(graph.vertex_count):
        candidate = edge_energy_wh + least[ends[1]]
        updated = least.copy()
        np.minimum.at(updated, ends[0], candidate)
        if np.array_equal(updated, least):
            break
        least = updated
    return least
