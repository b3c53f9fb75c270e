"""Simulated annealing over the order of visits: one truck, one drone, each node visited once.

The cost of an order is that of its best split into operations, by a dynamic programme (Agatz,
Bouman and Schmidt, Transportation Science 52, 2018, "exact partitioning"). One move of the order
can change many operations at once, unlike a move of a chain of operations (`operation_search`);
only the chain allows second visits and loops.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled, compiled_inner
from ground_station.core.truck_drones.operation_plan import (
    AnnealingSearch,
    Operation,
    build_short_tour,
    nearest_nodes_by_node,
    total_cost_of_operations,
    with_depot_copy,
)
from ground_station.core.truck_drones.random_stream import (
    draw_integer_below,
    draw_uniform,
    seeded_stream_from_generator,
)
from ground_station.core.truck_drones.tuple_reference import passed_by_reference

MAX_OPERATION_LENGTH = 25
"""Maximum length of an operation, in legs along the order."""


@passed_by_reference
class SplitOrder(NamedTuple):
    """A visit order from node 0 to its copy, and its best split into operations, by position."""

    order: NDArray[np.int64]
    """Nodes."""
    cumulative_cost: NDArray[np.float64]
    """Cost of driving along the order up to this position."""
    saved: NDArray[np.float64]
    """Driving cost saved if the truck skips only this position."""
    cost: NDArray[np.float64]
    """Least cost of serving all up to this position with both vehicles here at the end."""
    start: NDArray[np.int64]
    """Start position of the last operation of that plan."""
    flown: NDArray[np.int64]
    """Position that the drone serves in that operation; -1: none."""


def create_uncomputed_split(order: NDArray[np.int64]) -> SplitOrder:
    """Return an order without a computed split."""
    position_count = len(order)
    return SplitOrder(
        order.copy(),
        cumulative_cost=np.zeros(position_count),
        saved=np.zeros(position_count),
        cost=np.zeros(position_count),
        start=np.zeros(position_count, dtype=np.int64),
        flown=np.zeros(position_count, dtype=np.int64),
    )


@compiled
def update_best_split_cost(drive, fly, split, first_changed_index):
    """Return the cost of the best split, valid before position `first_changed_index`."""
    order, cumulative, saved, cost = split.order, split.cumulative_cost, split.saved, split.cost
    end = len(order) - 1
    for at in range(max(first_changed_index, 1), end + 1):
        cumulative[at] = cumulative[at - 1] + drive[order[at - 1], order[at]]
    for at in range(max(first_changed_index - 1, 1), end):
        saved[at] = cumulative[at + 1] - cumulative[at - 1] - drive[order[at - 1], order[at + 1]]
    for stop in range(max(first_changed_index, 1), end + 1):
        least = cost[stop - 1] + cumulative[stop] - cumulative[stop - 1]
        from_position, flown = stop - 1, -1
        node = order[stop]
        most_saved = -np.inf
        for start in range(stop - 2, max(stop - MAX_OPERATION_LENGTH, 0) - 1, -1):
            most_saved = max(most_saved, saved[start + 1])
            allowed = least - cost[start]
            driven = cumulative[stop] - cumulative[start]
            if driven - most_saved >= allowed:
                continue
            origin = order[start]
            for at in range(start + 1, stop):
                operation_cost = max(
                    fly[origin, order[at]] + fly[order[at], node], driven - saved[at]
                )
                if operation_cost < allowed:
                    allowed = operation_cost
                    least = cost[start] + operation_cost
                    from_position, flown = start, at
        cost[stop], split.start[stop], split.flown[stop] = least, from_position, flown
    return cost[end]


@compiled_inner
def _write_moved_order(order, new_order, first, last, to, is_reversed):
    """Write to `new_order` the order with positions first .. last moved to after `to`, outside of
    them; `is_reversed`: reversed. Returns the first and the last changed position.
    """
    count = last - first + 1
    if to > last:
        low, high, begin = first, to, to - count + 1
        for at in range(last + 1, to + 1):
            new_order[at - count] = order[at]
    else:
        low, high, begin = to + 1, last, to + 1
        for at in range(to + 1, first):
            new_order[at + count] = order[at]
    for at in range(count):
        new_order[begin + at] = order[last - at] if is_reversed else order[first + at]
    return low, high


@compiled_inner
def _write_random_order_change(split, order_index_by_node, near, new_order, stream):
    """Write a random change of the order to `new_order`. Returns the first and last changed
    position (last before first: no change). Only these positions of `new_order` are written.
    """
    old = split.order
    end = len(old) - 1
    at = 1 + draw_integer_below(stream, end - 1)
    drawn = draw_uniform(stream)
    to = order_index_by_node[near[old[at], int(drawn * drawn * near.shape[1])]]
    if to == 0 and draw_integer_below(stream, 2):
        to = end
    drawn = draw_uniform(stream)
    if drawn < 0.4:
        last = at if drawn < 0.25 else min(at + 1 + draw_integer_below(stream, 2), end - 1)
        to = min(to - draw_integer_below(stream, 2), end - 1)
        if at - 1 <= to <= last or to < 0:
            return 1, 0
        return _write_moved_order(old, new_order, at, last, to, draw_integer_below(stream, 2) > 0)
    if drawn < 0.7:
        if to == 0 or to == end:
            return 1, 0
        low, high = min(at, to), max(at, to)
        for step in range(low, high + 1):
            new_order[step] = old[step]
        new_order[low], new_order[high] = old[high], old[low]
        return low, high
    # Reverse to join the two nodes, on either side of `at`.
    low, high = min(at, to), max(at, to)
    if drawn < 0.85:
        low += 1
    else:
        high -= 1
    low, high = max(low, 1), min(high, end - 1)
    for step in range(low, high + 1):
        new_order[step] = old[high + low - step]
    return low, high


@compiled_inner
def _copy_split(split, target_split, first, last):
    """Copy these positions of the order, and all other fields from the first on."""
    for at in range(first, last + 1):
        target_split.order[at] = split.order[at]
    for at in range(max(first - 1, 0), len(split.order)):
        target_split.cumulative_cost[at], target_split.saved[at], target_split.cost[at] = (
            split.cumulative_cost[at],
            split.saved[at],
            split.cost[at],
        )


@compiled
def anneal_order_in_place(
    drive,
    fly,
    near,
    split,
    candidate_split,
    order_index_by_node,
    best,
    costs,
    stream,
    trials,
    start_temperature,
    end_temperature,
):
    """Try `trials` changes, temperature from `start_temperature` to `end_temperature`, units of
    cost.

    `candidate_split` equals `split` before and after. Changes these, `order_index_by_node`, `best`
    and `costs` (of the order and of the best one).
    """
    cooling = (end_temperature / start_temperature) ** (1.0 / trials)
    temperature = start_temperature
    for _ in range(trials):
        temperature *= cooling
        first, last = _write_random_order_change(
            split, order_index_by_node, near, candidate_split.order, stream
        )
        if first >= last:
            continue
        cost = update_best_split_cost(drive, fly, candidate_split, first)
        if cost - costs[0] > -temperature * math.log(1.0 - draw_uniform(stream)):
            _copy_split(split, candidate_split, first, last)
            continue
        _copy_split(candidate_split, split, first, last)
        for at in range(first, last + 1):
            order_index_by_node[split.order[at]] = at
        costs[0] = cost
        if cost < costs[1] - 1e-9:
            costs[1] = cost
            for at in range(len(best)):
                best[at] = split.order[at]


class OrderSearch(AnnealingSearch):
    """A resumable search: `run_trials` repeatedly; `best_operations` is always valid."""

    step_trials = 50_000
    start_temperature_frac, end_temperature_frac = 0.3, 0.02

    def __init__(
        self,
        drive: NDArray[np.float64],
        fly: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> None:
        """`drive`, `fly`: costs between nodes, (n, n), symmetric; node 0 is the depot."""
        self._drive, self._fly, self._rng = drive, fly, rng
        self._costs_of = with_depot_copy(drive), with_depot_copy(fly)
        self._near = nearest_nodes_by_node(drive)
        tour = build_short_tour(drive)
        self.mean_leg = float(self._costs_of[0][tour[:-1], tour[1:]].mean())
        self._best = tour.copy()
        self._costs = np.full(2, np.inf)
        self._stream = seeded_stream_from_generator(rng)
        self._begin_from_order(tour)

    def _begin_from_order(self, order: NDArray[np.int64]) -> None:
        """Continue from this order."""
        self.current, self._new = create_uncomputed_split(order), create_uncomputed_split(order)
        update_best_split_cost(*self._costs_of, self._new, 0)
        cost = float(update_best_split_cost(*self._costs_of, self.current, 0))
        self._position = np.argsort(order).astype(np.int64)
        self._costs[0] = cost
        if cost < self._costs[1]:
            self._costs[1] = cost
            self._best[:] = order

    def begin_from_random_order(self) -> None:
        """Continue from a random order; keep the best order found."""
        end = len(self._drive)
        middle = 1 + self._rng.permutation(end - 1)
        self._begin_from_order(np.array([0, *middle, end], dtype=np.int64))

    @property
    def best_cost(self) -> float:
        """Cost of the best plan found, recomputed."""
        return total_cost_of_operations(self._drive, self._fly, self.best_operations())

    def run_trials(self, trials: int, schedule_from_frac: float, schedule_to_frac: float) -> None:
        """Run trials, cooling over this part of the schedule (0: its start, 1: its end)."""
        anneal_order_in_place(
            *self._costs_of,
            self._near,
            self.current,
            self._new,
            self._position,
            self._best,
            self._costs,
            self._stream,
            trials,
            self.temperature_at(schedule_from_frac),
            self.temperature_at(schedule_to_frac),
        )

    def best_operations(self) -> list[Operation]:
        """Return the best plan found."""
        split = create_uncomputed_split(self._best)
        update_best_split_cost(*self._costs_of, split, 0)
        return operations_of_split(split)


def operations_of_split(split: SplitOrder) -> list[Operation]:
    """Return the operations of a split order, from depot to depot."""
    end = len(split.order) - 1
    nodes = [*(int(node) for node in split.order[:-1]), 0]
    found: list[Operation] = []
    stop = end
    while stop > 0:
        start, flown = int(split.start[stop]), int(split.flown[stop])
        between = tuple(nodes[at] for at in range(start + 1, stop) if at != flown)
        fly = nodes[flown] if flown >= 0 else None
        found.append(Operation(nodes[start], nodes[stop], fly, between))
        stop = start
    return found[::-1]
