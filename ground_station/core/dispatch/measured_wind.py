"""The wind that the fleet tells, against the one that is planned with."""

import math

import msgspec

from ground_station.core.schema.day import Forecast
from ground_station.core.site_wind.believed_wind import BelievedWind
from ground_station.core.site_wind.site_wind import SiteWind

DAY_AHEAD_S, DAY_MEAN_S = 1800.0, 600.0
"""A day's plan rests on the mean wind of ten minutes, half an hour from now: gusts of the moment
are gone by then, and what lasts is known no better for later hours.
"""

NEXT_AHEAD_S, NEXT_MEAN_S = 300.0, 600.0
"""The next flight's wind: the mean of the ten minutes to come."""


def planned_for(wind: SiteWind | None, now_s: float) -> BelievedWind | None:
    """The wind that a day would be planned with now; None: the fleet tells too little."""
    return None if wind is None else wind.ahead(now_s, DAY_AHEAD_S, DAY_MEAN_S)


def off_sigmas(wind: SiteWind | None, now_s: float, forecast: Forecast) -> float:
    """Distance of the planned wind from what is believed, in its standard deviations; 0 where too
    little is told.
    """
    found = planned_for(wind, now_s)
    if found is None:
        return 0.0
    return math.dist(found.to_ne_mps, forecast.to_ne_mps) / forecast.std_mps


def forecast_now(wind: SiteWind | None, now_s: float, before: Forecast) -> Forecast:
    """The forecast to plan with from now on; its error is the field's own, of that time to come."""
    found = planned_for(wind, now_s)
    return before if found is None else _at(found.forecast, before)


def next_flights(wind: SiteWind | None, now_s: float, before: Forecast) -> Forecast:
    """The same for flights that begin now."""
    if wind is None:
        return before
    found = wind.ahead(now_s, NEXT_AHEAD_S, NEXT_MEAN_S)
    if found is not None:
        return _at(found.forecast, before)
    return _no_weaker(wind.by_stations(now_s, NEXT_AHEAD_S, NEXT_MEAN_S), before)


def _no_weaker(by_stations: BelievedWind | None, before: Forecast) -> Forecast:
    """Stations that nobody in the air bears out may show more wind than the forecast, never less:
    one that lies lets nothing be launched that would not be.
    """
    if by_stations is None or by_stations.speed_mps <= before.speed_mps:
        return before
    found = _at(by_stations.forecast, before)
    return msgspec.structs.replace(found, std_mps=max(found.std_mps, before.std_mps))


def differs(one: Forecast, other: Forecast) -> bool:
    """Whether two winds differ by what is worth planning anew: half a metre a second."""
    moved_mps = math.dist(one.to_ne_mps, other.to_ne_mps)
    return moved_mps > 0.5 or abs(one.std_mps - other.std_mps) > 0.3


def _at(wind: Forecast, before: Forecast) -> Forecast:
    return msgspec.structs.replace(wind, air_temperature_c=before.air_temperature_c)
