"""Interface of the policies that assign customers to vehicles."""

from typing import Protocol

import numpy as np

from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.tables import Plan


class Policy(Protocol):
    """Plans the service of each customer once; raises LeewayError if no plan exists."""

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """Return a feasible plan; `simulate_schedule` computes its times."""
        ...
