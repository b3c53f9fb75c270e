"""The cheapest way between two places in sight lines, without looking at most of a town."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.shortest_paths import RouteFinder, path_to
from companion.core.routing.waypoint_graph import SightLines, WaypointGraph

_COURSES = 360
_BOUND_SHARE = 0.995  # what the cheapest course between two of `_COURSES` can be below both
_FIRST_LOOK = 1.02  # of the least that any way can cost: where the search looks first
_WIDER = 2.0  # and by how much further where there is no way


@dataclass(frozen=True, slots=True)
class Surrogate:
    """`c = EnergyCost + lambda Unc` (arXiv 2604.13441, IV-B) of level cruise, by the airframe's own
    energy model, under one wind belief.
    """

    route_energy: RouteEnergy
    payload_kg: float
    wind_to_ne_mps: Floats
    cov_ne_m2ps2: Floats
    risk_weight: float

    def wh(self, course_rad: Floats, length_m: Floats) -> Floats:
        """Cost of each line (E,), infinite where infeasible; it is proportional to the length."""
        model, wind, cov = self.route_energy, self.wind_to_ne_mps, self.cov_ne_m2ps2
        legs = model.compile_level(course_rad, length_m, self.payload_kg)
        costs = model.costs(legs, wind[None, :])
        gradient = model.gradient_wh_per_mps(legs, wind)
        variance = np.einsum("ei,ij,ej->e", gradient, cov, gradient)
        energy = np.where(costs.feasible[0], costs.energy_wh[0], np.inf)
        return energy + self.risk_weight * np.sqrt(np.maximum(variance, 0.0))

    def least_wh(self, between_ne_m: Floats) -> Floats:
        """Bound from below on the cost of any way from one point to another; steps (n, 2).

        A way's progress along a direction costs at least what the course that makes it most
        cheaply takes for it; the largest of these over all directions.
        """
        courses: Floats = np.linspace(0.0, 2.0 * np.pi, _COURSES, endpoint=False)
        per_m = self.wh(courses, np.ones(_COURSES))
        progress = np.cos(courses[:, None] - courses[None, :])
        forward = progress > 1e-6
        rate = np.min(
            np.where(forward, per_m[None, :] / np.where(forward, progress, 1.0), np.inf), 1
        )
        made_m = between_ne_m @ np.stack([np.cos(courses), np.sin(courses)])
        ahead = made_m > 0.0
        cost = np.where(ahead, np.where(ahead, made_m, 1.0) * rate, 0.0)
        return _BOUND_SHARE * cost.max(axis=1)


def cheapest_way(
    lines: SightLines, surrogate: Surrogate, start: int, goal: int
) -> list[Ned] | None:
    """Corners of the cheapest way from one knot to another; None where there is none.

    A knot by which no way can be as cheap as one that is known is left out: the way is that of the
    whole graph.
    """
    if start == goal:
        return [lines.point(start)]
    knots = lines.knots_ned_m[:, :2]
    least_wh = surrogate.least_wh(knots - knots[start]) + surrogate.least_wh(knots[goal] - knots)
    limit_wh = _FIRST_LOOK * float(least_wh[goal])
    while True:
        among = np.flatnonzero(least_wh <= limit_wh)
        whole = not math.isfinite(limit_wh) or len(among) == len(knots)
        graph = lines.graph(None if whole else among)
        path, cost_wh = _path(graph, surrogate, start, goal)
        if whole or cost_wh <= limit_wh:
            return None if path is None else [lines.point(v) for v in path]
        limit_wh = cost_wh if path is not None else _WIDER * limit_wh


def _path(
    graph: WaypointGraph, surrogate: Surrogate, start: int, goal: int
) -> tuple[list[int] | None, float]:
    """Vertices of the cheapest way and its cost; None and infinity where there is none."""
    if not len(graph.tail):
        return None, math.inf
    planned = graph.energy_graph(surrogate.route_energy, surrogate.payload_kg)
    costs = surrogate.wh(graph.course_rad(), graph.length_m())
    routes = RouteFinder(planned).to(goal, costs[:, None])
    path = path_to(planned, routes, start)
    return path, math.inf if path is None else float(routes.cost_wh[start, 0])
