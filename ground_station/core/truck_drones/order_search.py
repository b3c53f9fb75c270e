"""Simulated annealing over the order of visits: one truck, one drone, each node visited once.

An order is worth what its best split into operations costs, which a dynamic programme finds (Agatz,
Bouman and Schmidt, Transportation Science 52, 2018, "exact partitioning"). One move of the order
may so change many operations at once, which no single move of a chain of operations does
(`operation_search`); the chain alone knows second visits and loops.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.operation_plan import (
    CooledSearch,
    Operation,
    near_nodes,
    plan_cost,
    short_tour,
    with_copy,
)
from ground_station.core.truck_drones.random_stream import below, random_stream, uniform


@dataclass(frozen=True, slots=True)
class OrderParams:
    """Temperatures as shares of a short tour's mean leg; a round cools from hot to cold."""

    hot_legs: float = 0.3
    cold_legs: float = 0.02
    step_trials: int = 50_000
    most_legs: int = 25
    """Of one operation, counted along the order; longer ones are not looked for."""


class Split(NamedTuple):
    """An order from node 0 to its copy, and its best split into operations. All by place."""

    order: NDArray[np.int32]
    """Nodes."""
    along: NDArray[np.float64]
    """Cost of driving through the order up to here."""
    saved: NDArray[np.float64]
    """Cost of driving that is saved where the truck leaves out this place alone."""
    cost: NDArray[np.float64]
    """Least cost of serving all up to here and being both here."""
    start: NDArray[np.int32]
    """The place where the last operation of that plan starts."""
    flown: NDArray[np.int32]
    """The place that the drone serves in it; -1: none."""


def new_split(order: NDArray[np.int32]) -> Split:
    """An order that is not split yet."""
    places = len(order)
    return Split(
        order.copy(),
        along=np.zeros(places),
        saved=np.zeros(places),
        cost=np.zeros(places),
        start=np.zeros(places, dtype=np.int32),
        flown=np.zeros(places, dtype=np.int32),
    )


@compiled
def split_order(drive, fly, s, first, most_legs):
    """The cost of the best split of the order, which is split right before the place `first`."""
    order, along, saved, cost = s.order, s.along, s.saved, s.cost
    end = len(order) - 1
    for at in range(max(first, 1), end + 1):
        along[at] = along[at - 1] + drive[order[at - 1], order[at]]
    for at in range(max(first - 1, 1), end):
        saved[at] = along[at + 1] - along[at - 1] - drive[order[at - 1], order[at + 1]]
    for stop in range(max(first, 1), end + 1):
        least = cost[stop - 1] + along[stop] - along[stop - 1]
        from_place, flown = stop - 1, -1
        node = order[stop]
        most_saved = -np.inf
        for start in range(stop - 2, max(stop - most_legs, 0) - 1, -1):
            most_saved = max(most_saved, saved[start + 1])
            allowed = least - cost[start]
            driven = along[stop] - along[start]
            if driven - most_saved >= allowed:
                continue
            origin = order[start]
            for at in range(start + 1, stop):
                longer = max(fly[origin, order[at]] + fly[order[at], node], driven - saved[at])
                if longer < allowed:
                    allowed = longer
                    least = cost[start] + longer
                    from_place, flown = start, at
        cost[stop], s.start[stop], s.flown[stop] = least, from_place, flown
    return cost[end]


@compiled
def _move(old, new, first, last, to, back):
    """Write the order into `new` with the places first .. last right behind `to`, outside of them;
    `back`: reversed. The first and the last changed place.
    """
    count = last - first + 1
    if to > last:
        low, high, begin = first, to, to - count + 1
        for at in range(last + 1, to + 1):
            new[at - count] = old[at]
    else:
        low, high, begin = to + 1, last, to + 1
        for at in range(to + 1, first):
            new[at + count] = old[at]
    for at in range(count):
        new[begin + at] = old[last - at] if back else old[first + at]
    return low, high


@compiled
def _change(s, place, near, new, stream):
    """Write a random change of the order into `new`: its first and last place, the last before the
    first where it is none. Of `new` only these are written.
    """
    old = s.order
    end = len(old) - 1
    at = 1 + below(stream, end - 1)
    drawn = uniform(stream)
    to = place[near[old[at], int(drawn * drawn * near.shape[1])]]
    if to == 0 and below(stream, 2):
        to = end
    drawn = uniform(stream)
    if drawn < 0.4:
        last = at if drawn < 0.25 else min(at + 1 + below(stream, 2), end - 1)
        to = min(to - below(stream, 2), end - 1)
        if at - 1 <= to <= last or to < 0:
            return 1, 0
        return _move(old, new, at, last, to, below(stream, 2) > 0)
    if drawn < 0.7:
        if to == 0 or to == end:
            return 1, 0
        low, high = min(at, to), max(at, to)
        for step in range(low, high + 1):
            new[step] = old[step]
        new[low], new[high] = old[high], old[low]
        return low, high
    # Reversed so that the two meet, on one side of `at` or on the other.
    low, high = min(at, to), max(at, to)
    if drawn < 0.85:
        low += 1
    else:
        high -= 1
    low, high = max(low, 1), min(high, end - 1)
    for step in range(low, high + 1):
        new[step] = old[high + low - step]
    return low, high


@compiled
def _copy(s, to, first, last):
    """Copy these places of the order, and all else from the first on."""
    for at in range(first, last + 1):
        to.order[at] = s.order[at]
    for at in range(max(first - 1, 0), len(s.order)):
        to.along[at], to.saved[at], to.cost[at] = s.along[at], s.saved[at], s.cost[at]


@compiled
def anneal_order(drive, fly, near, s, new, place, best, costs, stream, trials, hot, cold, most):
    """Try `trials` changes while the temperature falls from `hot` to `cold`, units of cost.

    `new` equals `s` before and after. Changes these, `place` (by node), `best` and `costs` (of the
    order and of the best one).
    """
    cooling = (cold / hot) ** (1.0 / trials)
    temperature = hot
    for _ in range(trials):
        temperature *= cooling
        first, last = _change(s, place, near, new.order, stream)
        if first >= last:
            continue
        cost = split_order(drive, fly, new, first, most)
        if cost - costs[0] > -temperature * math.log(1.0 - uniform(stream)):
            _copy(s, new, first, last)
            continue
        _copy(new, s, first, last)
        for at in range(first, last + 1):
            place[s.order[at]] = at
        costs[0] = cost
        if cost < costs[1] - 1e-9:
            costs[1] = cost
            for at in range(len(best)):
                best[at] = s.order[at]


class OrderSearch(CooledSearch):
    """A search under way: `step` as often as wanted; `best` is valid at any time. `now` is the
    order that it goes on from.
    """

    def __init__(
        self,
        drive: NDArray[np.float64],
        fly: NDArray[np.float64],
        rng: np.random.Generator,
        params: OrderParams = OrderParams(),
    ) -> None:
        """`drive`, `fly`: costs from node to node, (n, n), symmetric; node 0 is the depot."""
        self._drive, self._fly, self._rng, self._params = drive, fly, rng, params
        self.step_trials = params.step_trials
        self._costs_of = with_copy(drive), with_copy(fly)
        self._near = near_nodes(drive)
        tour = short_tour(drive)
        self._leg = float(self._costs_of[0][tour[:-1], tour[1:]].mean())
        self._best = tour.copy()
        self._costs = np.full(2, np.inf)
        self._stream = random_stream(rng)
        self._begin(tour)

    def _begin(self, order: NDArray[np.int32]) -> None:
        """Go on from this order."""
        self.now, self._new = new_split(order), new_split(order)
        most = self._params.most_legs
        split_order(*self._costs_of, self._new, 0, most)
        cost = float(split_order(*self._costs_of, self.now, 0, most))
        self._place = np.argsort(order).astype(np.int32)
        self._costs[0] = cost
        if cost < self._costs[1]:
            self._costs[1] = cost
            self._best[:] = order

    def begin_anew(self) -> None:
        """Go on from a random order; the best one so far is kept."""
        end = len(self._drive)
        middle = 1 + self._rng.permutation(end - 1)
        self._begin(np.array([0, *middle, end], dtype=np.int32))

    @property
    def best_cost(self) -> float:
        """Cost of the best plan so far, summed anew."""
        return plan_cost(self._drive, self._fly, self.best())

    def step(self, trials: int, from_frac: float, to_frac: float) -> None:
        """This many trials, cooling over this part of a round (0: its start, 1: its end)."""
        hot, cold = self._params.hot_legs, self._params.cold_legs
        anneal_order(
            *self._costs_of,
            self._near,
            self.now,
            self._new,
            self._place,
            self._best,
            self._costs,
            self._stream,
            trials,
            self._leg * hot * (cold / hot) ** from_frac,
            self._leg * hot * (cold / hot) ** to_frac,
            self._params.most_legs,
        )

    def best(self) -> list[Operation]:
        """The best plan so far."""
        split = new_split(self._best)
        split_order(*self._costs_of, split, 0, self._params.most_legs)
        return operations_of(split)


def operations_of(split: Split) -> list[Operation]:
    """The operations of an order that is split, from the depot to the depot."""
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
