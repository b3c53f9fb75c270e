"""Least-cost routes to a goal on the energy graph, for many winds at once or for one."""

import heapq
import math
from dataclasses import dataclass, field

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import NO_EDGE

# Cost of an edge that is infeasible in the observed wind: used only without an alternative.
INFEASIBLE_WH = 1e9
LEAST_WH = 1e-9  # an edge of no length has a small cost, so that routes terminate
CACHED_COSTS = 32_768  # edges x problems in one sweep: fits the cache of a CPU core
MAX_DIJKSTRA_PROBLEMS = (
    3  # up to this number of problems one Dijkstra each is faster than one common sweep
)


@dataclass(frozen=True)
class Routes:
    """Cost from every vertex to the goal and the next edge towards it; shapes (V, n)."""

    cost_wh: Floats
    next_edge: Ints


@dataclass(frozen=True)
class RouteFinder:
    """Least-cost search on one graph with the costs of each call."""

    graph: EnergyGraph
    _in_edges: list[list[tuple[int, int]]] = field(init=False, repr=False)
    """Incoming edges of each vertex, as (edge, tail)."""

    def __post_init__(self) -> None:
        in_edges: list[list[tuple[int, int]]] = [[] for _ in range(self.graph.vertex_count)]
        head_vertices, tails = self.graph.head.tolist(), self.graph.tail.tolist()
        for edge, (head, tail) in enumerate(zip(head_vertices, tails, strict=True)):
            in_edges[head].append((edge, tail))
        object.__setattr__(self, "_in_edges", in_edges)

    def find_routes_to_goal(self, goal_vertex: int, edge_cost_wh: Floats) -> Routes:
        """Return routes from all vertices to `goal_vertex` per column of `edge_cost_wh` (E, n).

        Infinite costs count as INFEASIBLE_WH. Ties fall to the lowest head.
        """
        width = max(MAX_DIJKSTRA_PROBLEMS + 1, CACHED_COSTS // max(self.graph.edge_count, 1))
        if edge_cost_wh.shape[1] <= width:
            return self._find_routes_without_splitting(goal_vertex, edge_cost_wh)
        offsets = range(0, edge_cost_wh.shape[1], width)
        parts = [
            self._find_routes_without_splitting(
                goal_vertex, edge_cost_wh[:, offset : offset + width]
            )
            for offset in offsets
        ]
        return Routes(
            np.concatenate([part.cost_wh for part in parts], axis=1),
            np.concatenate([part.next_edge for part in parts], axis=1),
        )

    def _find_routes_without_splitting(self, goal_vertex: int, edge_cost_wh: Floats) -> Routes:
        cost = np.clip(edge_cost_wh, LEAST_WH, INFEASIBLE_WH)
        if cost.shape[1] <= MAX_DIJKSTRA_PROBLEMS:
            total = np.stack(
                [self._vertex_costs_by_dijkstra_wh(goal_vertex, column) for column in cost.T],
                axis=1,
            )
        else:
            total = self._vertex_costs_by_bellman_ford_wh(goal_vertex, cost)
        return Routes(total, self._cheapest_out_edge_by_vertex(cost + total[self.graph.head]))

    def _vertex_costs_by_dijkstra_wh(self, goal: int, edge_cost_wh: Floats) -> Floats:
        """Return the cost to the goal of every vertex. Not scipy's: its import takes half a second
        and it is no faster on graphs of some hundred edges."""
        cost = edge_cost_wh.tolist()
        total = [math.inf] * len(self._in_edges)
        total[goal] = 0.0
        found = [(0.0, goal)]
        while found:
            so_far, vertex = heapq.heappop(found)
            if so_far > total[vertex]:
                continue
            for edge, tail in self._in_edges[vertex]:
                candidate_wh = so_far + cost[edge]
                if candidate_wh < total[tail]:
                    total[tail] = candidate_wh
                    heapq.heappush(found, (candidate_wh, tail))
        return np.array(total)

    def _vertex_costs_by_bellman_ford_wh(self, goal: int, edge_cost_wh: Floats) -> Floats:
        slots = (
            self.graph.out_edges_by_vertex.T
        )  # (W, V): whole vectors at a time, where reduceat is slow
        head_vertices = np.where(slots >= 0, self.graph.head[slots], 0)
        costs = np.where(slots[..., None] >= 0, edge_cost_wh[slots], np.inf)
        total = np.full(costs.shape[1:], np.inf)
        total[goal] = 0.0
        candidate_wh = np.empty_like(total)
        while True:
            best = total.copy()
            for cost, head in zip(costs, head_vertices, strict=True):
                np.add(cost, total.take(head, axis=0), out=candidate_wh)
                np.minimum(best, candidate_wh, out=best)
            if np.array_equal(best, total):
                return total
            total = best

    def _cheapest_out_edge_by_vertex(self, cost_to_goal_via_edge_wh: Floats) -> Ints:
        """Return each vertex's cheapest out-edge given the cost to the goal by edge (E, n)."""
        slots = self.graph.out_edges_by_vertex
        costs = np.where(slots[..., None] >= 0, cost_to_goal_via_edge_wh[slots], np.inf)
        slot = np.argmin(costs, axis=1)
        best = np.take_along_axis(slots, slot, axis=1)
        reachable = np.isfinite(np.min(costs, axis=1))
        return np.where(reachable, best, NO_EDGE)


def path_vertices_in_first_problem(
    graph: EnergyGraph, routes: Routes, start_vertex: int
) -> list[int] | None:
    """Return vertices from `start_vertex` to the goal, first column; None: infeasible."""
    if not routes.cost_wh[start_vertex, 0] < INFEASIBLE_WH:
        return None
    path = [start_vertex]
    while routes.cost_wh[path[-1], 0] > 0.0:
        path.append(int(graph.head[routes.next_edge[path[-1], 0]]))
    return path
