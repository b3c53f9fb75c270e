"""Who serves whom: the interface behind which the day's planners stand."""

from typing import Protocol

import numpy as np

from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.tables import Plan


class Policy(Protocol):
    """Makes a plan in which every customer is served once, or says by LeewayError why not."""

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """A plan that can be carried out (`schedule_of` tells when)."""
        ...
