"""One truck, one drone: coolings over visit orders, then over chains of operations.

Orders find operations of many visits; only chains allow second visits and loops.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.operation_plan import Operation
from ground_station.core.truck_drones.operation_search import OperationSearch
from ground_station.core.truck_drones.order_search import OrderSearch

SMALL_NODES = 25
"""Small instances converge to different plans, so they get more coolings."""


@dataclass(frozen=True, slots=True)
class OperationCooling:
    """One cooling, of visit orders or of the chain."""

    of_orders: bool
    share: float
    """Share of the time limit, if one is set."""
    trials_per_node: int
    """Trials without a time limit."""
    begin_frac: float = 0.0
    """Start within the schedule; 0: hot, which discards the previous plan."""


SMALL_COOLINGS = (
    *[OperationCooling(True, 0.06, 4_000)] * 6,
    *[OperationCooling(False, 0.08, 40_000, 0.5)] * 2,
    *[OperationCooling(False, 0.08, 40_000)] * 6,
)
"""[est] Orders first; then chains for loops and second visits, some from the best plan of the
orders and some from a hot start."""
ORDER_COOLINGS = (
    OperationCooling(True, 0.9, 4_000),
    OperationCooling(False, 0.1, 4_000, 0.7),
)
CHAIN_COOLINGS = (OperationCooling(False, 1.0, 40_000),)
MOST_NODES_OF_ORDERS = 75
"""[est] The time of an order trial grows with the node count, that of a chain trial does not."""
MOST_ALPHA_OF_ORDERS = 2.5
"""[est] Limit of drone speed over truck speed: a fast drone leaves few visits to the truck, for
which chains are equally good."""


def default_coolings(
    drive: NDArray[np.float64], fly: NDArray[np.float64]
) -> tuple[OperationCooling, ...]:
    """Return the sequence of coolings; `drive`, `fly` as for `OperationPlanner`."""
    nodes = len(drive)
    if nodes <= SMALL_NODES:
        return SMALL_COOLINGS
    is_slow = drive.sum() <= MOST_ALPHA_OF_ORDERS * fly.sum()
    return ORDER_COOLINGS if is_slow and nodes <= MOST_NODES_OF_ORDERS else CHAIN_COOLINGS


class OperationPlanner:
    """Both searches of one problem: `prepare_search` returns the search to cool."""

    def __init__(
        self, drive: NDArray[np.float64], fly: NDArray[np.float64], rng: np.random.Generator
    ) -> None:
        """`drive`, `fly`: costs between nodes, (n, n), symmetric; node 0 is the depot."""
        self._chain = OperationSearch(drive, fly, rng)
        self._orders = OrderSearch(drive, fly, rng)
        self._cooled_orders = 0
        self._is_chain_begun = False

    def prepare_search(self, cooling: OperationCooling) -> OrderSearch | OperationSearch:
        """Return the search to cool. Order coolings start from a tour, then from random orders; the
        chain's first cooling starts from the best plan of the orders.
        """
        if cooling.of_orders:
            if self._cooled_orders:
                self._orders.begin_from_random_order()
            self._cooled_orders += 1
            return self._orders
        if self._cooled_orders and not self._is_chain_begun:
            self._chain.begin_from_plan(self._orders.best_operations())
        self._is_chain_begun = True
        return self._chain

    @property
    def best_cost(self) -> float:
        """Cost of the best plan found."""
        if self._is_chain_begun or not self._cooled_orders:
            return self._chain.best_cost
        return self._orders.best_cost

    def best_operations(self) -> list[Operation]:
        """Return the best plan found."""
        if self._is_chain_begun or not self._cooled_orders:
            return self._chain.best_operations()
        return self._orders.best_operations()
