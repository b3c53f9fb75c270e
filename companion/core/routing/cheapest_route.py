"""Cheapest route between two knots, by a search that skips most obstacles of a town."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.shortest_paths import RouteFinder, path_vertices_in_first_problem
from companion.core.routing.waypoint_graph import SightLines, WaypointGraph

_COURSES = 360
_BOUND_SHARE = 0.995  # a course between two of `_COURSES` costs at least this share of both
_INITIAL_LIMIT_RATIO = 1.02  # first cost limit of the search, relative to the lower bound
_LIMIT_INCREASE = 2.0  # growth of the limit where the search finds no route


@dataclass(frozen=True, slots=True)
class SurrogateCost:
    """Surrogate cost `c = EnergyCost + lambda Unc` (arXiv 2604.13441, IV-B) of level cruise from
    the airframe's energy model, under one wind estimate.
    """

    route_energy: RouteEnergy
    payload_kg: float
    wind_to_ne_mps: Floats
    cov_ne_m2ps2: Floats
    risk_weight: float

    def level_line_cost_wh(self, course_rad: Floats, length_m: Floats) -> Floats:
        """Return the cost of each line (E,), proportional to length; infinite if infeasible."""
        model, wind, cov = self.route_energy, self.wind_to_ne_mps, self.cov_ne_m2ps2
        leg_batch = model.build_level_cruise_batch(course_rad, length_m, self.payload_kg)
        costs = model.leg_costs_wind_major(leg_batch, wind[None, :])
        gradient = model.leg_energy_gradients_wh_per_mps(leg_batch, wind)
        variance = np.einsum("ei,ij,ej->e", gradient, cov, gradient)
        energy = np.where(costs.feasible[0], costs.energy_wh[0], np.inf)
        return energy + self.risk_weight * np.sqrt(np.maximum(variance, 0.0))

    def route_cost_lower_bound_wh(self, displacement_ne_m: Floats) -> Floats:
        """Return a lower bound on the cost of any route over the displacements (n, 2).

        Progress of a route in one direction costs at least as much as on the course that makes
        it most cheaply. The bound is the maximum over all directions.
        """
        courses: Floats = np.linspace(0.0, 2.0 * np.pi, _COURSES, endpoint=False)
        per_m = self.level_line_cost_wh(courses, np.ones(_COURSES))
        progress = np.cos(courses[:, None] - courses[None, :])
        forward = progress > 1e-6
        rate = np.min(
            np.where(forward, per_m[None, :] / np.where(forward, progress, 1.0), np.inf), 1
        )
        progress_m = displacement_ne_m @ np.stack([np.cos(courses), np.sin(courses)])
        is_forward = progress_m > 0.0
        cost = np.where(is_forward, np.where(is_forward, progress_m, 1.0) * rate, 0.0)
        return _BOUND_SHARE * cost.max(axis=1)


def find_cheapest_route(
    sight_lines: SightLines, surrogate: SurrogateCost, start_knot: int, goal_knot: int
) -> list[Ned] | None:
    """Return the corners of the cheapest route from one knot to another; None without a route.

    Excludes each knot whose lower bound exceeds the cost of a known route, so the result is that
    of the whole graph.
    """
    if start_knot == goal_knot:
        return [sight_lines.knot_ned_m(start_knot)]
    knots = sight_lines.knots_ned_m[:, :2]
    least_wh = surrogate.route_cost_lower_bound_wh(
        knots - knots[start_knot]
    ) + surrogate.route_cost_lower_bound_wh(knots[goal_knot] - knots)
    limit_wh = _INITIAL_LIMIT_RATIO * float(least_wh[goal_knot])
    while True:
        knot_indices = np.flatnonzero(least_wh <= limit_wh)
        whole = not math.isfinite(limit_wh) or len(knot_indices) == len(knots)
        graph = sight_lines.cached_visibility_graph(None if whole else knot_indices)
        path, cost_wh = _find_cheapest_path_and_cost_wh(graph, surrogate, start_knot, goal_knot)
        if whole or cost_wh <= limit_wh:
            return None if path is None else [sight_lines.knot_ned_m(v) for v in path]
        limit_wh = cost_wh if path is not None else _LIMIT_INCREASE * limit_wh


def _find_cheapest_path_and_cost_wh(
    graph: WaypointGraph, surrogate: SurrogateCost, start_vertex: int, goal_vertex: int
) -> tuple[list[int] | None, float]:
    """Return the vertices of the cheapest route and its cost; None and infinity without one."""
    if not len(graph.tail):
        return None, math.inf
    planned = graph.to_energy_graph(surrogate.route_energy, surrogate.payload_kg)
    costs = surrogate.level_line_cost_wh(graph.edge_courses_rad(), graph.edge_lengths_m())
    routes = RouteFinder(planned).find_routes_to_goal(goal_vertex, costs[:, None])
    path = path_vertices_in_first_problem(planned, routes, start_vertex)
    return path, math.inf if path is None else float(routes.cost_wh[start_vertex, 0])
