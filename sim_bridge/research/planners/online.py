"""Planning under the wind seen at a vertex, and remembering it where winds recur.

What SER, RER, GER and the published BER share. A chain shows few different winds, so what was
worked out for (vertex, wind seen) is kept; a recorded wind never comes again.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.planner_interface import Look
from companion.core.routing.shortest_paths import RouteFinder
from sim_bridge.research.planners.uncertainty import RiskCost


@dataclass(frozen=True)
class Viewpoints:
    """Places and winds from which to plan; arrays of length n (wind (n, 2))."""

    origin: Ints
    seen: Ints
    wind_en_mps: Floats


@dataclass(frozen=True)
class OnlineModel:
    """The graph, the surrogate cost and how many winds a chain's sight tells apart (0: a log)."""

    finder: RouteFinder
    cost: RiskCost
    winds: int = 0

    def duration_s(self, views: Viewpoints) -> tuple[Floats, Ints]:
        """Surrogate durations (E, k) of the different problems, and each view's column (n,)."""
        key = views.seen if self.winds else np.arange(len(views.seen))
        if self.winds and self.cost.depends_on_origin():
            key = views.origin * self.winds + views.seen
        _, first, column = np.unique(key, return_index=True, return_inverse=True)
        duration = self.cost.duration_s(
            views.origin[first], views.seen[first], views.wind_en_mps[first]
        )
        return duration, column.reshape(-1)

    def energy_wh(self, duration_s: Floats, delivered: bool) -> Floats:
        return duration_s * float(self.cost.power_wh_per_s(delivered))


class Remembered:
    """`solve` (views -> (n, entries)), asked once for each (vertex, wind seen) of a chain."""

    def __init__(
        self, model: OnlineModel, entries: int, solve: Callable[[Viewpoints], NDArray]
    ) -> None:
        self._model, self._solve = model, solve
        cells = model.finder.graph.vertex_count * model.winds
        self._known = np.zeros(cells, dtype=bool)
        self._values = np.zeros((cells, entries))

    def get(self, look: Look, rows: Ints) -> NDArray:
        """What `solve` says for each of the looks in `rows`; (len(rows), entries)."""
        return self.of(look.vertex[rows], look.seen[rows], look.wind_en_mps[rows])

    def of(self, vertex: Ints, seen: Ints, wind_en_mps: Floats) -> NDArray:
        """The same of places and winds."""
        if not self._model.winds:
            return self._solve(Viewpoints(vertex, seen, wind_en_mps))
        cell = vertex * self._model.winds + seen
        known = self._known.take(cell)
        if not known.all():
            fresh = self._to_solve(Viewpoints(vertex, seen, wind_en_mps), ~known)
            solved = fresh.origin * self._model.winds + fresh.seen
            self._values[solved] = self._solve(fresh)
            self._known[solved] = True
        return self._values.take(cell, axis=0)

    def _to_solve(self, views: Viewpoints, unknown: NDArray[np.bool_]) -> Viewpoints:
        """Each unknown view once; from all vertices at once where the origin does not matter."""
        winds = self._model.winds
        if self._model.cost.depends_on_origin():
            key = views.origin * winds + views.seen
            _, first = np.unique(key[unknown], return_index=True)
            rows = np.flatnonzero(unknown)[first]
            return Viewpoints(views.origin[rows], views.seen[rows], views.wind_en_mps[rows])
        seen, first = np.unique(views.seen[unknown], return_index=True)
        wind = views.wind_en_mps[unknown][first]
        vertices = self._model.finder.graph.vertex_count
        return Viewpoints(
            origin=np.tile(np.arange(vertices), len(seen)),
            seen=np.repeat(seen, vertices),
            wind_en_mps=np.repeat(wind, vertices, axis=0),
        )


def through_out_edges(
    model: OnlineModel, edge_wh: Floats, onward_wh: Floats, origin: Ints, column: Ints
) -> Floats:
    """Cost of going on by each out-edge of `origin` (n,) and then as `onward_wh` (V, k) says.

    Infinite where a vertex has no such edge; shape (n, W).
    """
    slots = model.finder.graph.out_edges[origin]
    heads = model.finder.graph.head[slots]
    total = edge_wh[slots, column[:, None]] + onward_wh[heads, column[:, None]]
    return np.where(slots >= 0, total, np.inf)
