"""The interface of the policies: who serves whom."""

from typing import Protocol

import numpy as np

from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.tables import Plan


class Policy(Protocol):
    """Makes a plan that serves every customer once; LeewayError says why there is none."""

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """A feasible plan (`schedule_of` tells its times)."""
        ...
