"""The ground about a day's depot, above mean sea level; and the strip of it that a vehicle gets."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import moved_deg, place_ned
from companion.core.base.place import Place
from companion.core.ground.ground_table import MOST_HEIGHTS, GroundTable
from companion.core.mission.flight_plan import frame_at

SPACING_M = 30.0
"""Of a strip's heights: one second of arc, as the public models have them."""

ASIDE_M = 300.0
"""How far a strip reaches beyond its places: room for detours round what is built."""


@dataclass(frozen=True, slots=True)
class SiteElevation:
    """Heights above mean sea level on a lattice of latitude and longitude, both rising; NaN where
    nobody knows one. `datum` says what mean sea level is, and how that is known.
    """

    lat_deg: Floats
    lon_deg: Floats
    amsl_m: Floats
    datum: str

    def at(self, lat_deg: Floats, lon_deg: Floats) -> Floats:
        """Heights at places (n,), bilinear; NaN where nobody knows them."""
        look = RegularGridInterpolator(
            (self.lat_deg, self.lon_deg), self.amsl_m, bounds_error=False, fill_value=np.nan
        )
        return np.asarray(look(np.stack([lat_deg, lon_deg], axis=-1)), np.float64)

    def at_place(self, lat_deg: float, lon_deg: float) -> float | None:
        """The height at one place; None where nobody knows it."""
        height_m = float(self.at(np.array([lat_deg]), np.array([lon_deg]))[0])
        return None if math.isnan(height_m) else height_m

    def strip(self, depot: Place, places: Sequence[Place]) -> GroundTable:
        """The ground about a flight's places, turned along the way to the first of them.

        Unknown heights stay unknown: the vehicle refuses what leads over them. LeewayError where
        the places lie too far apart for a command.
        """
        north_m, east_m, _ = place_ned(frame_at(depot), places[0])
        return self.table(depot, places, math.atan2(east_m, north_m))

    def table(self, depot: Place, places: Sequence[Place], course_rad: float = 0.0) -> GroundTable:
        """The same on a lattice of this course; 0: as a CSV file has it."""
        frame = frame_at(depot)
        ned_m = np.array([(0.0, 0.0, 0.0), *(place_ned(frame, place) for place in places)])
        cos, sin = math.cos(course_rad), math.sin(course_rad)
        turned = np.stack([ned_m[:, :2] @ (cos, sin), ned_m[:, :2] @ (-sin, cos)])
        along, across = (_axis(values) for values in turned)
        if along.size * across.size > MOST_HEIGHTS:
            size = f"{along.size} by {across.size} heights, at most {MOST_HEIGHTS} in all"
            raise LeewayError(f"the strip of ground about the flight's places has {size}")
        ahead, right = np.meshgrid(along, across, indexing="ij")
        lat_deg, lon_deg = _degrees(
            depot, (ahead * cos - right * sin).ravel(), (ahead * sin + right * cos).ravel()
        )
        up = self.at(lat_deg, lon_deg).reshape(ahead.shape) - (depot.alt_amsl_m or 0.0)
        rows = [[None if math.isnan(x) else round(float(x), 1) for x in row] for row in up]
        course_deg = math.degrees(course_rad)
        return GroundTable(
            along_m=along.tolist(), across_m=across.tolist(), up_m=rows, course_deg=course_deg
        )


def _axis(values: Floats) -> Floats:
    """Even steps that reach far enough beyond all values."""
    low, high = float(values.min()) - ASIDE_M, float(values.max()) + ASIDE_M
    first = math.floor(low / SPACING_M)
    return SPACING_M * np.arange(first, math.ceil(high / SPACING_M) + 1.0)


def _degrees(depot: Place, north_m: Floats, east_m: Floats) -> tuple[Floats, Floats]:
    return moved_deg(depot.lat_deg or 0.0, depot.lon_deg or 0.0, north_m, east_m)


def grounds_of(
    elevation: SiteElevation, depot: Place, places: Sequence[Place]
) -> list[tuple[str, float, float | None]]:
    """Of the depot and each place: its name, its ground as stated above the depot's, as known."""
    frame = frame_at(depot)
    found: list[tuple[str, float, float | None]] = []
    for place in (depot, *places):
        ned_m = place_ned(frame, place)
        lat_rad, lon_rad, _ = frame.to_geodetic(ned_m)
        known_m = elevation.at_place(math.degrees(lat_rad), math.degrees(lon_rad))
        name = place.name or ("depot" if place is depot else "a rally point")
        found.append((name, -ned_m[2], None if known_m is None else known_m - frame.alt_amsl_m))
    return found
