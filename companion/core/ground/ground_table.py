"""Ground heights in files and messages."""

import itertools
import math
from collections.abc import Sequence

import msgspec

from companion.core.base.errors import LeewayError, check_range

MAX_HEIGHTS = 60_000
"""About 0.4 MB of JSON, with a site's obstacles in a command of at most 1 MB."""

MAX_DISTANCE_M = 100_000.0
MIN_HEIGHT_M, MAX_HEIGHT_M = -9500.0, 9500.0


class GroundTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Ground heights about the depot, on a lattice; bilinear between its points."""

    longitudinal_m: list[float] = msgspec.field(name="along_m")
    """Distances from the depot along the course, ascending."""
    lateral_m: list[float] = msgspec.field(name="across_m")
    """Distances to the right of the course, ascending."""
    up_m: list[list[float | None]]
    """Heights above the depot's ground, a row for each of `longitudinal_m`; null if unknown."""
    course_deg: float = 0.0
    """The lattice's course, clockwise from north; 0: along is north, across is east."""

    def __post_init__(self) -> None:
        check_range("course_deg", self.course_deg, -360.0, 360.0)
        _check_axis("along_m", self.longitudinal_m)
        _check_axis("across_m", self.lateral_m)
        rows, columns = len(self.longitudinal_m), len(self.lateral_m)
        if rows * columns > MAX_HEIGHTS:
            raise LeewayError(f"up_m: {rows * columns} heights, at most {MAX_HEIGHTS}")
        if len(self.up_m) != rows or any(len(row) != columns for row in self.up_m):
            raise LeewayError(f"up_m: expected {rows} rows of {columns} heights")
        for up_m in itertools.chain.from_iterable(self.up_m):
            if up_m is not None:
                check_range("up_m", up_m, MIN_HEIGHT_M, MAX_HEIGHT_M)


def _check_axis(name: str, axis: Sequence[float]) -> None:
    rising = all(a < b for a, b in itertools.pairwise(axis))
    if len(axis) < 2 or not rising or not all(math.isfinite(x) for x in axis):
        raise LeewayError(f"{name}: expected two or more rising values")
    if max(-axis[0], axis[-1]) > MAX_DISTANCE_M:
        raise LeewayError(f"{name}: at most {MAX_DISTANCE_M / 1000.0:g} km from the depot")
