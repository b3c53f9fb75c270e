"""The wind over the site of a day, with the wind process that the day names."""

from ground_station.adapters.files.params import read_wind_process
from ground_station.core.fleet.site_wind import SiteWind
from ground_station.core.schema.day_data import DayData

DEFAULT_PROCESS = "coast"
"""Where no day says how wind changes at the site: as a flight file's own default."""


def site_wind_of(data: DayData | None) -> SiteWind:
    """With the day's forecast before anybody tells; None: nothing of the site is known.

    Raises LeewayError where the day's wind process is none.
    """
    if data is None:
        return SiteWind(read_wind_process(DEFAULT_PROCESS))
    depot, mission = data.day.depot, data.day.mission
    process = read_wind_process(mission.wind_process)
    place_deg = depot.lat_deg, depot.lon_deg
    return SiteWind(process, place_deg, data.day.forecast, mission.cruise_height_m)
