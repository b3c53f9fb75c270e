"""The best that can be done from every (vertex, wind state, energy left): dynamic programming.

A mission has two phases. Once delivered, the best policy maximises P(home), whatever the loss is
worth. Before, with failure worth 0, success 1 and a safe stop at the depot worth sigma, the best
policy maximises P(SUC) + sigma P(ABRT). With the Lagrange weight c on the loss (evaluation.md, 4),
P(SUC) - c P(loss) = (1 + c) (P(SUC) + sigma P(ABRT)) - c where sigma = c / (1 + c): the same.

The sweep goes up the energy levels once. Each (edge, state) owns a delay line as long as its cost
in levels: what was worth W at level k is a candidate for its tail at level k + cost. Memory is the
sum of the costs, not levels x edges, and every access is to one slot (plain numpy, no compiler).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.step_model import NEVER, StepModel

LOSS_NOTHING_HELPS = 65535  # a choice: no edge promises anything here
STOP = 65534  # a choice: stay at the depot

# What the whole budget is worth, at most: breaks ties between equally promising edges towards the
# cheaper one. Smaller than any loss that is asked for, larger than float32 can blur.
THRIFT = 2e-5


@dataclass(frozen=True)
class HomeTable:
    """After delivery: P(home) under the best policy, and its choice of out-edge.

    Shapes: p_home, choice (K + 1, V, S); `candidate` (K + 1, E, S), where kept, is what each edge
    promises. A choice is the edge's place among its tail's out-edges.
    """

    p_home: NDArray
    choice: NDArray[np.uint16]
    candidate: NDArray | None = None


@dataclass(frozen=True)
class DeliveryTable:
    """Before delivery, for one worth of stopping: P(SUC) + sigma P(ABRT), P(ABRT), choices.

    Shapes as in HomeTable.
    """

    stop_worth: float
    value: NDArray
    p_abort: NDArray
    choice: NDArray[np.uint16]
    candidate: NDArray | None = None

    def p_success(self) -> NDArray:
        """P(SUC) from every state, never more than it is (thrift is counted against it)."""
        return np.maximum(self.value - self.stop_worth * self.p_abort, 0.0)


def solve_home(model: StepModel, keep_candidates: bool = False) -> HomeTable:
    """The table of the way home, flown empty."""
    worth = np.ones((model.levels + 1, model.chain.state_count), dtype=model.next_state.dtype)
    swept = _sweep(model, True, model.graph.depot, worth, None, keep_candidates)
    return HomeTable(
        p_home=swept.value[..., 0],
        choice=swept.choice[..., 0],
        candidate=None if swept.candidate is None else swept.candidate[..., 0],
    )


def solve_delivery(
    model: StepModel,
    home: HomeTable,
    stop_worths: NDArray[np.float64],
    keep_candidates: bool = False,
) -> list[DeliveryTable]:
    """The tables of the way out for each worth of stopping (0 to 1), in one sweep."""
    worth = home.p_home[:, model.graph.target, :]
    swept = _sweep(model, False, model.graph.target, worth, stop_worths, keep_candidates)
    count = len(stop_worths)
    return [
        DeliveryTable(
            stop_worth=float(stop_worths[w]),
            value=swept.value[..., w],
            p_abort=swept.value[..., count + w],
            choice=swept.choice[..., w],
            candidate=None if swept.candidate is None else swept.candidate[..., w],
        )
        for w in range(count)
    ]


@dataclass(frozen=True)
class _Swept:
    value: NDArray  # (K + 1, V, S, weights, and as many again for P(ABRT))
    choice: NDArray[np.uint16]
    candidate: NDArray | None


class _DelayLines:
    """For each usable (edge, state) the worths of the last `cost` levels, in one flat array."""

    def __init__(self, cost: NDArray[np.int32], width: int, dtype: np.dtype) -> None:
        self.row = np.flatnonzero(cost.ravel() < NEVER)
        self._cost = cost.ravel()[self.row].astype(np.int64)
        self._begin = np.concatenate([[0], np.cumsum(self._cost)])
        self._slot = self._begin[:-1].copy()
        self._end = self._begin[1:]
        self._memory = np.zeros((int(self._begin[-1]), width), dtype=dtype)

    def read(self, into: NDArray) -> None:
        """Write what each row was worth `cost` levels below into `into` (rows, width)."""
        into[self.row] = self._memory[self._slot]

    def write(self, worth: NDArray) -> None:
        """Store this level's worth (rows, width) and step to the next level."""
        self._memory[self._slot] = worth[self.row] if len(self.row) < len(worth) else worth
        self._slot += 1
        np.copyto(self._slot, self._begin[:-1], where=self._slot == self._end)


def _sweep(
    model: StepModel,
    empty: bool,
    goal: int,
    goal_worth: NDArray,
    stop_worths: NDArray[np.float64] | None,
    keep_candidates: bool,
) -> _Swept:
    graph, dtype = model.graph, model.next_state.dtype
    cost = model.cost_levels[int(empty)]
    edges, states = cost.shape
    levels, vertices = model.levels, graph.vertex_count
    worths = np.ones(1) if stop_worths is None else np.asarray(stop_worths, dtype=float)
    weights = len(worths)
    width = weights if stop_worths is None else 2 * weights
    thrift = _thrift(model, cost, stop_worths).astype(dtype)

    value = np.zeros((levels + 1, vertices, states, width), dtype=dtype)
    choice = np.full((levels + 1, vertices, states, weights), LOSS_NOTHING_HELPS, dtype=np.uint16)
    kept = np.zeros((levels + 1, edges, states, weights), dtype=dtype) if keep_candidates else None
    lines = _DelayLines(cost, width, dtype)
    candidate = np.zeros((edges * states, width), dtype=dtype)
    by_edge = candidate.reshape(edges, states, width)
    flown = np.flatnonzero(np.diff(graph.out_start) > 0)
    first = graph.out_start[flown]
    degree = np.diff(graph.out_start)[flown]
    group = np.repeat(np.arange(len(flown)), degree)
    place = (np.arange(edges) - first[group]).astype(np.uint16)[:, None, None]

    for k in range(levels + 1):
        lines.read(candidate)
        if len(flown):
            worth = by_edge[..., :weights] - thrift
            best = np.maximum.reduceat(worth, first, axis=0)
            chosen = np.where(worth == best[group], place, np.uint16(LOSS_NOTHING_HELPS))
            chosen = np.minimum.reduceat(chosen, first, axis=0)
            hopeless = best <= 0.0
            chosen[hopeless] = LOSS_NOTHING_HELPS
            best[hopeless] = 0.0
            value[k, flown, :, :weights] = best
            choice[k, flown] = chosen
            if width > weights:
                edge = first[:, None, None] + np.where(hopeless, 0, chosen)
                aborts = by_edge[
                    edge, np.arange(states)[:, None], weights + np.arange(weights)
                ]
                value[k, flown, :, weights:] = np.where(hopeless, 0.0, aborts)
            if kept is not None:
                kept[k] = worth
        if stop_worths is not None:
            _allow_stop(value[k, graph.depot], choice[k, graph.depot], worths.astype(dtype))
        value[k, goal, :, :weights] = goal_worth[k][:, None]
        value[k, goal, :, weights:] = 0.0
        lines.write(np.matmul(model.next_state, value[k, graph.head]).reshape(-1, width))
    return _Swept(value, choice, kept)


def _thrift(model: StepModel, cost: NDArray[np.int32], stop_worths: NDArray | None) -> NDArray:
    """What an edge's energy counts against it, (E, S, weights); less where success counts less."""
    share = np.where(cost < NEVER, cost, 0)[..., None] / model.levels
    if stop_worths is None:
        return THRIFT * share
    return np.minimum(THRIFT, 0.01 * (1.0 - np.asarray(stop_worths))) * share


def _allow_stop(value: NDArray, choice: NDArray, worths: NDArray) -> None:
    """At the depot (S, width), stay where that is worth at least as much as any edge."""
    weights = len(worths)
    stays = value[:, :weights] <= worths
    value[:, :weights] = np.where(stays, worths, value[:, :weights])
    value[:, weights:] = np.where(stays, 1.0, value[:, weights:])
    choice[stays] = STOP
