"""Simulated annealing over chains of operations: one truck, one drone of unlimited range."""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.operation_plan import (
    AnnealingSearch,
    Operation,
    build_short_tour,
    nearest_nodes_by_node,
    total_cost_of_operations,
)
from ground_station.core.truck_drones.operations import (
    FLOWN,
    LOOP,
    OFF,
    SYNC,
    TRUCK_ONLY,
    OperationChain,
    operations_cost_between_syncs,
    try_random_move,
)
from ground_station.core.truck_drones.random_stream import (
    draw_uniform,
    seeded_stream_from_generator,
)

NODES_PER_SPARE = 25
"""Second visits are rarely optimal: in two of 70 proven optima of 11 to 17 nodes."""


@compiled
def anneal_chain_in_place(
    chain, best, best_role, best_same, costs, stream, trials, start_temperature, end_temperature
):
    """Try `trials` moves, temperature from `start_temperature` to `end_temperature`, units of cost.

    Changes the chain, `best` with its roles, and `costs` (of the chain and of the best).
    """
    cooling = (end_temperature / start_temperature) ** (1.0 / trials)
    temperature = start_temperature
    for _ in range(trials):
        temperature *= cooling
        change = try_random_move(chain, stream, -temperature * math.log(1.0 - draw_uniform(stream)))
        if change == np.inf:
            continue
        costs[0] += change
        if costs[0] < costs[1] - 1e-9:
            costs[1] = costs[0]
            for at in range(len(best)):
                best[at] = chain.visits[at]
                best_role[at] = chain.role[at]
                best_same[at] = chain.same_as[at]


class OperationSearch(AnnealingSearch):
    """A resumable search: `run_trials` repeatedly; `best_cost` is always valid."""

    step_trials = 200_000
    start_temperature_frac, end_temperature_frac = 0.4, 0.01

    def __init__(
        self,
        drive: NDArray[np.float64],
        fly: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> None:
        """`drive`, `fly`: costs between nodes, (n, n), symmetric; node 0 is the depot."""
        nodes = len(drive)
        self._drive, self._fly, self._nodes = drive, fly, nodes
        spare = 2 + nodes // NODES_PER_SPARE
        tour = build_short_tour(drive)
        visits = np.array([*tour[:-1], *range(nodes + 1, nodes + 1 + spare), nodes], dtype=np.int64)
        same_as = np.array([*range(nodes), *([0] * (1 + spare))], dtype=np.int64)
        role = np.full(len(visits), SYNC, dtype=np.int8)
        role[nodes + 1 :] = OFF
        self._chain = OperationChain(
            drive[np.ix_(same_as, same_as)].copy(),
            fly[np.ix_(same_as, same_as)].copy(),
            nearest_nodes_by_node(drive)[same_as],
            visits,
            np.argsort(visits).astype(np.int64),
            role,
            same_as,
            np.zeros(3 * len(visits), dtype=np.int64),
        )
        self._best, self._best_role, self._best_same = visits.copy(), role.copy(), same_as.copy()
        cost = self._chain_cost()
        self._costs = np.full(2, cost)
        self.mean_leg = cost / nodes
        self._stream = seeded_stream_from_generator(rng)

    def begin_from_plan(self, operations: list[Operation]) -> None:
        """Continue from this plan, which serves each node once, without loops."""
        visits, chain = [0], self._chain
        chain.role[self._nodes + 1 :] = OFF
        for operation in operations:
            between, stop = list(operation.between), operation.stop or self._nodes
            chain.role[between] = TRUCK_ONLY
            chain.role[stop] = SYNC
            if operation.fly is not None:
                chain.role[operation.fly] = FLOWN
                between.append(operation.fly)
            visits += [*between, stop]
        chain.visits[:] = [*visits[:-1], *range(self._nodes + 1, len(chain.visits)), self._nodes]
        chain.position[:] = np.argsort(chain.visits)
        self._costs[0] = self._chain_cost()
        if self._costs[0] < self._costs[1]:
            self._costs[1] = self._costs[0]
            self._best[:], self._best_role[:] = chain.visits, chain.role
            self._best_same[:] = chain.same_as

    def _chain_cost(self) -> float:
        visits = self._chain.visits
        return float(operations_cost_between_syncs(self._chain, visits, 0, len(visits) - 1))

    @property
    def best_cost(self) -> float:
        """Cost of the best plan found, recomputed."""
        return total_cost_of_operations(self._drive, self._fly, self.best_operations())

    def run_trials(self, trials: int, schedule_from_frac: float, schedule_to_frac: float) -> None:
        """Run trials, cooling over this part of the schedule (0: its start, 1: its end)."""
        anneal_chain_in_place(
            self._chain,
            self._best,
            self._best_role,
            self._best_same,
            self._costs,
            self._stream,
            trials,
            self.temperature_at(schedule_from_frac),
            self.temperature_at(schedule_to_frac),
        )
        self._costs[0] = self._chain_cost()  # sums of changes drift by rounding errors

    def best_operations(self) -> list[Operation]:
        """Return the best plan found."""
        found: list[Operation] = []
        visits = [int(node) for node in self._best if self._best_role[node] != OFF]
        syncs = [at for at, node in enumerate(visits) if self._best_role[node] == SYNC]
        for at, to in pairwise(syncs):
            found += self._operations_between_syncs(visits[at : to + 1])
        return found

    def _operations_between_syncs(self, visits: list[int]) -> list[Operation]:
        """Return the operations from one SYNC visit to the next: loops at its ends, and itself."""
        start, stop = int(self._best_same[visits[0]]), int(self._best_same[visits[-1]])

        def inner_nodes_with_role(role: int) -> list[int]:
            return [node for node in visits[1:-1] if self._best_role[node] == role]

        # A second visit of a node by the truck alone serves no customer.
        between = tuple(node for node in inner_nodes_with_role(TRUCK_ONLY) if node < self._nodes)
        flown = [node for node in inner_nodes_with_role(FLOWN) if node not in (start, stop)]
        found = [Operation(start, stop, flown[0] if flown else None, between)]
        if start == stop and not flown and not between:
            found = []
        loops = [node for node in inner_nodes_with_role(LOOP) if node not in (start, stop)]
        first = [v for v in loops if self._fly[start, v] <= self._fly[stop, v]]
        last = [v for v in loops if v not in first]
        before = [Operation(start, start, node, ()) for node in first]
        return before + found + [Operation(stop, stop, node, ()) for node in last]
