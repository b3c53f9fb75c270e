"""A day with the contents of its files."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from companion.core.base.geo import LocalFrame, Obstacle, location_to_ground_ned_m
from companion.core.base.geo_zones import GroundBounds
from companion.core.base.import_report import ImportReport
from companion.core.base.obstacle_document import parse_obstacles
from companion.core.vehicle.airframe import Airframe
from ground_station.core.schema.day import Day
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.orders import Order, order_location

DEPOT = "depot"
"""Name of the depot in a matrix of road times."""


@dataclass(frozen=True, slots=True)
class DayData:
    """The day and its files. `no_fly`: the document, GeoJSON, ED-269 or ED-318.

    `road_times_s`: seconds between sites (`depot`, or an order's id); None: computed from the
    truck's speed. `elevation`: the ground about the depot, where the day names tiles. `forecast`:
    of a file; `day.forecast` is its wind at the start of the day. `folder`: folder of the files.
    `imports`: what was used of each file, and how it was read. `start_us`: start of the plan's
    time, for delivery windows; None: plans do not honour them.
    """

    day: Day
    orders: list[Order]
    no_fly: dict[str, Any] | None
    airframes: dict[str, Airframe]
    road_times_s: dict[tuple[str, str], float] | None
    elevation: SiteElevation | None = None
    forecast: DayForecast | None = None
    folder: Path = Path()
    imports: tuple[ImportReport, ...] = ()
    start_us: int | None = None

    def obstacles_to_avoid(self, frame: LocalFrame) -> tuple[Obstacle, ...]:
        """Return the obstacles that the day's flights must avoid under the day's zone terms."""
        if self.no_fly is None:
            return ()
        conditions = self.day.mission.zone_authorisation
        return parse_obstacles(frame, self.no_fly, conditions, self.ground_bounds_m(frame))

    def ground_bounds_m(self, frame: LocalFrame) -> GroundBounds | None:
        """Return the lowest and highest ground about depot and orders; None: not stated."""
        positions = [location_to_ground_ned_m(frame, order_location(one)) for one in self.orders]
        if self.elevation is not None:
            return self.elevation.bounds_around_m(frame, positions)
        ground = self.day.depot.stated_plane
        return None if ground is None else ground.plane_bounds_m(positions)


def data_with_spares(data: DayData, spares: Mapping[str, str]) -> DayData:
    """Return the data with spare drones, each like the drone of the day whose place it has."""
    drones = [*data.day.drones]
    for name, place in spares.items():
        drone = data.day.find_drone(place)
        if drone is not None and data.day.find_drone(name) is None:
            drones.append(msgspec.structs.replace(drone, id=name))
    return replace(data, day=msgspec.structs.replace(data.day, drones=drones))
