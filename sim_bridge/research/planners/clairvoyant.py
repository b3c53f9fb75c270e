"""The clairvoyant on recorded wind: the best result with the whole recording known beforehand.

An edge that is entered later is left later (the wind is the same for all who are on it), so the
earliest arrival at the target, and from there at the depot, costs the least energy of all routes:
Dijkstra over arrival times, all missions at once (Kaufman & Smith 1993 for the FIFO argument).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import WH_PER_J, EnergyGraph
from companion.core.routing.planner_interface import NOWHERE, STAY, Decider, Look
from sim_bridge.research.planners.mission_model import LogWinds


@dataclass(frozen=True)
class _Ways:
    """Earliest arrival at each vertex, and the edge by which; shapes (n, V)."""

    arrival_s: Floats
    by_edge: Ints


class Clairvoyant:
    """Flies the earliest way out and back where that keeps the budget, else stays."""

    name = "clairvoyant"

    def __init__(self, graph: EnergyGraph, budget_wh: float, winds: LogWinds) -> None:
        self._graph, self._budget_wh, self._winds = graph, budget_wh, winds

    def begin(self, coin: NDArray[np.float64]) -> Decider:
        graph = self._graph
        power = np.asarray(graph.power_w) * WH_PER_J
        begin = np.zeros(len(coin))
        limit = self._budget_wh / power
        out = earliest(graph, self._winds, graph.depot, begin, limit[0])
        delivered = out.arrival_s[:, graph.target]
        back = earliest(graph, self._winds, graph.target, delivered, limit[1])
        home = back.arrival_s[:, graph.depot]
        used = (
            delivered * power[0] + np.where(np.isfinite(home), home - delivered, np.inf) * power[1]
        )
        # The last edge must be completed on what is left, to the last bit as it is flown.
        goes = used <= self._budget_wh * (1.0 - 1e-12)
        return _Plan(graph, goes, out.by_edge, back.by_edge)


class _Plan:
    def __init__(self, graph: EnergyGraph, goes: NDArray[np.bool_], out: Ints, back: Ints) -> None:
        self._goes = goes
        self._next = np.stack(
            [
                _forward(graph, out, graph.depot, graph.target),
                _forward(graph, back, graph.target, graph.depot),
            ]
        )

    def decide(self, look: Look) -> Ints:
        edge = self._next[look.delivered.astype(np.int64), look.mission, look.vertex]
        return np.where(self._goes[look.mission], edge, STAY)


def earliest(
    graph: EnergyGraph, winds: LogWinds, source: int, begin_s: Floats, limit_s: float
) -> _Ways:
    """Earliest arrivals from `source`, left at `begin_s` (n,) after departure."""
    missions = np.arange(len(begin_s))
    arrival = np.full((len(begin_s), graph.vertex_count), np.inf)
    arrival[:, source] = begin_s
    by_edge = np.full(arrival.shape, NOWHERE, dtype=np.int64)
    settled = np.zeros(arrival.shape, dtype=bool)
    for _ in range(graph.vertex_count):
        nearest = np.argmin(np.where(settled, np.inf, arrival), axis=1)
        when = arrival[missions, nearest]
        open_ = np.isfinite(when) & ~settled[missions, nearest]
        if not open_.any():
            break
        settled[missions[open_], nearest[open_]] = True
        edge = graph.out_edges[nearest]
        mission, place = np.nonzero((edge >= 0) & open_[:, None])
        edge = edge[mission, place]
        took = winds.durations_s(mission, edge, when[mission], np.full(len(edge), limit_s))
        then = when[mission] + took
        head = graph.head[edge]
        better = then < arrival[mission, head]
        arrival[mission[better], head[better]] = then[better]
        by_edge[mission[better], head[better]] = edge[better]
    return _Ways(arrival, by_edge)


def _forward(graph: EnergyGraph, by_edge: Ints, source: int, goal: int) -> Ints:
    """Next edges along each mission's way to `goal`, from the edges by which it arrived; (n, V)."""
    missions = np.arange(len(by_edge))
    onward = np.full(by_edge.shape, NOWHERE, dtype=np.int64)
    at = np.full(len(by_edge), goal)
    for _ in range(graph.vertex_count):
        edge = by_edge[missions, at]
        going = (edge >= 0) & (at != source)
        if not going.any():
            break
        tail = graph.tail[edge[going]]
        onward[missions[going], tail] = edge[going]
        at[going] = tail
    return onward
