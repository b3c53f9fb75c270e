"""One truck, one drone: coolings over orders of visits, then over chains of operations.

Orders find operations of many visits, chains alone second visits and loops.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.operation_plan import Operation
from ground_station.core.truck_drones.operation_search import OperationSearch
from ground_station.core.truck_drones.order_search import OrderSearch

SMALL_NODES = 25
"""Small instances settle in different plans, so they get more coolings."""


@dataclass(frozen=True, slots=True)
class OperationCooling:
    """One cooling: of orders, else of the chain."""

    of_orders: bool
    share: float
    """Of the seconds, where there is a limit of seconds."""
    trials_per_node: int
    """Where there is none."""
    begin_frac: float = 0.0
    """The part of a round to begin at: 0: hot, whatever was found before is left."""


SMALL_COOLINGS = (
    *[OperationCooling(True, 0.06, 4_000)] * 6,
    *[OperationCooling(False, 0.08, 40_000, 0.5)] * 2,
    *[OperationCooling(False, 0.08, 40_000)] * 6,
)
"""[est] Orders first; then chains for the loops and second visits that no order has, some from the
orders' best plan and some from a hot start."""
ORDER_COOLINGS = (
    OperationCooling(True, 0.9, 4_000),
    OperationCooling(False, 0.1, 4_000, 0.7),
)
CHAIN_COOLINGS = (OperationCooling(False, 1.0, 40_000),)
MOST_NODES_OF_ORDERS = 75
"""[est] A trial of orders takes the longer the more nodes there are, one of chains does not."""
MOST_ALPHA_OF_ORDERS = 2.5
"""[est] Of the speed of the drone over the truck's: a fast drone leaves the truck few visits, which
chains arrange as well."""


def default_coolings(
    drive: NDArray[np.float64], fly: NDArray[np.float64]
) -> tuple[OperationCooling, ...]:
    """What to cool, in this order: `drive`, `fly` as for `OperationPlanner`."""
    nodes = len(drive)
    if nodes <= SMALL_NODES:
        return SMALL_COOLINGS
    is_slow = drive.sum() <= MOST_ALPHA_OF_ORDERS * fly.sum()
    return ORDER_COOLINGS if is_slow and nodes <= MOST_NODES_OF_ORDERS else CHAIN_COOLINGS


class OperationPlanner:
    """Both searches of one problem: `begin` a cooling, then cool what it gives."""

    def __init__(
        self, drive: NDArray[np.float64], fly: NDArray[np.float64], rng: np.random.Generator
    ) -> None:
        """`drive`, `fly`: costs from node to node, (n, n), symmetric; node 0 is the depot."""
        self._chain = OperationSearch(drive, fly, rng)
        self._orders = OrderSearch(drive, fly, rng)
        self._cooled_orders = 0
        self._is_chain_begun = False

    def begin(self, cooling: OperationCooling) -> OrderSearch | OperationSearch:
        """The search to cool. Orders are cooled from a tour first, then from random orders; the
        chain's first cooling takes over the best plan of the orders.
        """
        if cooling.of_orders:
            if self._cooled_orders:
                self._orders.begin_anew()
            self._cooled_orders += 1
            return self._orders
        if self._cooled_orders and not self._is_chain_begun:
            self._chain.begin_with(self._orders.best())
        self._is_chain_begun = True
        return self._chain

    @property
    def best_cost(self) -> float:
        """Cost of the best plan so far."""
        if self._is_chain_begun or not self._cooled_orders:
            return self._chain.best_cost
        return self._orders.best_cost

    def best(self) -> list[Operation]:
        """The best plan so far."""
        if self._is_chain_begun or not self._cooled_orders:
            return self._chain.best()
        return self._orders.best()
