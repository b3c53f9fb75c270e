"""The best that can be done from every (vertex, wind state, energy left): dynamic programming.

A mission has two phases. Once delivered, the best policy maximises P(home), whatever the loss is
worth. Before, with failure worth 0, success 1 and a safe stop at the depot worth sigma, the best
policy maximises P(SUC) + sigma P(ABRT). With the Lagrange weight c on the loss ,
P(SUC) - c P(loss) = (1 + c) (P(SUC) + sigma P(ABRT)) - c where sigma = c / (1 + c): the same.

The sweep goes up the energy levels once. Each (edge, state) owns a delay line as long as its cost
in levels: what was worth W at level k is a candidate for its tail at level k + cost. Memory is the
sum of the costs, not levels x edges, and every access is to one slot (plain numpy, no compiler).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, ShortInts
from sim_bridge.research.planners.edge_transitions import NEVER, StepModel

LOSS_NOTHING_HELPS = 65535  # a choice: no edge promises anything here
STOP = 65534  # a choice: stay at the depot

# What the whole budget is worth, at most: breaks ties between equally promising edges towards the
# cheaper one. Smaller than any loss that is asked for, larger than float32 can blur.
THRIFT = 2e-5
THRIFT_PER_SUCCESS = 0.002  # and no more than this share of what success counts over stopping


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
    sweep = _Sweep(model, True, model.graph.depot, worth, None)
    swept = sweep.run(choices=True, candidates=keep_candidates)
    return HomeTable(
        p_home=swept.value[..., 0],
        choice=swept.choice[..., 0],
        candidate=None if swept.candidate is None else swept.candidate[..., 0],
    )


def home_worth(model: StepModel) -> NDArray:
    """P(home) at the target alone, (K + 1, S): all that the way out needs; cheaper."""
    worth = np.ones((model.levels + 1, model.chain.state_count), dtype=model.next_state.dtype)
    sweep = _Sweep(model, True, model.graph.depot, worth, None)
    return sweep.run(choices=False, watch=model.graph.target).value[..., 0]


def delivery_worths(model: StepModel, worth_at_target: NDArray, stop_worths: Floats) -> Floats:
    """What the mission is worth from the depot for each worth of stopping; shape (weights,)."""
    goal = model.graph.target
    sweep = _Sweep(model, False, goal, worth_at_target, stop_worths)
    value = sweep.run(choices=False, watch=model.graph.depot).value
    return model.chain.initial @ value[-1].astype(np.float64)


def solve_delivery(
    model: StepModel,
    home: HomeTable,
    stop_worths: Floats,
    keep_candidates: bool = False,
) -> list[DeliveryTable]:
    """The tables of the way out for each worth of stopping (0 to 1), in one sweep."""
    goal = model.graph.target
    sweep = _Sweep(model, False, goal, home.p_home[:, goal], stop_worths)
    swept = sweep.run(choices=True, candidates=keep_candidates)
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
    value: NDArray  # (K + 1, V, S, weights and as many again for P(ABRT)), or without V: watched
    choice: NDArray[np.uint16]
    candidate: NDArray | None


class _DelayLines:
    """For each usable (edge, state) its worths until they are due, in one flat array.

    A cost between two whole numbers of levels draws on the worths of two neighbouring levels.
    """

    def __init__(self, cost: ShortInts, upper_share: NDArray, width: int, dtype: np.dtype) -> None:
        self.row = np.flatnonzero(cost.ravel() < NEVER)
        self._all = len(self.row) == cost.size
        whole = cost.ravel()[self.row].astype(np.int64)
        share = upper_share.ravel()[self.row].astype(dtype)
        self._mixes = bool((share < 1.0).any())
        # Mixed with the level above, the worth of the level before is due one level sooner.
        delay = np.where(whole > 1, whole - 1, 1) if self._mixes else whole
        self._before = np.where(whole > 1, share, 0.0).astype(dtype)[:, None]
        self._now = (1.0 - self._before).astype(dtype)
        ends = np.cumsum(delay)
        self._begin, self._end = ends - delay, ends
        self._slot = self._begin.copy()
        self._memory = np.zeros((int(delay.sum()), width), dtype=dtype)
        self._last = np.zeros((len(self.row), width), dtype=dtype)

    def read(self, into: NDArray) -> None:
        """Write what each row is worth now into `into` (rows, width)."""
        if self._all:
            np.take(self._memory, self._slot, axis=0, out=into)
        else:
            into[self.row] = self._memory[self._slot]

    def write(self, worth: NDArray) -> None:
        """Store this level's worth (rows, width) and step to the next level."""
        usable = worth if self._all else worth[self.row]
        due = usable
        if self._mixes:
            due = self._last
            due *= self._before
            due += self._now * usable
        self._memory[self._slot] = due
        self._last = usable
        self._slot += 1
        np.copyto(self._slot, self._begin, where=self._slot == self._end)


class _Sweep:
    """One phase of the mission, level by level."""

    def __init__(
        self,
        model: StepModel,
        empty: bool,
        goal: int,
        goal_worth: NDArray,
        stop_worths: Floats | None,
    ) -> None:
        graph = model.graph
        self._model, self._goal, self._goal_worth = model, goal, goal_worth
        self._cost = model.cost_levels[int(empty)]
        self._share = model.upper_share[int(empty)]
        self._dtype = model.next_state.dtype
        self._stops = stop_worths is not None
        self._worths = np.ones(1) if stop_worths is None else np.asarray(stop_worths, dtype=float)
        self._thrift = self._thrift_of(model.energy_wh[int(empty)])
        degree = np.diff(graph.out_start)
        self._flown = np.flatnonzero(degree > 0)
        self._first = graph.out_start[self._flown]
        self._group = np.repeat(np.arange(len(self._flown)), degree[self._flown])
        place = np.arange(graph.edge_count) - self._first[self._group]
        self._place = place.astype(np.uint16)[:, None, None]

    def _thrift_of(self, energy_wh: NDArray) -> NDArray:
        """What an edge's energy counts against it, (E, S, weights)."""
        usable = self._cost < NEVER
        budget = self._model.budget_wh or 1.0
        share = np.where(usable, np.where(usable, energy_wh, 0.0) / budget, 0.0)[..., None]
        most = np.full(len(self._worths), THRIFT)
        if self._stops:
            most = np.minimum(most, THRIFT_PER_SUCCESS * (1.0 - self._worths))
        return (most * share).astype(self._dtype)

    def run(self, choices: bool, candidates: bool = False, watch: int | None = None) -> _Swept:
        """Go up the levels; with `watch` only that vertex's worths are kept."""
        model, graph = self._model, self._model.graph
        edges, states = self._cost.shape
        weights = len(self._worths)
        splits = choices and self._stops
        width = 2 * weights if splits else weights
        shape = (model.levels + 1, graph.vertex_count, states)
        kept = (model.levels + 1, states) if watch is not None else shape
        value = np.zeros((*kept, width), dtype=self._dtype)
        choice = np.full((*shape, weights) if choices else (0,), LOSS_NOTHING_HELPS, np.uint16)
        promised = None
        if candidates:
            promised = np.zeros((model.levels + 1, edges, states, weights), dtype=self._dtype)
        lines = _DelayLines(self._cost, self._share, width, self._dtype)
        candidate = np.zeros((edges * states, width), dtype=self._dtype)
        by_edge = candidate.reshape(edges, states, width)
        for k in range(model.levels + 1):
            now = (
                np.zeros((*shape[1:], width), dtype=self._dtype) if watch is not None else value[k]
            )
            lines.read(candidate)
            by_edge[..., :weights] -= self._thrift
            if len(self._flown):
                best = np.maximum.reduceat(by_edge[..., :weights], self._first, axis=0)
                np.maximum(best, 0.0, out=best)
                now[self._flown, :, :weights] = best
                if choices:
                    self._choose(by_edge, best, now, choice[k])
            if promised is not None:
                promised[k] = by_edge[..., :weights]
            if self._stops:
                self._allow_stop(now[graph.depot], choice[k, graph.depot] if choices else None)
            now[self._goal, :, :weights] = self._goal_worth[k][:, None]
            now[self._goal, :, weights:] = 0.0
            if watch is not None:
                value[k] = now[watch]
            lines.write(np.matmul(model.next_state, now[graph.head]).reshape(-1, width))
        return _Swept(value, choice, promised)

    def _choose(self, by_edge: NDArray, best: NDArray, now: NDArray, choice: NDArray) -> None:
        """The first edge that is worth the best, and P(ABRT) by it."""
        weights = len(self._worths)
        is_best = by_edge[..., :weights] == best[self._group]
        chosen = np.where(is_best, self._place, np.uint16(LOSS_NOTHING_HELPS))
        chosen = np.minimum.reduceat(chosen, self._first, axis=0)
        hopeless = best <= 0.0
        chosen[hopeless] = LOSS_NOTHING_HELPS
        choice[self._flown] = chosen
        if by_edge.shape[2] > weights:
            edge = self._first[:, None, None] + np.where(hopeless, 0, chosen)
            states = np.arange(by_edge.shape[1])[:, None]
            aborts = by_edge[edge, states, weights + np.arange(weights)]
            now[self._flown, :, weights:] = np.where(hopeless, 0.0, aborts)

    def _allow_stop(self, value: NDArray, choice: NDArray | None) -> None:
        """At the depot (S, width), stay where that is worth at least as much as any edge."""
        weights = len(self._worths)
        worths = self._worths.astype(self._dtype)
        stays = value[:, :weights] <= worths
        value[:, :weights] = np.where(stays, worths, value[:, :weights])
        if choice is not None:
            value[:, weights:] = np.where(stays, 1.0, value[:, weights:])
            choice[stays] = STOP
