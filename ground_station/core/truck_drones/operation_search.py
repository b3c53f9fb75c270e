"""Simulated annealing over chains of operations: one truck, one drone, no limit of its range."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.operations import (
    ALONE,
    FLOWN,
    LOOP,
    OFF,
    SYNC,
    Chain,
    any_move,
    stretch_cost,
)
from ground_station.core.truck_drones.random_stream import random_stream, uniform
from ground_station.core.truck_drones.tour import improve_tour

NEAR = 12


@dataclass(frozen=True, slots=True)
class OperationParams:
    """Temperatures as shares of the first tour's mean leg; a round cools from hot to cold."""

    hot_legs: float = 0.4
    cold_legs: float = 0.01
    step_trials: int = 200_000


TRIALS_PER_NODE = 40_000
"""In one cooling: some 2 s of one core for 50 nodes, 10 s for 250."""
SMALL_NODES = 25
SMALL_ROUNDS = 12


def default_rounds(nodes: int) -> int:
    """Small instances settle in different plans, so they get more coolings."""
    return SMALL_ROUNDS if nodes <= SMALL_NODES else 1


def default_trials(nodes: int) -> int:
    """Trials of one cooling."""
    return nodes * TRIALS_PER_NODE


NODES_PER_SPARE = 25
"""Second visits pay seldom: in two of 70 proven optima of 11 to 17 nodes."""


@dataclass(frozen=True, slots=True)
class Operation:
    """From `start`, where both are, to `stop`; `fly` None: the drone stays aboard. The truck drives
    by `between`.
    """

    start: int
    stop: int
    fly: int | None
    between: tuple[int, ...]


@compiled
def anneal(c, best, best_role, best_same, costs, stream, trials, hot, cold):
    """Try `trials` moves while the temperature falls from `hot` to `cold`, units of cost.

    Changes the chain, `best` with its roles, and `costs` (of the chain and of the best).
    """
    cooling = (cold / hot) ** (1.0 / trials)
    temperature = hot
    for _ in range(trials):
        temperature *= cooling
        change = any_move(c, stream, -temperature * math.log(1.0 - uniform(stream)))
        if change == np.inf:
            continue
        costs[0] += change
        if costs[0] < costs[1] - 1e-9:
            costs[1] = costs[0]
            for at in range(len(best)):
                best[at] = c.visits[at]
                best_role[at] = c.role[at]
                best_same[at] = c.same_as[at]


class OperationSearch:
    """A search under way: `step` as often as wanted; `best_cost` is valid at any time."""

    def __init__(
        self,
        drive: NDArray[np.float64],
        fly: NDArray[np.float64],
        rng: np.random.Generator,
        params: OperationParams = OperationParams(),
    ) -> None:
        """`drive`, `fly`: costs from node to node, (n, n), symmetric; node 0 is the depot."""
        nodes = len(drive)
        self._drive, self._fly, self._nodes, self._params = drive, fly, nodes, params
        spare = 2 + nodes // NODES_PER_SPARE
        tour = _tour(drive)
        visits = np.array([*tour[:-1], *range(nodes + 1, nodes + 1 + spare), nodes], dtype=np.int32)
        same_as = np.array([*range(nodes), *([0] * (1 + spare))], dtype=np.int32)
        role = np.full(len(visits), SYNC, dtype=np.int8)
        role[nodes + 1 :] = OFF
        self._chain = Chain(
            drive[np.ix_(same_as, same_as)].copy(),
            fly[np.ix_(same_as, same_as)].copy(),
            _near(drive)[same_as],
            visits,
            np.argsort(visits).astype(np.int32),
            role,
            same_as,
            np.zeros(3 * len(visits), dtype=np.int32),
        )
        self._best, self._best_role, self._best_same = visits.copy(), role.copy(), same_as.copy()
        cost = self._cost()
        self._costs = np.full(2, cost)
        self._leg = cost / nodes
        self._stream = random_stream(rng)

    def _cost(self) -> float:
        c = self._chain
        return float(stretch_cost(c.drive, c.fly, c.role, c.visits, 0, len(c.visits) - 1))

    @property
    def best_cost(self) -> float:
        """Cost of the best plan so far, summed anew."""
        return sum(self._cost_of(operation) for operation in self.best())

    def _cost_of(self, operation: Operation) -> float:
        path = (operation.start, *operation.between, operation.stop)
        truck = sum(float(self._drive[one, other]) for one, other in pairwise(path))
        if operation.fly is None:
            return truck
        out, back = self._fly[operation.start, operation.fly], self._fly[operation.fly, path[-1]]
        return max(truck, float(out + back))

    def step(self, trials: int, from_frac: float, to_frac: float) -> None:
        """This many trials, cooling over this part of a round (0: its start, 1: its end)."""
        hot, cold = self._params.hot_legs, self._params.cold_legs
        anneal(
            self._chain,
            self._best,
            self._best_role,
            self._best_same,
            self._costs,
            self._stream,
            trials,
            self._leg * hot * (cold / hot) ** from_frac,
            self._leg * hot * (cold / hot) ** to_frac,
        )
        self._costs[0] = self._cost()  # sums of changes drift by rounding

    def round(self, trials: int) -> None:
        """One cooling of this many trials."""
        done = 0
        while done < trials:
            now = min(self._params.step_trials, trials - done)
            self.step(now, done / trials, (done + now) / trials)
            done += now

    def best(self) -> list[Operation]:
        """The best plan so far."""
        found: list[Operation] = []
        visits = [int(visit) for visit in self._best if self._best_role[visit] != OFF]
        syncs = [at for at, visit in enumerate(visits) if self._best_role[visit] == SYNC]
        for at, to in pairwise(syncs):
            found += self._operations(visits[at : to + 1])
        return found

    def _operations(self, visits: list[int]) -> list[Operation]:
        """The operations from one SYNC visit to the next: loops at its ends, and itself."""
        start, stop = int(self._best_same[visits[0]]), int(self._best_same[visits[-1]])

        def inner(role: int) -> list[int]:
            return [visit for visit in visits[1:-1] if self._best_role[visit] == role]

        # A second visit of a node by the truck alone serves nothing.
        between = tuple(visit for visit in inner(ALONE) if visit < self._nodes)
        flown = [visit for visit in inner(FLOWN) if visit not in (start, stop)]
        found = [Operation(start, stop, flown[0] if flown else None, between)]
        if start == stop and not flown and not between:
            found = []
        loops = [visit for visit in inner(LOOP) if visit not in (start, stop)]
        first = [v for v in loops if self._fly[start, v] <= self._fly[stop, v]]
        last = [v for v in loops if v not in first]
        before = [Operation(start, start, visit, ()) for visit in first]
        return before + found + [Operation(stop, stop, visit, ()) for visit in last]


def _near(drive: NDArray[np.float64]) -> NDArray[np.int32]:
    """By node, the nearest others, nearest first."""
    apart = drive.copy()
    np.fill_diagonal(apart, np.inf)
    return np.argsort(apart, axis=1, kind="stable")[:, : min(NEAR, len(drive) - 1)].astype(np.int32)


def _tour(drive: NDArray[np.float64]) -> NDArray[np.int32]:
    """A short tour of the truck alone, from node 0 to its copy `n`."""
    end = len(drive)
    left, tour = list(range(1, end)), [0]
    while left:
        tour.append(left.pop(int(np.argmin(drive[tour[-1], left]))))
    route = np.array([*tour, end], dtype=np.int32)
    both = [*range(end), 0]
    improve_tour(drive[np.ix_(both, both)].copy(), _near(drive), route)
    return route
