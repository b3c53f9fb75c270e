"""The paper's baselines SER, RER and GER, on the same graphs and costs as BER.

Source: arXiv 2604.13441, section V. SER, static energy-optimal routing, plans once. RER re-plans
online at each vertex. GER, greedy energy-minimising routing, looks one edge ahead.
"""

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Ints
from companion.core.routing.planner_interface import NOWHERE, STAY, Decider, Look
from companion.core.routing.shortest_paths import Routes
from sim_bridge.research.planners.online import OnlineModel, Remembered, Viewpoints


class Ser:
    """SER: plans out and back with the wind seen at departure, and then keeps to that plan.

    It stays on the ground if the plan needs more energy than the budget.
    """

    name = "ser"

    def __init__(self, model: OnlineModel, budget_wh: float) -> None:
        self._model, self._budget_wh = model, budget_wh

    def begin(self, coin: NDArray[np.float64]) -> Decider:
        return _SerFlights(self._model, self._budget_wh, len(coin))


class _SerFlights:
    def __init__(self, model: OnlineModel, budget_wh: float, missions: int) -> None:
        self._model, self._budget_wh = model, budget_wh
        self._plan = np.full(missions, -1, dtype=np.int64)
        self._steps: list[Ints] = []  # (2, V, k) next edges out and back, one for each planning
        self._stays: list[NDArray[np.bool_]] = []
        self._begin: list[int] = []
        self._next: Ints | None = None

    def decide(self, look: Look) -> Ints:
        new = self._plan[look.mission] < 0
        if new.any():
            self._departures(look, np.flatnonzero(new))
        plan = self._plan[look.mission]
        steps = np.concatenate(self._steps, axis=2) if self._next is None else self._next
        self._next = steps
        stays = np.concatenate(self._stays)
        edge = steps[look.delivered.astype(np.int64), look.vertex, plan]
        at_start = new & stays[plan]
        return np.where(at_start, STAY, edge)

    def _departures(self, look: Look, rows: Ints) -> None:
        model, graph = self._model, self._model.finder.graph
        views = Viewpoints(look.vertex[rows], look.seen[rows], look.wind_en_mps[rows])
        duration, column = model.duration_s(views)
        out = model.finder.to(graph.target, model.energy_wh(duration, False))
        back = model.finder.to(graph.depot, model.energy_wh(duration, True))
        begin = sum(steps.shape[2] for steps in self._steps)
        self._plan[look.mission[rows]] = begin + column
        self._steps.append(np.stack([out.next_edge, back.next_edge]))
        self._stays.append(self._predicted_wh(out, back, views, column) > self._budget_wh)
        self._next = None

    def _predicted_wh(self, out: Routes, back: Routes, views: Viewpoints, column: Ints) -> NDArray:
        """Energy of each plan by `EnergyCost` under the wind seen at departure."""
        model, graph = self._model, self._model.finder.graph
        first = np.unique(column, return_index=True)[1]
        seen_s = graph.duration_s(views.wind_en_mps[first])
        loaded, empty = model.energy_wh(seen_s, False), model.energy_wh(seen_s, True)
        return _route_wh(out.next_edge, loaded, graph.head, graph.depot, graph.target) + _route_wh(
            back.next_edge, empty, graph.head, graph.target, graph.depot
        )


def _route_wh(next_edge: Ints, edge_wh: NDArray, head: Ints, origin: int, goal: int) -> NDArray:
    """Energy along each column's route from origin to goal; infinite where there is none."""
    plans = np.arange(next_edge.shape[1])
    at = np.full(len(plans), origin)
    total = np.zeros(len(plans))
    for _ in range(len(next_edge)):
        flying = (at != goal) & np.isfinite(total)
        if not flying.any():
            break
        edge = next_edge[at, plans]
        step = np.where(edge >= 0, edge_wh[edge, plans], np.inf)
        total = np.where(flying, total + step, total)
        at = np.where(flying & (edge >= 0), head[edge], at)
    return np.where(at == goal, total, np.inf)


class Rer:
    """RER: plans again at each vertex with the wind seen there; to the target, then to the depot.

    It never aborts.
    """

    name = "rer"

    def __init__(self, model: OnlineModel) -> None:
        self._model = model
        self._next = (
            Remembered(model, 1, lambda views: self._plan(views, False)),
            Remembered(model, 1, lambda views: self._plan(views, True)),
        )

    def begin(self, coin: NDArray[np.float64]) -> Decider:
        return self

    def decide(self, look: Look) -> Ints:
        empty = np.count_nonzero(look.delivered)
        if empty in (0, look.count):
            plan = self._next[int(empty > 0)]
            return plan.of(look.vertex, look.seen, look.wind_en_mps)[:, 0].astype(np.int64)
        edge = np.empty(look.count, dtype=np.int64)
        for delivered in (False, True):
            rows = np.flatnonzero(look.delivered == delivered)
            edge[rows] = self._next[int(delivered)].get(look, rows)[:, 0]
        return edge

    def _plan(self, views: Viewpoints, delivered: bool) -> NDArray:
        graph = self._model.finder.graph
        duration, column = self._model.duration_s(views)
        goal = graph.depot if delivered else graph.target
        routes = self._model.finder.to(goal, self._model.energy_wh(duration, delivered))
        return routes.next_edge[views.origin, column][:, None]


class Ger:
    """GER: takes the cheapest edge out of each vertex, wherever it leads.

    Ties go to the lowest head vertex. It never aborts. The load scales all edges alike, so it does
    not matter here.
    """

    name = "ger"

    def __init__(self, model: OnlineModel) -> None:
        self._model = model
        self._next = Remembered(model, 1, self._cheapest)

    def begin(self, coin: NDArray[np.float64]) -> Decider:
        return self

    def decide(self, look: Look) -> Ints:
        return self._next.get(look, np.arange(look.count))[:, 0].astype(np.int64)

    def _cheapest(self, views: Viewpoints) -> NDArray:
        slots = self._model.finder.graph.out_edges[views.origin]
        duration, column = self._model.duration_s(views)
        cost = np.where(slots >= 0, duration[slots, column[:, None]], np.inf)
        place = np.argmin(cost, axis=1)[:, None]
        return np.where(slots[:, :1] >= 0, np.take_along_axis(slots, place, axis=1), NOWHERE)
