"""RER: online re-planning. The cheapest route under the wind seen here, again at each vertex."""

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Ints
from companion.core.routing.planner_interface import Decider, Look
from sim_bridge.research.planners.online import OnlineModel, Remembered, Viewpoints


class Rer:
    """First to the target, then to the depot; never aborts."""

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
