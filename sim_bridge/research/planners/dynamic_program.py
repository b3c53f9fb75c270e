"""Dynamic program: the best value from every (vertex, wind state, energy left).

A mission has two phases. After delivery, the best policy maximises P(home), for any weight of the
loss. Before delivery, failure has value 0, success 1 and a stop at the depot sigma; the best policy
maximises P(SUC) + sigma P(ABRT). With the Lagrange weight c on the loss,
P(SUC) - c P(loss) = (1 + c) (P(SUC) + sigma P(ABRT)) - c where sigma = c / (1 + c): same optimum.

The sweep visits the energy levels once in ascending order. Each (edge, state) has a delay line as
long as its cost in levels: value W at level k is a candidate for its tail at level k + cost. Memory
is the sum of the costs, not levels x edges. Every access is to one slot (numpy, no compiler).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, ShortInts
from sim_bridge.research.planners.edge_transitions import INFEASIBLE_LEVELS, EdgeTransitionModel

NO_VALUE = 65535  # choice code: every edge has value 0 here
STOP = 65534  # choice code: stay at the depot

# Largest penalty, for an edge that uses the whole budget. Breaks ties between edges of equal value
# in favour of the cheaper one. Smaller than any loss bound in use, larger than float32 rounding.
MAX_ENERGY_PENALTY = 2e-5
MAX_PENALTY_PER_SUCCESS = 0.002  # limit as a share of the value of success above that of stopping


@dataclass(frozen=True)
class HomeTable:
    """After delivery: P(home) under the best policy, and its choice of out-edge.

    Shapes: p_home, choice (K + 1, V, S). `candidate` (K + 1, E, S), if stored, is the value of each
    edge. A choice is the edge's slot among its tail's out-edges.
    """

    p_home: NDArray
    choice: NDArray[np.uint16]
    candidate: NDArray | None = None


@dataclass(frozen=True)
class DeliveryTable:
    """Before delivery, for one stop value: P(SUC) + sigma P(ABRT), P(ABRT), choices.

    Shapes as in HomeTable.
    """

    stop_value: float
    value: NDArray
    p_abort: NDArray
    choice: NDArray[np.uint16]
    candidate: NDArray | None = None

    def p_success_lower_bound(self) -> NDArray:
        """Return a lower bound of P(SUC) from every state (the energy penalty is included)."""
        return np.maximum(self.value - self.stop_value * self.p_abort, 0.0)


def solve_return_table(model: EdgeTransitionModel, keep_candidates: bool = False) -> HomeTable:
    """Solve the return flight, flown empty."""
    values = np.ones((model.levels + 1, model.chain.state_count), dtype=model.next_state.dtype)
    sweep = _Sweep(model, True, model.graph.depot, values, None)
    result = sweep.sweep_energy_levels(with_choices=True, with_candidates=keep_candidates)
    return HomeTable(
        p_home=result.value[..., 0],
        choice=result.choice[..., 0],
        candidate=None if result.candidate is None else result.candidate[..., 0],
    )


def p_home_at_target_by_level(model: EdgeTransitionModel) -> NDArray:
    """Return P(home) at the target alone, (K + 1, S): sufficient for the outbound, and cheaper."""
    values = np.ones((model.levels + 1, model.chain.state_count), dtype=model.next_state.dtype)
    sweep = _Sweep(model, True, model.graph.depot, values, None)
    return sweep.sweep_energy_levels(with_choices=False, observed_vertex=model.graph.target).value[
        ..., 0
    ]


def mission_values_from_depot(
    model: EdgeTransitionModel, p_home_at_target: NDArray, stop_values: Floats
) -> Floats:
    """Return the mission's value from the depot for each stop value; shape (weights,)."""
    goal = model.graph.target
    sweep = _Sweep(model, False, goal, p_home_at_target, stop_values)
    value = sweep.sweep_energy_levels(with_choices=False, observed_vertex=model.graph.depot).value
    return model.chain.initial @ value[-1].astype(np.float64)


def solve_delivery_tables(
    model: EdgeTransitionModel,
    return_table: HomeTable,
    stop_values: Floats,
    keep_candidates: bool = False,
) -> list[DeliveryTable]:
    """Solve the outbound tables for each stop value (0 to 1), in one sweep."""
    goal = model.graph.target
    sweep = _Sweep(model, False, goal, return_table.p_home[:, goal], stop_values)
    result = sweep.sweep_energy_levels(with_choices=True, with_candidates=keep_candidates)
    count = len(stop_values)
    return [
        DeliveryTable(
            stop_value=float(stop_values[w]),
            value=result.value[..., w],
            p_abort=result.value[..., count + w],
            choice=result.choice[..., w],
            candidate=None if result.candidate is None else result.candidate[..., w],
        )
        for w in range(count)
    ]


@dataclass(frozen=True)
class _SweepResult:
    value: NDArray  # (K + 1, V, S, weights, then P(ABRT) of each); without V for one watched vertex
    choice: NDArray[np.uint16]
    candidate: NDArray | None


class _DelayLines:
    """Delay lines of the values of each usable (edge, state), in one flat array.

    A cost between two whole numbers of levels interpolates the values of both levels.
    """

    def __init__(self, cost: ShortInts, upper_share: NDArray, width: int, dtype: np.dtype) -> None:
        self.row = np.flatnonzero(cost.ravel() < INFEASIBLE_LEVELS)
        self._all_usable = len(self.row) == cost.size
        whole = cost.ravel()[self.row].astype(np.int64)
        share = upper_share.ravel()[self.row].astype(dtype)
        self._interpolates = bool((share < 1.0).any())
        # A mix with the level above shortens the delay of the lower level's value by one.
        delay = np.where(whole > 1, whole - 1, 1) if self._interpolates else whole
        self._lower_share = np.where(whole > 1, share, 0.0).astype(dtype)[:, None]
        self._upper_share = (1.0 - self._lower_share).astype(dtype)
        ends = np.cumsum(delay)
        self._begin, self._end = ends - delay, ends
        self._slot = self._begin.copy()
        self._memory = np.zeros((int(delay.sum()), width), dtype=dtype)
        self._last = np.zeros((len(self.row), width), dtype=dtype)

    def copy_current_values_into(self, output: NDArray) -> None:
        """Write each row's current value into `output` (rows, width)."""
        if self._all_usable:
            np.take(self._memory, self._slot, axis=0, out=output)
        else:
            output[self.row] = self._memory[self._slot]

    def store_level_and_advance(self, values: NDArray) -> None:
        """Store this level's values (rows, width) and advance one level."""
        usable = values if self._all_usable else values[self.row]
        due = usable
        if self._interpolates:
            due = self._last
            due *= self._lower_share
            due += self._upper_share * usable
        self._memory[self._slot] = due
        self._last = usable
        self._slot += 1
        np.copyto(self._slot, self._begin, where=self._slot == self._end)


class _Sweep:
    """Backward induction of one mission phase, by ascending energy level."""

    def __init__(
        self,
        model: EdgeTransitionModel,
        empty: bool,
        goal: int,
        goal_values: NDArray,
        stop_values: Floats | None,
    ) -> None:
        graph = model.graph
        self._model, self._goal, self._goal_values = model, goal, goal_values
        self._cost = model.cost_levels[int(empty)]
        self._share = model.upper_share[int(empty)]
        self._dtype = model.next_state.dtype
        self._can_stop = stop_values is not None
        self._stop_values = (
            np.ones(1) if stop_values is None else np.asarray(stop_values, dtype=float)
        )
        self._energy_penalty = self._compute_energy_penalty(model.energy_wh[int(empty)])
        edge_counts = np.diff(graph.out_edge_start_by_vertex)
        self._tail_vertices = np.flatnonzero(edge_counts > 0)
        self._first_edge = graph.out_edge_start_by_vertex[self._tail_vertices]
        self._tail_index = np.repeat(
            np.arange(len(self._tail_vertices)), edge_counts[self._tail_vertices]
        )
        slot_index = np.arange(graph.edge_count) - self._first_edge[self._tail_index]
        self._edge_slot = slot_index.astype(np.uint16)[:, None, None]

    def _compute_energy_penalty(self, energy_wh: NDArray) -> NDArray:
        """Return the tie-breaking penalty of each edge's energy, (E, S, weights)."""
        usable = self._cost < INFEASIBLE_LEVELS
        budget = self._model.budget_wh or 1.0
        share = np.where(usable, np.where(usable, energy_wh, 0.0) / budget, 0.0)[..., None]
        max_penalty = np.full(len(self._stop_values), MAX_ENERGY_PENALTY)
        if self._can_stop:
            max_penalty = np.minimum(
                max_penalty, MAX_PENALTY_PER_SUCCESS * (1.0 - self._stop_values)
            )
        return (max_penalty * share).astype(self._dtype)

    def sweep_energy_levels(
        self, with_choices: bool, with_candidates: bool = False, observed_vertex: int | None = None
    ) -> _SweepResult:
        """Sweep all levels. With `observed_vertex` only the values of that vertex are stored."""
        model, graph = self._model, self._model.graph
        edges, states = self._cost.shape
        weights = len(self._stop_values)
        splits = with_choices and self._can_stop
        width = 2 * weights if splits else weights
        shape = (model.levels + 1, graph.vertex_count, states)
        stored_shape = (model.levels + 1, states) if observed_vertex is not None else shape
        value = np.zeros((*stored_shape, width), dtype=self._dtype)
        choice = np.full((*shape, weights) if with_choices else (0,), NO_VALUE, np.uint16)
        edge_values = None
        if with_candidates:
            edge_values = np.zeros((model.levels + 1, edges, states, weights), dtype=self._dtype)
        lines = _DelayLines(self._cost, self._share, width, self._dtype)
        candidate = np.zeros((edges * states, width), dtype=self._dtype)
        by_edge = candidate.reshape(edges, states, width)
        for k in range(model.levels + 1):
            now = (
                np.zeros((*shape[1:], width), dtype=self._dtype)
                if observed_vertex is not None
                else value[k]
            )
            lines.copy_current_values_into(candidate)
            by_edge[..., :weights] -= self._energy_penalty
            if len(self._tail_vertices):
                best = np.maximum.reduceat(by_edge[..., :weights], self._first_edge, axis=0)
                np.maximum(best, 0.0, out=best)
                now[self._tail_vertices, :, :weights] = best
                if with_choices:
                    self._store_best_choices_in_place(by_edge, best, now, choice[k])
            if edge_values is not None:
                edge_values[k] = by_edge[..., :weights]
            if self._can_stop:
                self._apply_depot_stop_in_place(
                    now[graph.depot], choice[k, graph.depot] if with_choices else None
                )
            now[self._goal, :, :weights] = self._goal_values[k][:, None]
            now[self._goal, :, weights:] = 0.0
            if observed_vertex is not None:
                value[k] = now[observed_vertex]
            lines.store_level_and_advance(
                np.matmul(model.next_state, now[graph.head]).reshape(-1, width)
            )
        return _SweepResult(value, choice, edge_values)

    def _store_best_choices_in_place(
        self, by_edge: NDArray, best: NDArray, now: NDArray, choice: NDArray
    ) -> None:
        """Store the first edge of greatest value, and P(ABRT) along it."""
        weights = len(self._stop_values)
        is_best = by_edge[..., :weights] == best[self._tail_index]
        selected = np.where(is_best, self._edge_slot, np.uint16(NO_VALUE))
        selected = np.minimum.reduceat(selected, self._first_edge, axis=0)
        no_value = best <= 0.0
        selected[no_value] = NO_VALUE
        choice[self._tail_vertices] = selected
        if by_edge.shape[2] > weights:
            edge = self._first_edge[:, None, None] + np.where(no_value, 0, selected)
            states = np.arange(by_edge.shape[1])[:, None]
            aborts = by_edge[edge, states, weights + np.arange(weights)]
            now[self._tail_vertices, :, weights:] = np.where(no_value, 0.0, aborts)

    def _apply_depot_stop_in_place(self, value: NDArray, choice: NDArray | None) -> None:
        """At the depot (S, width), stay where stopping has at least the value of any edge."""
        weights = len(self._stop_values)
        stop_row = self._stop_values.astype(self._dtype)
        stays = value[:, :weights] <= stop_row
        value[:, :weights] = np.where(stays, stop_row, value[:, :weights])
        if choice is not None:
            value[:, weights:] = np.where(stays, 1.0, value[:, weights:])
            choice[stays] = STOP
