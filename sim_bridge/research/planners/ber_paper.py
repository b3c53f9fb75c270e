"""BER as published: re-planning behind a return check and a threshold policy (paper IV-B).

At each vertex, for each out-edge e = (v, u) and the wind seen here, with c = EnergyCost +
lambda Unc and D the least cost under it:

  ReturnOK(e)   b >= c(e) + kappa D_loaded(u, depot)       it can still return from u
  threshold     b >= c(e) + D_loaded(u, target) + kappa D_empty(target, depot)
  Score(e)      -(c(e) + D_loaded(u, target))              or, by the metric flag, of L_SE

The best-scored edge that passes both is flown; without the threshold, that passes ReturnOK. If none
passes, the vehicle returns and stops at the depot (ABRT). After delivery it flies the cheapest
route home, as it does from decision T_max on.
The paper names these functions without defining them. Readings: `table1 --readings`.
"""

import copy
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Ints
from companion.core.routing.planner_interface import STOP_AT_DEPOT, BatchPlanner, PlannerObservation
from companion.core.routing.shortest_paths import INFEASIBLE_WH
from sim_bridge.research.planners.online import (
    PlanCache,
    ReplanningModel,
    Viewpoints,
    first_edges_of_cheapest_routes,
    out_edge_costs,
)


@dataclass(frozen=True)
class BerPaperParams:
    """Parameters of the published BER. `curve_factor` is the paper's kappa.

    `metric_flag` 0 ranks by energy (feasibility first), 1 by the synthetic length L_SE.
    `has_threshold`: an edge must also leave enough energy for the delivery and the way home.
    """

    curve_factor: float = 1.15
    metric_flag: int = 0
    has_threshold: bool = True


class BerPaper:
    """BER as published: return check, threshold policy and router."""

    def __init__(self, model: ReplanningModel, params: BerPaperParams | None = None) -> None:
        self._model = model
        self._params = params or BerPaperParams()
        self._decision_count = 0  # made so far by this batch
        self._width = model.finder.graph.out_edges_by_vertex.shape[1]
        self._outbound_cache = PlanCache(
            model, 2 * self._width + 1, self._outbound_scores_needs_and_turn_edges
        )
        self._return_cache = PlanCache(
            model, 1, partial(first_edges_of_cheapest_routes, model, True)
        )

    def start_batch(self, uniform_random_by_mission: NDArray[np.float64]) -> BatchPlanner:
        batch = copy.copy(self)  # shares the caches
        batch._decision_count = 0
        return batch

    def select_edges(self, observation: PlannerObservation) -> Ints:
        edge = np.empty(observation.mission_count, dtype=np.int64)
        home = np.flatnonzero(observation.delivered)
        if len(home):
            edge[home] = self._return_cache.lookup_or_solve(observation, home)[:, 0]
        out = np.flatnonzero(~observation.delivered)
        if len(out):
            edge[out] = self._select_outbound(observation, out)
        self._decision_count += 1
        return edge

    def _select_outbound(self, observation: PlannerObservation, rows: Ints) -> Ints:
        graph, width = self._model.finder.graph, self._width
        plan = self._outbound_cache.lookup_or_solve(observation, rows)
        score, need, turn = plan[:, :width], plan[:, width : 2 * width], plan[:, -1]
        passes = need <= observation.energy_wh[rows][:, None]
        ranked = np.where(passes, score, np.inf)
        slot = np.argmin(ranked, axis=1)
        ranked_best = ranked[np.arange(len(rows)), slot]
        passes_checks = np.isfinite(ranked_best) & (self._decision_count < 4 * graph.vertex_count)
        back = np.where(
            observation.vertex[rows] == graph.depot, STOP_AT_DEPOT, turn.astype(np.int64)
        )
        return np.where(
            passes_checks, graph.out_edges_by_vertex[observation.vertex[rows], slot], back
        )

    def _outbound_scores_needs_and_turn_edges(self, viewpoints: Viewpoints) -> NDArray:
        model, graph = self._model, self._model.finder.graph
        duration, column = model.surrogate_durations_and_columns(viewpoints)
        loaded, empty = model.energy_wh(duration, False), model.energy_wh(duration, True)
        to_target = model.finder.find_routes_to_goal(graph.target, loaded)
        turn = model.finder.find_routes_to_goal(graph.depot, loaded)
        home_wh = model.finder.find_routes_to_goal(graph.depot, empty).cost_wh[graph.target]
        kappa = self._params.curve_factor
        deliver = out_edge_costs(model, loaded, to_target.cost_wh, viewpoints.origin, column)
        retreat = out_edge_costs(model, loaded, kappa * turn.cost_wh, viewpoints.origin, column)
        through = deliver + kappa * home_wh[column][:, None]
        need = np.maximum(through, retreat) if self._params.has_threshold else retreat
        need[need >= INFEASIBLE_WH] = np.inf
        score = (
            self._synthetic_length_scores(viewpoints, duration, column)
            if self._params.metric_flag
            else deliver
        )
        return np.column_stack([score, need, turn.next_edge[viewpoints.origin, column]])

    def _synthetic_length_scores(
        self, viewpoints: Viewpoints, duration: NDArray, column: Ints
    ) -> NDArray:
        """Score by `L_SE = L_geo + lambda L_wind` along the remaining route to the target."""
        model, graph = self._model, self._model.finder.graph
        _, first, column = np.unique(column, return_index=True, return_inverse=True)
        length = graph.edge_synthetic_length_m(
            viewpoints.wind_en_mps[first], model.cost.risk_weight
        )
        length = np.broadcast_to(length, (len(length), len(first)))  # one column at lambda = 0
        routes = model.finder.find_routes_to_goal(graph.target, length)
        return out_edge_costs(model, length, routes.cost_wh, viewpoints.origin, column)
