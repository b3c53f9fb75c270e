"""GER: greedy energy-minimising routing. The cheapest out-edge, wherever it leads (paper V)."""

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Ints
from companion.core.routing.planner_interface import NOWHERE, Decider, Look
from sim_bridge.research.planners.online import OnlineModel, Remembered, Viewpoints


class Ger:
    """Ties fall to the lowest head; never aborts. Load scales all edges alike: no matter here."""

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
