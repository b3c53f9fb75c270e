"""Least-cost routes to a goal on the energy graph, for many winds at once or for one."""

import heapq
import math
from dataclasses import dataclass, field

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import NOWHERE

# An edge that cannot be flown in the wind seen: planned over only where nothing else leads on.
INFEASIBLE_WH = 1e9
LEAST_WH = 1e-9  # an edge of no length still costs a little, so that routes end
CACHED_COSTS = 32_768  # edges x problems in one sweep: what fits a core's cache
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
    _into: list[list[tuple[int, int]]] = field(init=False, repr=False)
    """For each vertex the edges that lead to it, each with its tail."""

    def __post_init__(self) -> None:
        into: list[list[tuple[int, int]]] = [[] for _ in range(self.graph.vertex_count)]
        heads, tails = self.graph.head.tolist(), self.graph.tail.tolist()
        for edge, (head, tail) in enumerate(zip(heads, tails, strict=True)):
            into[head].append((edge, tail))
        object.__setattr__(self, "_into", into)

    def to(self, goal: int, cost_wh: Floats) -> Routes:
        """Routes from everywhere to `goal` for each column of `cost_wh` (E, n).

        Infinite costs count as INFEASIBLE_WH. Ties fall to the lowest head.
        """
        width = max(FEW + 1, CACHED_COSTS // max(self.graph.edge_count, 1))
        if cost_wh.shape[1] <= width:
            return self._all_to(goal, cost_wh)
        begins = range(0, cost_wh.shape[1], width)
        parts = [self._all_to(goal, cost_wh[:, begin : begin + width]) for begin in begins]
        return Routes(
            np.concatenate([part.cost_wh for part in parts], axis=1),
            np.concatenate([part.next_edge for part in parts], axis=1),
        )

    def _all_to(self, goal: int, cost_wh: Floats) -> Routes:
        cost = np.clip(cost_wh, LEAST_WH, INFEASIBLE_WH)
        if cost.shape[1] <= FEW:
            total = np.stack([self._dijkstra(goal, column) for column in cost.T], axis=1)
        else:
            total = self._bellman_ford(goal, cost)
        return Routes(total, self._next_edge(cost + total[self.graph.head]))

    def _dijkstra(self, goal: int, cost_wh: Floats) -> Floats:
        """Sums are the same whatever the order of the search; scipy's takes half a second to import
        and is no faster on graphs of some hundred edges."""
        cost = cost_wh.tolist()
        total = [math.inf] * len(self._into)
        total[goal] = 0.0
        found = [(0.0, goal)]
        while found:
            so_far, vertex = heapq.heappop(found)
            if so_far > total[vertex]:
                continue
            for edge, tail in self._into[vertex]:
                through = so_far + cost[edge]
                if through < total[tail]:
                    total[tail] = through
                    heapq.heappush(found, (through, tail))
        return np.array(total)

    def _bellman_ford(self, goal: int, cost_wh: Floats) -> Floats:
        slots = self.graph.out_edges.T  # (W, V): whole vectors at a time, where reduceat is slow
        heads = np.where(slots >= 0, self.graph.head[slots], 0)
        costs = np.where(slots[..., None] >= 0, cost_wh[slots], np.inf)
        total = np.full(costs.shape[1:], np.inf)
        total[goal] = 0.0
        through = np.empty_like(total)
        while True:
            best = total.copy()
            for cost, head in zip(costs, heads, strict=True):
                np.add(cost, total.take(head, axis=0), out=through)
                np.minimum(best, through, out=best)
            if np.array_equal(best, total):
                return total
            total = best

    def _next_edge(self, through_wh: Floats) -> Ints:
        """The cheapest out-edge of each vertex given each edge's cost to the goal (E, n)."""
        slots = self.graph.out_edges
        costs = np.where(slots[..., None] >= 0, through_wh[slots], np.inf)
        place = np.argmin(costs, axis=1)
        best = np.take_along_axis(slots, place, axis=1)
        reachable = np.isfinite(np.min(costs, axis=1))
        return np.where(reachable, best, NOWHERE)


def path_to(graph: EnergyGraph, routes: Routes, start: int) -> list[int] | None:
    """Vertices from `start` to the goal of the first column; None where it needs a closed edge."""
    if not routes.cost_wh[start, 0] < INFEASIBLE_WH:
        return None
    path = [start]
    while routes.cost_wh[path[-1], 0] > 0.0:
        path.append(int(graph.head[routes.next_edge[path[-1], 0]]))
    return path
