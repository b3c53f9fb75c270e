"""What a day's files say of the place, for the map."""

import math

from companion.core.base.geo import LocalFrame, place_ned
from companion.core.base.place import Place
from ground_station.app.map.picture import AreaShown, Point, SiteShown, WindShown
from ground_station.core.schema.day import Day, Forecast
from ground_station.core.schema.day_data import DayData


def site_shown(data: DayData) -> SiteShown:
    """Depot, areas and rally points."""
    frame = frame_of(data.day)
    return SiteShown(
        depot=(data.day.depot.lat_deg, data.day.depot.lon_deg),
        areas=[
            AreaShown(
                name=area.name,
                ring=[geodetic(frame, north, east) for north, east in area.ring_ne_m],
                height_m=None if math.isinf(area.height_m) else area.height_m,
            )
            for area in data.obstacles(frame)
        ],
        rally={place.name: _place(frame, place) for place in data.day.rally},
    )


def frame_of(day: Day) -> LocalFrame:
    """Local coordinates about the depot."""
    depot = day.depot
    return LocalFrame(math.radians(depot.lat_deg), math.radians(depot.lon_deg), depot.alt_amsl_m)


def geodetic(frame: LocalFrame, north_m: float, east_m: float) -> Point:
    """Degrees of a point about the depot."""
    lat_rad, lon_rad, _ = frame.to_geodetic((north_m, east_m, 0.0))
    return math.degrees(lat_rad), math.degrees(lon_rad)


def forecast_shown(forecast: Forecast, source: str) -> WindShown:
    """A wind that is planned with: its error is the same in every direction."""
    variance = forecast.std_mps**2
    return WindShown(
        to_ne_mps=forecast.to_ne_mps, cov_m2ps2=(variance, 0.0, variance), source=source
    )


def _place(frame: LocalFrame, place: Place) -> Point:
    north_m, east_m, _ = place_ned(frame, place)
    return geodetic(frame, north_m, east_m)
