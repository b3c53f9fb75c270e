"""Least-cost routes to a goal on the energy graph, for many winds at once or for one."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from companion.core.energy_graph import EnergyGraph
from companion.core.planners.interface import NOWHERE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# An edge that cannot be flown in the wind seen: planned over only where nothing else leads on.
INFEASIBLE_WH = 1e9
LEAST_WH = 1e-9  # an edge of no length still costs a little, so that routes end
FEW = 3  # problems up to which one Dijkstra each is faster than all in one sweep


@dataclass(frozen=True)
class Routes:
    """Cost from every vertex to the goal and the edge to take there; shapes (V, n)."""

    cost_wh: Floats
    next_edge: Ints


@dataclass(frozen=True)
class RouteFinder:
    """Plans on one graph; costs change from call to call and are written in place."""

    graph: EnergyGraph
    _reverse: csr_array = field(init=False, repr=False)
    _order: Ints = field(init=False, repr=False)

    def __post_init__(self) -> None:
        graph = self.graph
        order = np.lexsort((graph.tail, graph.head))
        pointer = np.searchsorted(graph.head[order], np.arange(graph.vertex_count + 1))
        reverse = csr_array(
            (np.ones(graph.edge_count), graph.tail[order], pointer),
            shape=(graph.vertex_count, graph.vertex_count),
        )
        object.__setattr__(self, "_reverse", reverse)
        object.__setattr__(self, "_order", order)

    def to(self, goal: int, cost_wh: Floats) -> Routes:
        """Routes from everywhere to `goal` for each column of `cost_wh` (E, n).

        Infinite costs count as INFEASIBLE_WH. Ties fall to the lowest head.
        """
        cost = np.clip(cost_wh, LEAST_WH, INFEASIBLE_WH)
        if cost.shape[1] <= FEW:
            total = np.stack([self._dijkstra(goal, column) for column in cost.T], axis=1)
        else:
            total = self._bellman_ford(goal, cost)
        return Routes(total, self._next_edge(cost + total[self.graph.head]))

    def _dijkstra(self, goal: int, cost_wh: Floats) -> Floats:
        self._reverse.data[:] = cost_wh[self._order]
        return dijkstra(self._reverse, indices=goal)

    def _bellman_ford(self, goal: int, cost_wh: Floats) -> Floats:
        graph = self.graph
        total = np.full((graph.vertex_count, cost_wh.shape[1]), np.inf)
        total[goal] = 0.0
        flown = np.flatnonzero(np.diff(graph.out_start) > 0)
        first = graph.out_start[flown]
        while True:
            best = np.minimum.reduceat(cost_wh + total[graph.head], first, axis=0)
            best[flown == goal] = 0.0
            if np.array_equal(best, total[flown]):
                return total
            total[flown] = best

    def _next_edge(self, through_wh: Floats) -> Ints:
        """The cheapest out-edge of each vertex given each edge's cost to the goal (E, n)."""
        slots = self.graph.out_edges
        costs = np.where(slots[..., None] >= 0, through_wh[slots], np.inf)
        place = np.argmin(costs, axis=1)
        best = np.take_along_axis(slots, place, axis=1)
        reachable = np.isfinite(np.min(costs, axis=1))
        return np.where(reachable, best, NOWHERE)
