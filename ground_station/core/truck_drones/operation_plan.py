"""Plans of one truck and one drone: operations, their cost, and an initial tour."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.tour import improve_tour_in_place

NEAR = 12


@dataclass(frozen=True, slots=True)
class Operation:
    """Truck and drone from joint `start` to joint `stop`. `fly`: node that the drone serves; None:
    the drone stays on the truck. `between`: nodes of the truck's route.
    """

    start: int
    stop: int
    fly: int | None
    between: tuple[int, ...]


class AnnealingSearch(ABC):
    """A simulated annealing search in steps of at most `step_trials`, cooling from hot to cold."""

    step_trials: int
    start_temperature_frac: float
    end_temperature_frac: float
    """Temperatures as shares of the mean leg of the initial plan."""
    mean_leg: float

    def temperature_at(self, schedule_frac: float) -> float:
        """Return the temperature at this part of the schedule (0: its start, 1: its end)."""
        start = self.start_temperature_frac
        return self.mean_leg * start * (self.end_temperature_frac / start) ** schedule_frac

    @abstractmethod
    def run_trials(self, trials: int, schedule_from_frac: float, schedule_to_frac: float) -> None:
        """Run trials, cooling over this part of the schedule (0: its start, 1: its end)."""

    def run_cooling(
        self,
        trials: int,
        begin_frac: float = 0.0,
        on_progress: Callable[[float], None] = lambda done_frac: None,
    ) -> None:
        """Run trials from this part of the schedule to its end; pass the progress to
        `on_progress`.
        """
        done = 0
        while done < trials:
            now = min(self.step_trials, trials - done)
            parts = (done / trials, (done + now) / trials)
            self.run_trials(now, *(begin_frac + (1.0 - begin_frac) * part for part in parts))
            done += now
            on_progress(done / trials)


def total_cost_of_operations(
    drive: NDArray[np.float64], fly: NDArray[np.float64], operations: Sequence[Operation]
) -> float:
    """Return the sum over the operations of the greater of truck cost and drone cost. `drive`,
    `fly`: costs between nodes, (n, n).
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


def nearest_nodes_by_node(drive: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the nearest other nodes of each node, nearest first: at most NEAR."""
    distances = drive.copy()
    np.fill_diagonal(distances, np.inf)
    return np.argsort(distances, axis=1, kind="stable")[:, : min(NEAR, len(drive) - 1)].astype(
        np.int64
    )


def build_short_tour(drive: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return a short truck tour from node 0 to its copy `n`."""
    end = len(drive)
    left, tour = list(range(1, end)), [0]
    while left:
        tour.append(left.pop(int(np.argmin(drive[tour[-1], left]))))
    route = np.array([*tour, end], dtype=np.int64)
    improve_tour_in_place(with_depot_copy(drive), nearest_nodes_by_node(drive), route)
    return route


def with_depot_copy(costs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Append a copy of node 0 to the cost matrix, (n + 1, n + 1)."""
    both = [*range(len(costs)), 0]
    return costs[np.ix_(both, both)].copy()
