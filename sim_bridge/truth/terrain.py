"""Height of the ground about the depot: a plane, or a grid interpolated bilinearly."""

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from sim_bridge.truth.csv_table import read_numeric_table
from sim_bridge.truth.errors import TruthError


class Terrain(Protocol):
    """Ground height as a function of position."""

    def height_above_depot_m(self, north_m: float, east_m: float) -> float:
        """Height above the depot's ground point."""
        ...


class PlaneTerrain:
    """Ground that rises evenly; slopes are rise over run. The default is flat."""

    __slots__ = ("_slope_east", "_slope_north")

    def __init__(self, slope_north_frac: float = 0.0, slope_east_frac: float = 0.0) -> None:
        self._slope_north = slope_north_frac
        self._slope_east = slope_east_frac

    def height_above_depot_m(self, north_m: float, east_m: float) -> float:
        return self._slope_north * north_m + self._slope_east * east_m


class RotatedTerrain:
    """Ground whose own north is the course of a strip, clockwise from north."""

    __slots__ = ("_cos", "_ground", "_sin")

    def __init__(self, ground: Terrain, course_deg: float) -> None:
        self._ground = ground
        self._cos, self._sin = (f(math.radians(course_deg)) for f in (math.cos, math.sin))

    def height_above_depot_m(self, north_m: float, east_m: float) -> float:
        forward_m = self._cos * north_m + self._sin * east_m
        right = self._cos * east_m - self._sin * north_m
        return self._ground.height_above_depot_m(forward_m, right)


class GridTerrain:
    """Heights on a rectangular grid; outside it, the height of its edge."""

    __slots__ = ("_easts", "_norths", "_ups")

    def __init__(
        self, norths_m: Sequence[float], easts_m: Sequence[float], ups_m: Sequence[Sequence[float]]
    ) -> None:
        """`ups_m[i][j]` is the height at `norths_m[i]`, `easts_m[j]`; both axes rising."""
        for name, axis in (("north", norths_m), ("east", easts_m)):
            if len(axis) < 2 or any(b <= a for a, b in itertools.pairwise(axis)):
                raise TruthError(f"terrain grid: {name} axis: expected two or more rising values")
        if len(ups_m) != len(norths_m) or any(len(row) != len(easts_m) for row in ups_m):
            raise TruthError(
                f"terrain grid: expected {len(norths_m)} rows of {len(easts_m)} heights"
            )
        self._norths = list(norths_m)
        self._easts = list(easts_m)
        self._ups = [list(row) for row in ups_m]

    def height_above_depot_m(self, north_m: float, east_m: float) -> float:
        row, north_share = _cell_index_and_fraction(self._norths, north_m)
        column, east_share = _cell_index_and_fraction(self._easts, east_m)
        south, north = self._ups[row], self._ups[row + 1]
        low = south[column] + east_share * (south[column + 1] - south[column])
        high = north[column] + east_share * (north[column + 1] - north[column])
        return low + north_share * (high - low)


def _cell_index_and_fraction(axis: list[float], value: float) -> tuple[int, float]:
    """Return the index of the cell that holds a value, and the fraction across it (clamped)."""
    index = min(max(bisect_right(axis, value) - 1, 0), len(axis) - 2)
    share = (value - axis[index]) / (axis[index + 1] - axis[index])
    return index, min(max(share, 0.0), 1.0)


COLUMNS = ("east_m", "north_m", "up_m")


def load_grid_terrain(path: Path) -> GridTerrain:
    """The grid in a CSV file; rows in any order, every crossing of its axes exactly once.

    TruthError names file, line and column of the first mistake, or the crossing that is missing.
    """
    heights: dict[tuple[float, float], float] = {}
    for line, (east, north, up) in read_numeric_table(path, COLUMNS, in_order=True):
        if (north, east) in heights:
            raise TruthError(f"{path}: line {line}: the same point once more")
        heights[north, east] = up
    norths = sorted({north for north, _ in heights})
    easts = sorted({east for _, east in heights})
    for north, east in itertools.product(norths, easts):
        if (north, east) not in heights:
            raise TruthError(f"{path}: no height at east_m = {east:g}, north_m = {north:g}")
    try:
        return GridTerrain(norths, easts, [[heights[n, e] for e in easts] for n in norths])
    except TruthError as error:
        raise TruthError(f"{path}: {error}") from error
