"""Upper bound on the flight time of an airframe."""

import numpy as np

from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import level_airspeed_at_max_tilt_mps, multirotor_power_w

SEARCH_STEPS = 50
"""Steps of the search for the speed of least power, whose minimum is flat."""


def max_flight_duration_s(airframe: Airframe) -> float:
    """Return an upper bound on the flight time: the pack's nominal energy at the least power of
    level flight without a parcel. 5 % cover denser air, where rotors need less power (25 K).
    """
    mass_kg = airframe.flying_mass_kg(0.0)
    top_mps = level_airspeed_at_max_tilt_mps(airframe, mass_kg, REFERENCE_DENSITY_KGPM3)
    speeds = np.linspace(0.0, top_mps, SEARCH_STEPS)
    power_w = multirotor_power_w(airframe, mass_kg, speeds, 0.0, REFERENCE_DENSITY_KGPM3)
    return 1.05 * 3600.0 * airframe.battery.nominal_wh / float(np.min(power_w))
