"""The wind reported by the fleet, compared with the planned one."""

import math

import msgspec

from ground_station.core.schema.day import Forecast
from ground_station.core.site_wind.estimated_wind import SiteWindEstimate
from ground_station.core.site_wind.site_wind import SiteWind

DAY_LEAD_S, DAY_MEAN_S = 1800.0, 600.0
"""A day is planned with the ten-minute mean wind, half an hour from now: current gusts are over by
then, and persistent wind is predicted no better for later hours.
"""

LAUNCH_LEAD_S, LAUNCH_MEAN_S = 300.0, 600.0
"""The next flight's wind: the mean of the next ten minutes."""


def estimated_depot_wind_for_planning(
    site_wind: SiteWind | None, now_s: float
) -> SiteWindEstimate | None:
    """Return the wind that a day would be planned with now; None: too few reports."""
    return None if site_wind is None else site_wind.depot_wind(now_s, DAY_LEAD_S, DAY_MEAN_S)


def wind_deviation_sigmas(
    site_wind: SiteWind | None, now_s: float, planned_wind: Forecast
) -> float:
    """Return the distance of the planned wind from the estimated one, in its standard deviations; 0
    with too few reports.
    """
    found = estimated_depot_wind_for_planning(site_wind, now_s)
    if found is None:
        return 0.0
    return math.dist(found.to_ne_mps, planned_wind.to_ne_mps) / planned_wind.std_mps


def measured_or_previous_planning_forecast(
    site_wind: SiteWind | None, now_s: float, previous: Forecast
) -> Forecast:
    """Return the forecast to plan with from now on. Its error is the field's prediction error."""
    found = estimated_depot_wind_for_planning(site_wind, now_s)
    return (
        previous if found is None else _with_air_temperature(found.as_constant_forecast, previous)
    )


def measured_or_previous_launch_forecast(
    site_wind: SiteWind | None, now_s: float, previous: Forecast
) -> Forecast:
    """Return the same for flights that launch now."""
    if site_wind is None:
        return previous
    found = site_wind.depot_wind(now_s, LAUNCH_LEAD_S, LAUNCH_MEAN_S)
    if found is not None:
        return _with_air_temperature(found.as_constant_forecast, previous)
    return _station_wind_if_stronger(
        site_wind.depot_wind_by_stations(now_s, LAUNCH_LEAD_S, LAUNCH_MEAN_S), previous
    )


def _station_wind_if_stronger(by_stations: SiteWindEstimate | None, previous: Forecast) -> Forecast:
    """Return the stations' wind only if it exceeds the forecast. Without a drone's confirmation a
    faulty station must not permit a launch that the forecast forbids.
    """
    if by_stations is None or by_stations.speed_mps <= previous.speed_mps:
        return previous
    found = _with_air_temperature(by_stations.as_constant_forecast, previous)
    return msgspec.structs.replace(found, std_mps=max(found.std_mps, previous.std_mps))


def winds_differ_enough_to_replan(first_forecast: Forecast, second_forecast: Forecast) -> bool:
    """Return True if two winds differ enough to plan again: half a metre a second."""
    moved_mps = math.dist(first_forecast.to_ne_mps, second_forecast.to_ne_mps)
    return moved_mps > 0.5 or abs(first_forecast.std_mps - second_forecast.std_mps) > 0.3


def _with_air_temperature(wind: Forecast, previous: Forecast) -> Forecast:
    return msgspec.structs.replace(wind, air_temperature_c=previous.air_temperature_c)
