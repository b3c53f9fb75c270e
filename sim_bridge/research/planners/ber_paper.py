"""BER as published: re-planning behind a return check and a threshold policy (paper IV-B).

At each vertex, for each out-edge e = (v, u) and the wind seen here, with c = EnergyCost +
lambda Unc and D the least cost under it:

  ReturnOK(e)   b >= c(e) + kappa D_loaded(u, depot)       it could still turn round at u
  threshold     b >= c(e) + D_loaded(u, target) + kappa D_empty(target, depot)
  Score(e)      -(c(e) + D_loaded(u, target))              or, by the metric flag, of L_SE

The best-scored edge that passes both is flown; if none does, it flies back and stops at the depot
(ABRT). After delivery it takes the cheapest way home. Decision T_max and later are flown home too.
The paper names these functions without stating them; this is the reading that fits its outcomes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Ints
from companion.core.routing.planner_interface import STAY, Decider, Look
from companion.core.routing.shortest_paths import INFEASIBLE_WH
from sim_bridge.research.planners.online import (
    OnlineModel,
    Remembered,
    Viewpoints,
    through_out_edges,
)


@dataclass(frozen=True)
class BerPaperParams:
    """`curve_factor` is the paper's kappa; `max_decisions` its T_max (None: 4 |V|).

    `metric_flag` 0 ranks by energy (feasibility first), 1 by the synthetic length L_SE.
    `budget_gate` off is the ablation of Table 2.
    """

    curve_factor: float = 1.15
    max_decisions: int | None = None
    metric_flag: int = 0
    budget_gate: bool = True


class BerPaper:
    """The published gate and router."""

    name = "ber-paper"

    def __init__(self, model: OnlineModel, params: BerPaperParams | None = None) -> None:
        self._model = model
        self._params = params or BerPaperParams()
        self._width = model.finder.graph.out_edges.shape[1]
        self._out = Remembered(model, 2 * self._width + 1, self._plan_out)
        self._back = Remembered(model, 1, lambda views: self._plan_home(views, True))

    def begin(self, coin: NDArray[np.float64]) -> Decider:
        return _BerPaperFlights(self, len(coin))

    def choose(self, look: Look, decisions: Ints) -> Ints:
        """The edge of each mission, the `decisions`-th that it takes."""
        edge = np.empty(look.count, dtype=np.int64)
        home = np.flatnonzero(look.delivered)
        if len(home):
            edge[home] = self._back.get(look, home)[:, 0]
        out = np.flatnonzero(~look.delivered)
        if len(out):
            edge[out] = self._outbound(look, out, decisions[out])
        return edge

    def _outbound(self, look: Look, rows: Ints, decisions: Ints) -> Ints:
        graph, width = self._model.finder.graph, self._width
        plan = self._out.get(look, rows)
        score, need, turn = plan[:, :width], plan[:, width : 2 * width], plan[:, -1]
        passes = need <= look.energy_wh[rows][:, None]
        if not self._params.budget_gate:
            passes = np.isfinite(score)
        ranked = np.where(passes, score, np.inf)
        place = np.argmin(ranked, axis=1)
        last = self._params.max_decisions or 4 * graph.vertex_count
        goes = np.isfinite(ranked[np.arange(len(rows)), place]) & (decisions < last)
        back = np.where(look.vertex[rows] == graph.depot, STAY, turn.astype(np.int64))
        return np.where(goes, graph.out_edges[look.vertex[rows], place], back)

    def _plan_out(self, views: Viewpoints) -> NDArray:
        model, graph = self._model, self._model.finder.graph
        duration, column = model.duration_s(views)
        loaded, empty = model.energy_wh(duration, False), model.energy_wh(duration, True)
        to_target = model.finder.to(graph.target, loaded)
        turn = model.finder.to(graph.depot, loaded)
        home_wh = model.finder.to(graph.depot, empty).cost_wh[graph.target]
        kappa = self._params.curve_factor
        deliver = through_out_edges(model, loaded, to_target.cost_wh, views.origin, column)
        retreat = through_out_edges(model, loaded, kappa * turn.cost_wh, views.origin, column)
        need = np.maximum(deliver + kappa * home_wh[column][:, None], retreat)
        need[need >= INFEASIBLE_WH] = np.inf
        score = self._synthetic(views, duration, column) if self._params.metric_flag else deliver
        return np.column_stack([score, need, turn.next_edge[views.origin, column]])

    def _synthetic(self, views: Viewpoints, duration: NDArray, column: Ints) -> NDArray:
        """Score by `L_SE = L_geo + lambda L_wind` along the rest of the way to the target."""
        model, graph = self._model, self._model.finder.graph
        first = np.unique(column, return_index=True)[1]
        length = graph.synthetic_length_m(views.wind_en_mps[first], model.cost.risk_weight)
        routes = model.finder.to(graph.target, length)
        return through_out_edges(model, length, routes.cost_wh, views.origin, column)

    def _plan_home(self, views: Viewpoints, delivered: bool) -> NDArray:
        graph = self._model.finder.graph
        duration, column = self._model.duration_s(views)
        routes = self._model.finder.to(graph.depot, self._model.energy_wh(duration, delivered))
        return routes.next_edge[views.origin, column][:, None]


class _BerPaperFlights:
    def __init__(self, planner: BerPaper, missions: int) -> None:
        self._planner = planner
        self._decisions = np.zeros(missions, dtype=np.int64)

    def decide(self, look: Look) -> Ints:
        taken = self._decisions[look.mission]
        self._decisions[look.mission] = taken + 1
        return self._planner.choose(look, taken)
