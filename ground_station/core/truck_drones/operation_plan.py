"""Plans of one truck and one drone: operations, what they cost, and a tour to begin with."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.tour import improve_tour

NEAR = 12


@dataclass(frozen=True, slots=True)
class Operation:
    """From `start`, where both are, to `stop`; `fly` None: the drone stays aboard. The truck drives
    by `between`.
    """

    start: int
    stop: int
    fly: int | None
    between: tuple[int, ...]


class CooledSearch(ABC):
    """A search that cools in steps of at most `step_trials`."""

    step_trials: int

    @abstractmethod
    def step(self, trials: int, from_frac: float, to_frac: float) -> None:
        """This many trials, cooling over this part of a round (0: its start, 1: its end)."""

    def round(self, trials: int, begin_frac: float = 0.0) -> None:
        """One cooling of this many trials, from this part of a round on."""
        done = 0
        while done < trials:
            now = min(self.step_trials, trials - done)
            parts = (done / trials, (done + now) / trials)
            self.step(now, *(begin_frac + (1.0 - begin_frac) * part for part in parts))
            done += now


def plan_cost(
    drive: NDArray[np.float64], fly: NDArray[np.float64], operations: Sequence[Operation]
) -> float:
    """The sum over the operations of the longer of the truck's and the drone's cost. `drive`,
    `fly`: costs from node to node, (n, n).
    """
    return sum(_operation_cost(drive, fly, operation) for operation in operations)


def _operation_cost(
    drive: NDArray[np.float64], fly: NDArray[np.float64], operation: Operation
) -> float:
    path = (operation.start, *operation.between, operation.stop)
    truck = sum(float(drive[one, other]) for one, other in pairwise(path))
    if operation.fly is None:
        return truck
    out, back = fly[operation.start, operation.fly], fly[operation.fly, operation.stop]
    return max(truck, float(out + back))


def near_nodes(drive: NDArray[np.float64]) -> NDArray[np.int32]:
    """By node, the nearest others, nearest first: at most NEAR."""
    apart = drive.copy()
    np.fill_diagonal(apart, np.inf)
    return np.argsort(apart, axis=1, kind="stable")[:, : min(NEAR, len(drive) - 1)].astype(np.int32)


def short_tour(drive: NDArray[np.float64]) -> NDArray[np.int32]:
    """A short tour of the truck alone, from node 0 to its copy `n`."""
    end = len(drive)
    left, tour = list(range(1, end)), [0]
    while left:
        tour.append(left.pop(int(np.argmin(drive[tour[-1], left]))))
    route = np.array([*tour, end], dtype=np.int32)
    improve_tour(with_copy(drive), near_nodes(drive), route)
    return route


def with_copy(costs: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same costs with a copy of node 0 behind the last node, (n + 1, n + 1)."""
    both = [*range(len(costs)), 0]
    return costs[np.ix_(both, both)].copy()
