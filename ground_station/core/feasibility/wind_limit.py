"""Wind aloft at which nothing is launched."""

import math

from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import max_airspeed_mps
from ground_station.core.schema.day_data import DayData

LIMIT_SHARE = 0.75
"""Wind aloft over the top airspeed of the slowest drone, empty or full, where a day states no
limit. The rest is for gusts: three sigma of turbulence at 8 % of the mean wind each.
"""


def limit_of(data: DayData) -> float:
    """Wind aloft at which nothing is launched: the day's, or by its slowest drone."""
    if data.day.wind_limit_mps is not None:
        return data.day.wind_limit_mps
    density = data.day.air.density_kgpm3
    tops = [_top_mps(one, density) for one in data.airframes.values()]
    return LIMIT_SHARE * min(tops, default=math.inf)


def _top_mps(airframe: Airframe, density_kgpm3: float) -> float:
    loads_kg = (0.0, airframe.mass.max_payload_kg)
    return min(max_airspeed_mps(airframe, airframe.mass_kg(kg), density_kgpm3) for kg in loads_kg)
