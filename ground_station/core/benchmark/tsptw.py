"""The travelling salesman problem with time windows: the planner with its drones switched off."""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from ground_station.core.truck_drones.problem import (
    LATE_PRICE,
    DroneKind,
    LegTables,
    TimedOrders,
    TruckAndDrones,
)

_SERVICE_S = 1e-6
"""The driver's time at a customer: the instances contain it in their travel times."""


@dataclass(frozen=True, slots=True)
class TsptwInstance:
    """Travel times (n, n) with the depot first, and windows (n,)."""

    name: str
    travel_s: Floats
    opens_s: Floats
    closes_s: Floats

    def problem(self) -> TruckAndDrones:
        """Return the problem of one truck without drones."""
        at = np.append(np.arange(len(self.travel_s)), 0)
        is_customer = at > 0
        size = (len(at), len(at))
        never = np.full(size, np.inf)
        nowhere = LegTables(never, never, never, never, 0.0)
        return TruckAndDrones(
            travel_s=self.travel_s[np.ix_(at, at)],
            deliver_s=np.where(is_customer, _SERVICE_S, 0.0),
            kinds=(DroneKind(0, 0.0, 0.0, np.zeros(len(at), dtype=np.bool_)),),
            leg_tables=(nowhere,),
            truck_can_serve=is_customer,
            timed=TimedOrders(
                np.where(is_customer, self.opens_s[at], -np.inf),
                np.where(is_customer, self.closes_s[at], np.inf),
                np.where(is_customer, LATE_PRICE, 0.0),
                np.zeros(len(at)),
            ),
        )

    def makespan_and_lateness_s(self, customers: list[int]) -> tuple[float, float]:
        """Return makespan and total lateness of an order of all customers.

        Raises ValueError if a customer is missing or repeated.
        """
        if sorted(customers) != list(range(1, len(self.travel_s))):
            raise ValueError(f"{self.name}: the tour misses or repeats a customer")
        here, now_s, late_s = 0, 0.0, 0.0
        for customer in customers:
            now_s = max(now_s + self.travel_s[here, customer], self.opens_s[customer])
            late_s += max(0.0, now_s - self.closes_s[customer])
            here = customer
        return float(now_s + self.travel_s[here, 0]), float(late_s)
