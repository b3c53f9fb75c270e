"""Points of a GRIB2 grid around a position: of regular latitude and longitude, rotated, Lambert and
other projected grids.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import EARTH_RADIUS_M

MARGIN_POINTS = 1
"""Number of grid points kept beyond the cell around the position."""

REDUCED_GRIDS = ("reduced_ll", "reduced_gg", "sh", "unstructured_grid", "healpix")
"""Grids without rows and columns."""


@dataclass(slots=True)
class GridWindow:
    """Values on a small regular grid around the position, from those of a message's grid.

    `index`: points of the message, shape (corner, lat, lon); `weight`: of each corner, or None if
    the grids have the same points. `turn_rad`: direction of the grid's rows, counterclockwise from
    east, by which grid-relative wind is turned; None for wind relative to north.
    """

    lat_deg: Floats
    lon_deg: Floats
    index: Any
    weight: Floats | None = None
    turn_rad: Floats | None = None

    def values(self, message_values: Floats) -> Floats:
        """Return the values on the regular grid, shape (lat, lon). A missing value is NaN."""
        found = message_values[self.index]
        return found[0] if self.weight is None else (found * self.weight).sum(axis=0)

    def to_north_and_east(self, v: Floats, u: Floats) -> Floats:
        """Return north and east components, shape (lat, lon, 2)."""
        if self.turn_rad is not None:
            cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
            u, v = u * cos - v * sin, u * sin + v * cos
        return np.stack([v, u], axis=-1)


def grid_window(eccodes: Any, message: Any, lat_deg: float, lon_deg: float) -> GridWindow:
    """Return the points around a position.

    Raises LeewayError: a grid without rows and columns, a position outside the grid.
    """
    kind = eccodes.codes_get(message, "gridType")
    if kind in REDUCED_GRIDS:
        raise LeewayError(f"grid {kind}, expected rows and columns: cdo remapbil, wgrib2 -new_grid")
    lats = eccodes.codes_get_array(message, "latitudes")
    lons = eccodes.codes_get_array(message, "longitudes")
    lons = lon_deg + (lons - lon_deg + 180.0) % 360.0 - 180.0
    if kind == "regular_ll":
        return _regular_window(lats, lons, lat_deg, lon_deg)

    def flag(name: str) -> bool:
        return bool(eccodes.codes_get(message, name))

    if flag("alternativeRowScanning"):
        raise LeewayError("rows in alternating directions, expected one: cdo remapbil")
    columns, rows = eccodes.codes_get(message, "Nx"), eccodes.codes_get(message, "Ny")
    points = np.arange(lats.size)
    by_column = flag("jPointsAreConsecutive")
    points = points.reshape(columns, rows).T if by_column else points.reshape(rows, columns)
    if flag("iScansNegatively"):
        points = points[:, ::-1]
    is_relative_to_grid = flag("uvRelativeToGrid")
    return _projected_window(lats, lons, points, lat_deg, lon_deg, is_relative_to_grid)


def _regular_window(
    point_lats_deg: Floats, point_lons_deg: Floats, lat_deg: float, lon_deg: float
) -> GridWindow:
    lats, row = np.unique(point_lats_deg, return_inverse=True)
    lons, column = np.unique(point_lons_deg.round(9), return_inverse=True)
    rows = _axis_slice_around_position(lats, lat_deg, "latitude")
    columns = _axis_slice_around_position(lons, lon_deg, "longitude")
    index = np.full((lats.size, lons.size), -1)
    index[row, column] = np.arange(row.size)
    return GridWindow(lats[rows], lons[columns], index[None, rows, columns])


def _axis_slice_around_position(axis_deg: Floats, position_deg: float, axis_name: str) -> slice:
    low, high = float(axis_deg[0]), float(axis_deg[-1])
    if axis_deg.size < 2 or not low <= position_deg <= high:
        raise LeewayError(
            f"{axis_name} {position_deg:.5f} is outside the grid's {low:.3f} to {high:.3f}"
        )
    after = max(int(np.searchsorted(axis_deg, position_deg)), 1)
    return slice(max(0, after - 1 - MARGIN_POINTS), after + 1 + MARGIN_POINTS)


def _projected_window(
    lats_deg: Floats,
    lons_deg: Floats,
    points: Any,
    lat_deg: float,
    lon_deg: float,
    is_wind_relative_to_grid: bool,
) -> GridWindow:
    """Interpolate bilinearly in the grid's own rows and columns, at 3 x 3 positions one grid
    spacing apart.
    """
    east_scale = EARTH_RADIUS_M * math.cos(math.radians(lat_deg))
    east_m = (np.radians(lons_deg - lon_deg) * east_scale)[points]
    north_m = (np.radians(lats_deg - lat_deg) * EARTH_RADIUS_M)[points]
    row, column = np.unravel_index(np.argmin(np.hypot(east_m, north_m)), points.shape)
    if not (2 <= row < points.shape[0] - 2 and 2 <= column < points.shape[1] - 2):
        raise LeewayError(f"{lat_deg:.5f} {lon_deg:.5f} is outside the grid, or at its edge")

    def at(row_offset: int, column_offset: int) -> Floats:
        place = row + row_offset, column + column_offset
        return np.array([east_m[place], north_m[place]])

    per_column, per_row = (at(0, 1) - at(0, -1)) / 2.0, (at(1, 0) - at(-1, 0)) / 2.0
    spacing_m = min(math.hypot(*per_column), math.hypot(*per_row))
    steps = np.array([-1.0, 0.0, 1.0])
    target_east_m, target_north_m = np.meshgrid(steps * spacing_m, steps * spacing_m)
    offsets = np.stack([target_east_m, target_north_m], axis=-1) - at(0, 0)
    in_columns, in_rows = np.moveaxis(
        offsets @ np.linalg.inv(np.column_stack([per_column, per_row])).T, -1, 0
    )
    first_row, first_column = np.floor(in_rows).astype(int), np.floor(in_columns).astype(int)
    part_row, part_column = in_rows - first_row, in_columns - first_column
    corners = [
        (points[row + first_row + i, column + first_column + j], weight)
        for i, j, weight in (
            (0, 0, (1.0 - part_row) * (1.0 - part_column)),
            (0, 1, (1.0 - part_row) * part_column),
            (1, 0, part_row * (1.0 - part_column)),
            (1, 1, part_row * part_column),
        )
    ]
    turn_rad = np.full(part_row.shape, math.atan2(per_column[1], per_column[0]))
    return GridWindow(
        lat_deg + np.degrees(steps * spacing_m / EARTH_RADIUS_M),
        lon_deg + np.degrees(steps * spacing_m / east_scale),
        np.stack([index for index, _ in corners]),
        np.stack([weight for _, weight in corners]),
        turn_rad if is_wind_relative_to_grid else None,
    )
