"""The wind over the site of a day, with the wind process that the day names."""

from collections.abc import Callable

from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams
from ground_station.adapters.files.params import read_wind_process
from ground_station.adapters.files.station_file import StationFile
from ground_station.core.schema.day_data import DayData
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_stations import StationBook

DEFAULT_PROCESS = "coast"
"""Where no day says how wind changes at the site: as a flight file's own default."""


def site_wind_of(data: DayData | None, say: Callable[[str], None] = lambda words: None) -> SiteWind:
    """With the day's forecast before anybody tells; None: nothing of the site is known.

    Where the day's wind process is not on this machine (it may be a file of the vehicles'), the
    default's is taken, and that is said.
    """
    if data is None:
        return SiteWind(read_wind_process(DEFAULT_PROCESS))
    depot, mission = data.day.depot, data.day.mission
    process = _process_of(mission.wind_process, say)
    place_deg = depot.lat_deg, depot.lon_deg
    watches = data.day.watch_fronts
    if not watches:
        say("fronts are not looked for: the day says watch_fronts = false")
    return SiteWind(
        process, place_deg, data.day.forecast, mission.cruise_height_m, watches_fronts=watches
    )


def station_book_of(wind: SiteWind, data: DayData | None) -> StationBook:
    """The stations that the day names; where no day is known, all that say where they stand."""
    return StationBook(wind) if data is None else StationBook.of_day(wind, data.day.stations)


def station_files(data: DayData) -> list[StationFile]:
    """Of the wind stations that have one; they lie beside the day."""
    return [
        StationFile(station.id, data.folder / station.file)
        for station in data.day.stations
        if station.file is not None
    ]


def _process_of(name: str, say: Callable[[str], None]) -> WindProcessParams:
    try:
        return read_wind_process(name)
    except LeewayError as error:
        say(f"the field of the wind goes by {DEFAULT_PROCESS}: {error}")
        return read_wind_process(DEFAULT_PROCESS)
