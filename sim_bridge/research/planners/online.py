"""Planning under the wind seen at a vertex, with a cache for winds that recur.

Shared by SER, RER, GER and the published BER. A chain has few different winds, so a result for
(vertex, wind seen) is stored. A recorded wind does not recur and is not stored.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import WH_PER_J, EnergyGraph
from companion.core.routing.planner_interface import PlannerObservation
from companion.core.routing.shortest_paths import RouteFinder
from sim_bridge.research.planners.uncertainty import RiskCost


@dataclass(frozen=True)
class Viewpoints:
    """Vertices and winds from which to plan; arrays of length n (wind (n, 2))."""

    origin: Ints
    seen: Ints
    wind_en_mps: Floats


@dataclass(frozen=True)
class ReplanningModel:
    """The graph, the surrogate cost and the number of winds in a chain's sight (0: a log)."""

    graph: EnergyGraph
    cost: RiskCost
    winds: int = 0

    @cached_property
    def finder(self) -> RouteFinder:
        """Routes on the graph."""
        return RouteFinder(self.graph)

    def surrogate_durations_and_columns(self, viewpoints: Viewpoints) -> tuple[Floats, Ints]:
        """Return surrogate durations (E, k) of the distinct problems, and each view's column."""
        key = viewpoints.seen if self.winds else np.arange(len(viewpoints.seen))
        if self.winds and self.cost.depends_on_origin():
            key = viewpoints.origin * self.winds + viewpoints.seen
        _, first, column = np.unique(key, return_index=True, return_inverse=True)
        duration = self.cost.surrogate_duration_s(
            viewpoints.origin[first], viewpoints.seen[first], viewpoints.wind_en_mps[first]
        )
        return duration, column.reshape(-1)

    def energy_wh(self, duration_s: Floats, delivered: bool) -> Floats:
        return duration_s * (self.finder.graph.power_w[int(delivered)] * WH_PER_J)


class PlanCache:
    """Cache of `solve` (views -> (n, entries)) by (vertex, wind seen) of a chain."""

    def __init__(
        self, model: ReplanningModel, entries: int, solve: Callable[[Viewpoints], NDArray]
    ) -> None:
        self._model, self._solve = model, solve
        cells = model.finder.graph.vertex_count * model.winds
        self._is_solved = np.zeros(cells, dtype=bool)
        self._values = np.zeros((cells, entries))

    def lookup_or_solve(self, observation: PlannerObservation, rows: Ints) -> NDArray:
        """Return the result of `solve` for the observations in `rows`; (len(rows), entries)."""
        viewpoints = Viewpoints(
            observation.vertex[rows], observation.wind_index[rows], observation.wind_en_mps[rows]
        )
        if not self._model.winds:
            return self._solve(viewpoints)
        cell = viewpoints.origin * self._model.winds + viewpoints.seen
        known = self._is_solved.take(cell)
        if not known.all():
            unsolved = self._distinct_unsolved_viewpoints(viewpoints, ~known)
            solved = unsolved.origin * self._model.winds + unsolved.seen
            self._values[solved] = self._solve(unsolved)
            self._is_solved[solved] = True
        return self._values.take(cell, axis=0)

    def _distinct_unsolved_viewpoints(
        self, viewpoints: Viewpoints, unknown: NDArray[np.bool_]
    ) -> Viewpoints:
        """Return each unknown view once; all vertices if the cost is independent of the origin."""
        winds = self._model.winds
        if self._model.cost.depends_on_origin():
            key = viewpoints.origin * winds + viewpoints.seen
            _, first = np.unique(key[unknown], return_index=True)
            rows = np.flatnonzero(unknown)[first]
            return Viewpoints(
                viewpoints.origin[rows], viewpoints.seen[rows], viewpoints.wind_en_mps[rows]
            )
        seen, first = np.unique(viewpoints.seen[unknown], return_index=True)
        wind = viewpoints.wind_en_mps[unknown][first]
        vertices = self._model.finder.graph.vertex_count
        return Viewpoints(
            origin=np.tile(np.arange(vertices), len(seen)),
            seen=np.repeat(seen, vertices),
            wind_en_mps=np.repeat(wind, vertices, axis=0),
        )


def first_edges_of_cheapest_routes(
    model: ReplanningModel, delivered: bool, viewpoints: Viewpoints
) -> NDArray:
    """Return the first edge of the cheapest route to the target, or after delivery to the depot."""
    graph = model.finder.graph
    duration, column = model.surrogate_durations_and_columns(viewpoints)
    goal = graph.depot if delivered else graph.target
    routes = model.finder.find_routes_to_goal(goal, model.energy_wh(duration, delivered))
    return routes.next_edge[viewpoints.origin, column][:, None]


def out_edge_costs(
    model: ReplanningModel, edge_wh: Floats, onward_wh: Floats, origin: Ints, column: Ints
) -> Floats:
    """Return the cost of each out-edge of `origin` (n,) plus the cost `onward_wh` (V, k) after it.

    Infinite where a vertex has no such edge; shape (n, W).
    """
    slots = model.finder.graph.out_edges_by_vertex[origin]
    head_vertices = model.finder.graph.head[slots]
    total = edge_wh[slots, column[:, None]] + onward_wh[head_vertices, column[:, None]]
    return np.where(slots >= 0, total, np.inf)
