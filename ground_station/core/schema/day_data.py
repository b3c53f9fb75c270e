"""A day with everything that its files contain."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.core.base.geo import LocalFrame, Obstacle
from companion.core.base.obstacle_document import obstacles_of, reach_note
from companion.core.mission.flight_plan import frame_at
from companion.core.vehicle.airframe import Airframe
from ground_station.core.schema.day import Day
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.orders import Order

DEPOT = "depot"
"""Name of the depot in a matrix of road times."""


@dataclass(frozen=True, slots=True)
class DayData:
    """The day and its files. `no_fly` is the document: GeoJSON, ED-269 or ED-318.

    `roads_s`: seconds from one place (`depot`, or an order's id) to another; None: by the truck's
    speed. `elevation`: of the ground about the depot, where the day names tiles. `forecast`: of a
    file; `day.forecast` is its wind at the day's beginning. `folder`: where the files lie.
    """

    day: Day
    orders: list[Order]
    no_fly: dict[str, Any] | None
    airframes: dict[str, Airframe]
    roads_s: dict[tuple[str, str], float] | None
    elevation: SiteElevation | None = None
    forecast: DayForecast | None = None
    folder: Path = Path()

    def obstacles(self, frame: LocalFrame) -> tuple[Obstacle, ...]:
        """What the day's flights must keep out of, on the day's terms."""
        if self.no_fly is None:
            return ()
        return obstacles_of(frame, self.no_fly, self.day.mission.zone_terms)

    def reach_note(self) -> str:
        """State how many of the day's zones and obstacles lie within reach; `""`: all do."""
        if self.no_fly is None:
            return ""
        note = reach_note(frame_at(self.day.depot.place), self.no_fly)
        return note and f"{self.day.no_fly}: {note}"
