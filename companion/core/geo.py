"""The local frame about the depot, and what stands in it.

Horizontal positions are pymap3d's local tangent NED about the depot; `down` is minus the height
above the depot's ground (AMSL difference), not above the tangent plane, because autopilots fly
barometric heights: at 5 km the two differ by 2 m.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.flight import Place

Ned = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Geodetic origin of the NED frame: the depot's ground point (or EKF home), radians, AMSL."""

    lat_rad: float
    lon_rad: float
    alt_amsl_m: float

    def to_ned(self, lat_rad: float, lon_rad: float, alt_amsl_m: float) -> Ned:
        """Position about the origin, metres."""
        raise NotImplementedError

    def to_geodetic(self, ned_m: Ned) -> tuple[float, float, float]:
        """(latitude rad, longitude rad, height AMSL m) of a local position."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A prism from the ground to `height_m` above the depot; ring as (north, east) metres."""

    name: str
    ring_ne_m: tuple[tuple[float, float], ...]
    height_m: float


def place_ned(frame: LocalFrame, place: Place) -> Ned:
    """The GROUND point of a place of the flight file (down = minus its height above the depot)."""
    raise NotImplementedError


def obstacles_from_geojson(frame: LocalFrame, document: dict[str, Any]) -> tuple[Obstacle, ...]:
    """Polygons of a GeoJSON FeatureCollection (lon, lat degrees; property `height_m` above depot).

    Raises LeewayError naming the feature that breaks the format.
    """
    raise NotImplementedError


class ObstacleMap:
    """Answers whether a straight line at a height keeps clear of every obstacle."""

    def __init__(
        self, obstacles: tuple[Obstacle, ...], clearance_m: float, clearance_up_m: float
    ) -> None:
        raise NotImplementedError

    def blocking(self, a_ned_m: Ned, b_ned_m: Ned) -> Obstacle | None:
        """The first obstacle within clearance of the segment a-b, or None."""
        raise NotImplementedError

    def highest_m(self, a_ned_m: Ned, b_ned_m: Ned) -> float:
        """Height above the depot of the tallest obstacle within clearance of a-b (0 if none)."""
        raise NotImplementedError


def wrap_pi(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


def course_rad(a_ned_m: Ned, b_ned_m: Ned) -> float:
    """Course from a to b, clockwise from north."""
    return float(np.arctan2(b_ned_m[1] - a_ned_m[1], b_ned_m[0] - a_ned_m[0]))


def horizontal_m(a_ned_m: Ned, b_ned_m: Ned) -> float:
    """Horizontal distance."""
    return float(np.hypot(b_ned_m[0] - a_ned_m[0], b_ned_m[1] - a_ned_m[1]))
