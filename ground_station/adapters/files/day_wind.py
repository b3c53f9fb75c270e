"""Wind over the site of a day, with the wind process that the day specifies."""

from collections.abc import Callable

from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams
from ground_station.adapters.files.params import read_wind_process
from ground_station.core.schema.day_data import DayData
from ground_station.core.site_wind.site_wind import SiteWind

DEFAULT_PROCESS = "coast"
"""Wind process if no day specifies one: the default of a flight file."""


def create_site_wind(
    data: DayData | None, log_message: Callable[[str], None] = lambda words: None
) -> SiteWind:
    """Return the site wind, initially the day's forecast; without a day, the site is unknown.

    If the day's wind process is not on this machine (it may be a file of the vehicles), the default
    process is used and logged.
    """
    if data is None:
        return SiteWind(read_wind_process(DEFAULT_PROCESS))
    depot, mission = data.day.depot, data.day.mission
    process = _read_wind_process_or_default(mission.wind_process, log_message)
    site_deg = depot.lat_deg, depot.lon_deg
    watches = data.day.watch_fronts
    if not watches:
        log_message("front detection is off: the day states watch_fronts = false")
    return SiteWind(
        process, site_deg, data.day.forecast, mission.cruise_height_m, watches_fronts=watches
    )


def _read_wind_process_or_default(
    name: str, log_message: Callable[[str], None]
) -> WindProcessParams:
    try:
        return read_wind_process(name)
    except LeewayError as error:
        log_message(f"wind field uses process {DEFAULT_PROCESS}: {error}")
        return read_wind_process(DEFAULT_PROCESS)
