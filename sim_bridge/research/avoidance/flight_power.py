"""Power against airspeed and climb, looked up: what energies of episodes are counted with."""

from collections.abc import Callable

import numpy as np

from companion.adapters.files.params import read_airframe
from companion.core.base.arrays import Floats
from companion.core.vehicle.power import multirotor_power_w

GRAVITY_MPS2 = 9.80665
FASTEST_MPS = 30.0


def power_of(airframe: str) -> Callable[[Floats], Floats]:
    """Electrical power in level flight, empty, W, for any array of airspeeds."""
    believed = read_airframe(airframe)
    speeds = np.linspace(0.0, FASTEST_MPS, 121)
    power = multirotor_power_w(believed, believed.mass_kg(0.0), speeds)
    return lambda airspeed_mps: np.interp(airspeed_mps, speeds, power)


def climb_cost_j_per_m(airframe: str) -> float:
    """What a metre of height costs: its weight over the drive's efficiency, J."""
    believed = read_airframe(airframe)
    return believed.mass_kg(0.0) * GRAVITY_MPS2 / believed.power_rotor.drive_efficiency
