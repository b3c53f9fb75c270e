"""A day with everything that its files hold, as the planner takes it."""

from dataclasses import dataclass
from typing import Any

from companion.core.vehicle.airframe import Airframe
from ground_station.core.schema.day import Day
from ground_station.core.schema.orders import Order

DEPOT = "depot"
"""The depot's name in a matrix of road times."""


@dataclass(frozen=True, slots=True)
class DayData:
    """`roads_s` is None where the truck's speed rules: else seconds from one place (`depot`, or an
    order's id) to another. `no_fly` is the GeoJSON document.
    """

    day: Day
    orders: list[Order]
    no_fly: dict[str, Any] | None
    airframes: dict[str, Airframe]
    roads_s: dict[tuple[str, str], float] | None
