"""The way that a drone's mission takes, as it is aboard."""

from dataclasses import dataclass, field

from companion.fleet.polyline import Point


@dataclass(frozen=True, slots=True)
class RouteAboard:
    """Waypoints out to the customer and home from there. `places`: where it could land instead."""

    out: tuple[Point, ...]
    home: tuple[Point, ...]
    places: dict[str, Point] = field(default_factory=dict)
