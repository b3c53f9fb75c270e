"""How long an airframe can be in the air at the very most."""

import numpy as np

from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import max_airspeed_mps, multirotor_power_w

SPEEDS = 50
"""Steps of the search for the speed of least power, whose minimum is flat."""


def longest_flight_s(airframe: Airframe) -> float:
    """No flight lasts longer: all energy on the pack's label at the least power in level flight,
    without a parcel. In colder, denser air the rotors need less power: 5 % cover 25 degrees.
    """
    mass_kg = airframe.mass_kg(0.0)
    top_mps = max_airspeed_mps(airframe, mass_kg, REFERENCE_DENSITY_KGPM3)
    speeds = np.linspace(0.0, top_mps, SPEEDS)
    power_w = multirotor_power_w(airframe, mass_kg, speeds, 0.0, REFERENCE_DENSITY_KGPM3)
    return 1.05 * 3600.0 * airframe.battery.nominal_wh / float(np.min(power_w))
