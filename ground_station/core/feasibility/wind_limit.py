"""Wind aloft at which launches stop."""

import math

from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import level_airspeed_at_max_tilt_mps
from ground_station.core.schema.day_data import DayData

WIND_LIMIT_FRAC = 0.75
"""Default limit as a share of the top airspeed of the slowest drone, empty or loaded. The rest is
for gusts: three sigma of turbulence at 8 % of the mean wind each.
"""


def launch_wind_limit_mps(data: DayData) -> float:
    """Return the wind aloft that stops launches: the day's limit, or by its slowest drone."""
    if data.day.wind_limit_mps is not None:
        return data.day.wind_limit_mps
    density = data.day.standard_air_at_depot.density_kgpm3
    tops = [
        _min_of_empty_and_loaded_max_airspeed_mps(one, density) for one in data.airframes.values()
    ]
    return WIND_LIMIT_FRAC * min(tops, default=math.inf)


def _min_of_empty_and_loaded_max_airspeed_mps(airframe: Airframe, density_kgpm3: float) -> float:
    loads_kg = (0.0, airframe.mass.max_payload_kg)
    return min(
        level_airspeed_at_max_tilt_mps(airframe, airframe.flying_mass_kg(kg), density_kgpm3)
        for kg in loads_kg
    )
