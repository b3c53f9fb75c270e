"""Site data from a day's files, for the map."""

import math

from companion.core.base.geo import LocalFrame, location_to_ground_ned_m
from companion.core.base.location import Location
from ground_station.app.map.picture import AreaShown, Point, SiteShown, WindShown
from ground_station.core.schema.day import Day, Forecast
from ground_station.core.schema.day_data import DayData


def site_shown(data: DayData) -> SiteShown:
    """Return depot, areas and rally points."""
    frame = depot_frame(data.day)
    return SiteShown(
        depot=(data.day.depot.lat_deg, data.day.depot.lon_deg),
        areas=[
            AreaShown(
                name=area.name,
                ring=[to_geodetic_point(frame, north, east) for north, east in area.ring_ne_m],
                height_m=None if math.isinf(area.height_m) else area.height_m,
            )
            for area in data.obstacles_to_avoid(frame)
        ],
        rally={location.name: _location_point(frame, location) for location in data.day.rally},
    )


def depot_frame(day: Day) -> LocalFrame:
    """Return local coordinates with the depot as origin."""
    depot = day.depot
    return LocalFrame(math.radians(depot.lat_deg), math.radians(depot.lon_deg), depot.alt_amsl_m)


def to_geodetic_point(frame: LocalFrame, north_m: float, east_m: float) -> Point:
    """Return degrees of a point in coordinates of the depot."""
    lat_rad, lon_rad, _ = frame.to_geodetic((north_m, east_m, 0.0))
    return math.degrees(lat_rad), math.degrees(lon_rad)


def forecast_shown(forecast: Forecast, source: str) -> WindShown:
    """Return a planning wind: its error is equal in all directions."""
    variance = forecast.std_mps**2
    return WindShown(
        to_ne_mps=forecast.to_ne_mps, cov_m2ps2=(variance, 0.0, variance), source=source
    )


def _location_point(frame: LocalFrame, location: Location) -> Point:
    north_m, east_m, _ = location_to_ground_ned_m(frame, location)
    return to_geodetic_point(frame, north_m, east_m)
