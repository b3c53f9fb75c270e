"""The clairvoyant on recorded wind: the best result if the whole recording is known in advance.

A vehicle that enters an edge later leaves it later (the wind is the same for all on the edge). The
earliest arrival at the target, and from there at the depot, therefore costs the least energy:
Dijkstra over arrival times, all missions at once (Kaufman & Smith 1993 for the FIFO argument).
"""

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import WH_PER_J, EnergyGraph
from companion.core.routing.planner_interface import (
    NO_EDGE,
    STOP_AT_DEPOT,
    BatchPlanner,
    PlannerObservation,
)
from sim_bridge.research.planners.mission_model import LogWinds


class Clairvoyant:
    """Flies the earliest route out and back if it fits the budget, else stays at the depot."""

    def __init__(self, graph: EnergyGraph, budget_wh: float, winds: LogWinds) -> None:
        self._graph, self._budget_wh, self._winds = graph, budget_wh, winds

    def start_batch(self, uniform_random_by_mission: NDArray[np.float64]) -> BatchPlanner:
        graph = self._graph
        power = np.asarray(graph.power_w) * WH_PER_J
        begin = np.zeros(len(uniform_random_by_mission))
        limit = self._budget_wh / power
        arrival, out = earliest_arrivals(graph, self._winds, graph.depot, begin, limit[0])
        delivered = arrival[:, graph.target]
        arrival, back = earliest_arrivals(graph, self._winds, graph.target, delivered, limit[1])
        home = arrival[:, graph.depot]
        used = (
            delivered * power[0] + np.where(np.isfinite(home), home - delivered, np.inf) * power[1]
        )
        # The mission model must complete the last edge despite rounding errors.
        fits_budget = used <= self._budget_wh * (1.0 - 1e-12)
        return _ClairvoyantBatch(graph, fits_budget, out, back)


class _ClairvoyantBatch:
    def __init__(
        self, graph: EnergyGraph, fits_budget: NDArray[np.bool_], out: Ints, back: Ints
    ) -> None:
        self._fits_budget = fits_budget
        self._next = np.stack(
            [
                _next_edges_to_goal(graph, out, graph.depot, graph.target),
                _next_edges_to_goal(graph, back, graph.target, graph.depot),
            ]
        )

    def select_edges(self, observation: PlannerObservation) -> Ints:
        edge = self._next[
            observation.delivered.astype(np.int64), observation.mission, observation.vertex
        ]
        return np.where(self._fits_budget[observation.mission], edge, STOP_AT_DEPOT)


def earliest_arrivals(
    graph: EnergyGraph, winds: LogWinds, source: int, begin_s: Floats, limit_s: float
) -> tuple[Floats, Ints]:
    """Compute the earliest arrivals from `source`, departed at `begin_s` (n,); Dijkstra.

    Returns the arrival at each vertex, s, and the edge of that arrival; shapes (n, V).
    """
    missions = np.arange(len(begin_s))
    arrival = np.full((len(begin_s), graph.vertex_count), np.inf)
    arrival[:, source] = begin_s
    by_edge = np.full(arrival.shape, NO_EDGE, dtype=np.int64)
    settled = np.zeros(arrival.shape, dtype=bool)
    for _ in range(graph.vertex_count):
        nearest = np.argmin(np.where(settled, np.inf, arrival), axis=1)
        departure_s = arrival[missions, nearest]
        open_ = np.isfinite(departure_s) & ~settled[missions, nearest]
        if not open_.any():
            break
        settled[missions[open_], nearest[open_]] = True
        edge = graph.out_edges_by_vertex[nearest]
        mission, slot = np.nonzero((edge >= 0) & open_[:, None])
        edge = edge[mission, slot]
        duration_s = winds.edge_durations_s(
            mission, edge, departure_s[mission], np.full(len(edge), limit_s)
        )
        candidate_s = departure_s[mission] + duration_s
        head = graph.head[edge]
        improved = candidate_s < arrival[mission, head]
        arrival[mission[improved], head[improved]] = candidate_s[improved]
        by_edge[mission[improved], head[improved]] = edge[improved]
    return arrival, by_edge


def _next_edges_to_goal(graph: EnergyGraph, arrival_edge: Ints, source: int, goal: int) -> Ints:
    """Return the next edges of each mission's route to `goal`, from its arrival edges; (n, V)."""
    missions = np.arange(len(arrival_edge))
    onward = np.full(arrival_edge.shape, NO_EDGE, dtype=np.int64)
    at = np.full(len(arrival_edge), goal)
    for _ in range(graph.vertex_count):
        edge = arrival_edge[missions, at]
        unfinished = (edge >= 0) & (at != source)
        if not unfinished.any():
            break
        tail = graph.tail[edge[unfinished]]
        onward[missions[unfinished], tail] = edge[unfinished]
        at[unfinished] = tail
    return onward
