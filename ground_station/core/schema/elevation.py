"""The ground about a day's depot, above mean sea level; and the strip of it for a vehicle."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import (
    LocalFrame,
    location_to_ground_ned_m,
    offset_position_deg,
)
from companion.core.base.location import Location
from companion.core.ground.ground_table import MAX_HEIGHTS, GroundTable
from companion.core.mission.flight_file import PLANE_MARGIN_M
from companion.core.mission.flight_plan import GROUND_TOLERANCE_M, depot_frame

GRID_SPACING_M = 30.0
"""Grid spacing of a strip: one second of arc, as in the public elevation models."""

STRIP_MARGIN_M = 300.0
"""Margin of a strip beyond its positions: room for detours around buildings."""


@dataclass(frozen=True, slots=True)
class SiteElevation:
    """Heights above mean sea level on a lattice of latitude and longitude, both rising; NaN:
    unknown. `datum`: the definition of mean sea level, and its source.
    """

    lat_deg: Floats
    lon_deg: Floats
    amsl_m: Floats
    datum: str

    def heights_amsl_at(self, lat_deg: Floats, lon_deg: Floats) -> Floats:
        """Return the heights at positions (n,), bilinear; NaN where unknown."""
        interpolator = RegularGridInterpolator(
            (self.lat_deg, self.lon_deg), self.amsl_m, bounds_error=False, fill_value=np.nan
        )
        return np.asarray(interpolator(np.stack([lat_deg, lon_deg], axis=-1)), np.float64)

    def height_amsl_at(self, lat_deg: float, lon_deg: float) -> float | None:
        """Return the height at one position; None where unknown."""
        height_m = float(self.heights_amsl_at(np.array([lat_deg]), np.array([lon_deg]))[0])
        return None if math.isnan(height_m) else height_m

    def bounds_around_m(
        self, frame: LocalFrame, positions_m: Sequence[Sequence[float]]
    ) -> tuple[float, float] | None:
        """Return the lowest and highest known ground about depot and positions, above the depot;
        None: unknown.
        """
        points = np.array([(0.0, 0.0), *(position[:2] for position in positions_m)])
        corners = np.stack([points.min(axis=0), points.max(axis=0)])
        corners += [[-PLANE_MARGIN_M], [PLANE_MARGIN_M]]
        home_deg = math.degrees(frame.lat_rad), math.degrees(frame.lon_rad)
        lat_deg, lon_deg = offset_position_deg(*home_deg, corners[:, 0], corners[:, 1])
        rows = slice(*np.searchsorted(self.lat_deg, lat_deg))
        columns = slice(*np.searchsorted(self.lon_deg, lon_deg))
        up_m = self.amsl_m[rows, columns] - frame.alt_amsl_m
        known = np.isfinite(up_m)
        return (float(up_m[known].min()), float(up_m[known].max())) if known.any() else None

    def ground_table_along_route(
        self, depot: Location, locations: Sequence[Location]
    ) -> GroundTable:
        """Return the ground about a flight's positions, aligned with the route to the first of
        them.

        Unknown heights stay unknown: the vehicle refuses a route over them. Raises LeewayError if
        the strip is too large for a command.
        """
        north_m, east_m, _ = location_to_ground_ned_m(depot_frame(depot), locations[0])
        return self.ground_table_around_positions(depot, locations, math.atan2(east_m, north_m))

    def ground_table_around_positions(
        self, depot: Location, locations: Sequence[Location], lattice_course_rad: float = 0.0
    ) -> GroundTable:
        """Return the same on a lattice of this course; 0: as in a CSV file."""
        frame = depot_frame(depot)
        ned_m = np.array(
            [
                (0.0, 0.0, 0.0),
                *(location_to_ground_ned_m(frame, location) for location in locations),
            ]
        )
        cos, sin = math.cos(lattice_course_rad), math.sin(lattice_course_rad)
        rotated = np.stack([ned_m[:, :2] @ (cos, sin), ned_m[:, :2] @ (-sin, cos)])
        forward_axis, lateral_axis = (_grid_axis_with_margin_m(values) for values in rotated)
        if forward_axis.size * lateral_axis.size > MAX_HEIGHTS:
            size = (
                f"{forward_axis.size} by {lateral_axis.size} heights, at most {MAX_HEIGHTS} in all"
            )
            raise LeewayError(f"the strip of ground about the flight's places has {size}")
        forward_grid, lateral_grid = np.meshgrid(forward_axis, lateral_axis, indexing="ij")
        lat_deg, lon_deg = offset_position_deg(
            depot.lat_deg or 0.0,
            depot.lon_deg or 0.0,
            (forward_grid * cos - lateral_grid * sin).ravel(),
            (forward_grid * sin + lateral_grid * cos).ravel(),
        )
        up = self.heights_amsl_at(lat_deg, lon_deg).reshape(forward_grid.shape) - (
            depot.alt_amsl_m or 0.0
        )
        rows = [[None if math.isnan(x) else round(float(x), 1) for x in row] for row in up]
        course_deg = math.degrees(lattice_course_rad)
        return GroundTable(
            longitudinal_m=forward_axis.tolist(),
            lateral_m=lateral_axis.tolist(),
            up_m=rows,
            course_deg=course_deg,
        )


def _grid_axis_with_margin_m(values_m: Floats) -> Floats:
    """Return even steps that extend `STRIP_MARGIN_M` beyond all values."""
    low, high = float(values_m.min()) - STRIP_MARGIN_M, float(values_m.max()) + STRIP_MARGIN_M
    first = math.floor(low / GRID_SPACING_M)
    return GRID_SPACING_M * np.arange(first, math.ceil(high / GRID_SPACING_M) + 1.0)


def depot_height_error_text(elevation: SiteElevation, depot: Location) -> str:
    """Return the difference between a depot's stated height and the tiles; `""`: it is small."""
    stated_m = depot.alt_amsl_m
    known_m = elevation.height_amsl_at(depot.lat_deg or 0.0, depot.lon_deg or 0.0)
    if stated_m is None or known_m is None or abs(known_m - stated_m) <= GROUND_TOLERANCE_M:
        return ""
    causes = {"feet?": 0.3048, "decimetres?": 0.1, "centimetres?": 0.01}
    cause = next(
        (
            f"tiles in {word}"
            for word, unit in causes.items()
            if abs(known_m * unit - stated_m) < 3.0
        ),
        "heights above the ellipsoid, or another height of the depot?",
    )
    return (
        f"depot.alt_amsl_m = {stated_m:g}: the tiles have {known_m:.1f} m there"
        f" ({elevation.datum}), expected a difference of at most {GROUND_TOLERANCE_M:g} m: {cause}"
    )


def stated_and_known_ground_heights(
    elevation: SiteElevation, depot: Location, locations: Sequence[Location]
) -> list[tuple[str, float, float | None]]:
    """Return name, stated ground and known ground of each position, above the depot's ground."""
    frame = depot_frame(depot)
    found: list[tuple[str, float, float | None]] = []
    for location in (depot, *locations):
        ned_m = location_to_ground_ned_m(frame, location)
        lat_rad, lon_rad, _ = frame.to_geodetic(ned_m)
        known_m = elevation.height_amsl_at(math.degrees(lat_rad), math.degrees(lon_rad))
        name = location.name or ("depot" if location is depot else "a rally point")
        found.append((name, -ned_m[2], None if known_m is None else known_m - frame.alt_amsl_m))
    return found
