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


def default_trials(nodes: int) -> int:
    """Trials in all: some 2 s of one core for 50 nodes, 10 s for 250."""
    return nodes * TRIALS_PER_NODE


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
def anneal(c, best, best_role, costs, stream, trials, hot, cold):
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
            best[:] = c.visits
            best_role[:] = c.role


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
        self._nodes, self._params = nodes, params
        both = [*range(nodes), 0]
        drive, fly = drive[np.ix_(both, both)].copy(), fly[np.ix_(both, both)].copy()
        near = _near(drive)
        tour = _tour(drive, near)
        self._chain = Chain(
            drive,
            fly,
            near,
            tour,
            np.argsort(tour).astype(np.int32),
            np.full(nodes + 1, SYNC, dtype=np.int8),
            np.zeros(3 * nodes + 8, dtype=np.int32),
        )
        self._best = tour.copy()
        self._best_role = self._chain.role.copy()
        cost = self._cost()
        self._costs = np.full(2, cost)
        self._leg = cost / nodes
        self._stream = random_stream(rng)

    def _cost(self) -> float:
        c = self._chain
        return float(stretch_cost(c.drive, c.fly, c.role, c.visits, 0, self._nodes))

    @property
    def best_cost(self) -> float:
        """Cost of the best plan so far, summed anew."""
        c = self._chain
        return float(stretch_cost(c.drive, c.fly, self._best_role, self._best, 0, self._nodes))

    def step(self, trials: int, from_frac: float, to_frac: float) -> None:
        """This many trials, cooling over this part of a round (0: its start, 1: its end)."""
        hot, cold = self._params.hot_legs, self._params.cold_legs
        anneal(
            self._chain,
            self._best,
            self._best_role,
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
        visits, role = self._best, self._best_role
        syncs = [at for at, node in enumerate(visits) if role[node] == SYNC]
        for at, to in pairwise(syncs):
            found += _operations(self._chain, self._node, visits[at : to + 1], role)
        return found

    def _node(self, visit: int) -> int:
        return 0 if visit == self._nodes else int(visit)


def _operations(c, node, visits, role):
    start, stop = int(visits[0]), int(visits[-1])
    inner = [int(visit) for visit in visits[1:-1]]
    loops = [v for v in inner if role[v] == LOOP]
    first = [v for v in loops if c.fly[start, v] <= c.fly[stop, v]]
    flown = [v for v in inner if role[v] == FLOWN]
    between = tuple(node(v) for v in inner if role[v] == ALONE)
    found = [Operation(node(start), node(start), node(v), ()) for v in first]
    fly = node(flown[0]) if flown else None
    found.append(Operation(node(start), node(stop), fly, between))
    return found + [Operation(node(stop), node(stop), node(v), ()) for v in loops if v not in first]


def _near(drive: NDArray[np.float64]) -> NDArray[np.int32]:
    apart = drive.copy()
    np.fill_diagonal(apart, np.inf)
    return np.argsort(apart, axis=1, kind="stable")[:, : min(NEAR, len(drive) - 1)].astype(np.int32)


def _tour(drive: NDArray[np.float64], near: NDArray[np.int32]) -> NDArray[np.int32]:
    """A short tour of the truck alone."""
    end = len(drive) - 1
    left, tour = list(range(1, end)), [0]
    while left:
        tour.append(left.pop(int(np.argmin(drive[tour[-1], left]))))
    route = np.array([*tour, end], dtype=np.int32)
    improve_tour(drive, near, route)
    return route
