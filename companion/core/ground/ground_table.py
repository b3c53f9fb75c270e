"""Heights of the ground as files and messages carry them."""

import itertools
import math
from collections.abc import Sequence

import msgspec

from companion.core.base.errors import LeewayError, check_range

MOST_HEIGHTS = 60_000
"""About 0.4 MB of JSON, beside a site's obstacles in a command of at most 1 MB."""

FARTHEST_M = 100_000.0
LOWEST_M, HIGHEST_M = -9500.0, 9500.0


class GroundTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Ground heights about the depot, on a lattice; between its points they are bilinear."""

    along_m: list[float]
    """Distances from the depot along the course, rising."""
    across_m: list[float]
    """Distances to the right of the course, rising."""
    up_m: list[list[float | None]]
    """Heights above the depot's ground, a row for each of `along_m`; null where nobody knows."""
    course_deg: float = 0.0
    """The lattice's course, clockwise from north; 0: along is north, across is east."""

    def __post_init__(self) -> None:
        check_range("course_deg", self.course_deg, -360.0, 360.0)
        _check_axis("along_m", self.along_m)
        _check_axis("across_m", self.across_m)
        rows, columns = len(self.along_m), len(self.across_m)
        if rows * columns > MOST_HEIGHTS:
            raise LeewayError(f"up_m: {rows * columns} heights, at most {MOST_HEIGHTS}")
        if len(self.up_m) != rows or any(len(row) != columns for row in self.up_m):
            raise LeewayError(f"up_m: expected {rows} rows of {columns} heights")
        for up_m in itertools.chain.from_iterable(self.up_m):
            if up_m is not None:
                check_range("up_m", up_m, LOWEST_M, HIGHEST_M)


def _check_axis(name: str, axis: Sequence[float]) -> None:
    rising = all(a < b for a, b in itertools.pairwise(axis))
    if len(axis) < 2 or not rising or not all(math.isfinite(x) for x in axis):
        raise LeewayError(f"{name}: expected two or more rising values")
    if max(-axis[0], axis[-1]) > FARTHEST_M:
        raise LeewayError(f"{name}: at most {FARTHEST_M / 1000.0:g} km from the depot")
