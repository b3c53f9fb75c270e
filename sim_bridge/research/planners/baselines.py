"""The paper's baselines SER, RER and GER, on the same graphs and costs as BER.

Source: arXiv 2604.13441, section V. SER, static energy-optimal routing, plans once. RER re-plans
online at each vertex. GER, greedy energy-minimising routing, compares only the next edges.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Ints
from companion.core.routing.planner_interface import (
    NO_EDGE,
    STOP_AT_DEPOT,
    BatchPlanner,
    PlannerObservation,
)
from companion.core.routing.shortest_paths import Routes
from sim_bridge.research.planners.online import (
    PlanCache,
    ReplanningModel,
    Viewpoints,
    first_edges_of_cheapest_routes,
)


class Ser:
    """SER: plans the routes out and back with the wind at departure and never re-plans.

    It stays on the ground if the plan needs more energy than the budget.
    """

    def __init__(self, model: ReplanningModel, budget_wh: float) -> None:
        self._model, self._budget_wh = model, budget_wh
        self._plan_column: Ints | None = None  # each mission's column of the next edges
        self._next_edges = np.empty((2, 0, 0), dtype=np.int64)  # next edges out and back, (2, V, k)

    def start_batch(self, uniform_random_by_mission: NDArray[np.float64]) -> BatchPlanner:
        return Ser(self._model, self._budget_wh)

    def select_edges(self, observation: PlannerObservation) -> Ints:
        if self._plan_column is None:  # all missions depart together
            stays = self._store_plans_and_flag_over_budget(observation)
            return np.where(
                stays, STOP_AT_DEPOT, self._next_edges[0, observation.vertex, self._plan_column]
            )
        plan = self._plan_column[observation.mission]
        return self._next_edges[observation.delivered.astype(np.int64), observation.vertex, plan]

    def _store_plans_and_flag_over_budget(
        self, observation: PlannerObservation
    ) -> NDArray[np.bool_]:
        """Plan every mission. Return True where the plan needs more energy than the budget."""
        model, graph = self._model, self._model.finder.graph
        viewpoints = Viewpoints(observation.vertex, observation.wind_index, observation.wind_en_mps)
        duration, self._plan_column = model.surrogate_durations_and_columns(viewpoints)
        out = model.finder.find_routes_to_goal(graph.target, model.energy_wh(duration, False))
        back = model.finder.find_routes_to_goal(graph.depot, model.energy_wh(duration, True))
        self._next_edges = np.stack([out.next_edge, back.next_edge])
        needed_wh = self._predicted_plan_energy_wh(out, back, viewpoints, self._plan_column)
        return (needed_wh > self._budget_wh)[self._plan_column]

    def _predicted_plan_energy_wh(
        self, out: Routes, back: Routes, viewpoints: Viewpoints, plan_column: Ints
    ) -> NDArray:
        """Energy of each plan by `EnergyCost` under the wind seen at departure."""
        model, graph = self._model, self._model.finder.graph
        first = np.unique(plan_column, return_index=True)[1]
        seen_s = graph.edge_duration_s(viewpoints.wind_en_mps[first])
        loaded, empty = model.energy_wh(seen_s, False), model.energy_wh(seen_s, True)
        return _route_energy_wh(
            out.next_edge, loaded, graph.head, graph.depot, graph.target
        ) + _route_energy_wh(back.next_edge, empty, graph.head, graph.target, graph.depot)


def _route_energy_wh(
    next_edge: Ints, edge_wh: NDArray, head: Ints, origin: int, goal: int
) -> NDArray:
    """Return the energy along each column's route from origin to goal; infinite without a route."""
    plans = np.arange(next_edge.shape[1])
    at = np.full(len(plans), origin)
    total = np.zeros(len(plans))
    for _ in range(len(next_edge)):
        active = (at != goal) & np.isfinite(total)
        if not active.any():
            break
        edge = next_edge[at, plans]
        step = np.where(edge >= 0, edge_wh[edge, plans], np.inf)
        total = np.where(active, total + step, total)
        at = np.where(active & (edge >= 0), head[edge], at)
    return np.where(at == goal, total, np.inf)


class Rer:
    """RER: re-plans at each vertex with the wind seen there, to the target and then to the depot.

    It never aborts.
    """

    def __init__(self, model: ReplanningModel) -> None:
        self._model = model
        self._route_caches = [
            PlanCache(model, 1, partial(first_edges_of_cheapest_routes, model, delivered))
            for delivered in (False, True)
        ]

    def start_batch(self, uniform_random_by_mission: NDArray[np.float64]) -> BatchPlanner:
        return self

    def select_edges(self, observation: PlannerObservation) -> Ints:
        edge = np.empty(observation.mission_count, dtype=np.int64)
        for delivered, routes in enumerate(self._route_caches):
            rows = np.flatnonzero(observation.delivered == delivered)
            if len(rows):
                edge[rows] = routes.lookup_or_solve(observation, rows)[:, 0]
        return edge


class Ger:
    """GER: flies the cheapest edge out of each vertex, without regard to the goal.

    Ties go to the lowest head vertex. It never aborts. The load scales all edges equally and has
    no effect.
    """

    def __init__(self, model: ReplanningModel) -> None:
        self._model = model
        self._edge_cache = PlanCache(model, 1, self._cheapest_out_edges)

    def start_batch(self, uniform_random_by_mission: NDArray[np.float64]) -> BatchPlanner:
        return self

    def select_edges(self, observation: PlannerObservation) -> Ints:
        rows = np.arange(observation.mission_count)
        return self._edge_cache.lookup_or_solve(observation, rows)[:, 0].astype(np.int64)

    def _cheapest_out_edges(self, viewpoints: Viewpoints) -> NDArray:
        slots = self._model.finder.graph.out_edges_by_vertex[viewpoints.origin]
        duration, column = self._model.surrogate_durations_and_columns(viewpoints)
        cost = np.where(slots >= 0, duration[slots, column[:, None]], np.inf)
        slot = np.argmin(cost, axis=1)[:, None]
        return np.where(slots[:, :1] >= 0, np.take_along_axis(slots, slot, axis=1), NO_EDGE)
