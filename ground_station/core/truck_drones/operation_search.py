"""Simulated annealing over chains of operations: one truck, one drone, no limit of its range."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.operation_plan import (
    CooledSearch,
    Operation,
    near_nodes,
    plan_cost,
    short_tour,
)
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


@dataclass(frozen=True, slots=True)
class OperationParams:
    """Temperatures as shares of the first tour's mean leg; a round cools from hot to cold."""

    hot_legs: float = 0.4
    cold_legs: float = 0.01
    step_trials: int = 200_000


NODES_PER_SPARE = 25
"""Second visits pay seldom: in two of 70 proven optima of 11 to 17 nodes."""


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


class OperationSearch(CooledSearch):
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
        self.step_trials = params.step_trials
        spare = 2 + nodes // NODES_PER_SPARE
        tour = short_tour(drive)
        visits = np.array([*tour[:-1], *range(nodes + 1, nodes + 1 + spare), nodes], dtype=np.int32)
        same_as = np.array([*range(nodes), *([0] * (1 + spare))], dtype=np.int32)
        role = np.full(len(visits), SYNC, dtype=np.int8)
        role[nodes + 1 :] = OFF
        self._chain = Chain(
            drive[np.ix_(same_as, same_as)].copy(),
            fly[np.ix_(same_as, same_as)].copy(),
            near_nodes(drive)[same_as],
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

    def begin_with(self, operations: list[Operation]) -> None:
        """Go on from this plan, which serves each node once, none by a loop."""
        visits, chain = [0], self._chain
        chain.role[self._nodes + 1 :] = OFF
        for operation in operations:
            between, stop = list(operation.between), operation.stop or self._nodes
            chain.role[between] = ALONE
            chain.role[stop] = SYNC
            if operation.fly is not None:
                chain.role[operation.fly] = FLOWN
                between.append(operation.fly)
            visits += [*between, stop]
        chain.visits[:] = [*visits[:-1], *range(self._nodes + 1, len(chain.visits)), self._nodes]
        chain.place[:] = np.argsort(chain.visits)
        self._costs[0] = self._cost()
        if self._costs[0] < self._costs[1]:
            self._costs[1] = self._costs[0]
            self._best[:], self._best_role[:] = chain.visits, chain.role
            self._best_same[:] = chain.same_as

    def _cost(self) -> float:
        c = self._chain
        return float(stretch_cost(c.drive, c.fly, c.role, c.visits, 0, len(c.visits) - 1))

    @property
    def best_cost(self) -> float:
        """Cost of the best plan so far, summed anew."""
        return plan_cost(self._drive, self._fly, self.best())

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
