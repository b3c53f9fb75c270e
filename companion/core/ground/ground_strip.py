"""The ground in a strip about the depot: its height at places, and the highest along a line."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.ground.ground_table import GroundTable

Ne = tuple[float, float]
"""North and east of the depot, metres."""

_SIGHT_STEPS = 4  # looks at a line for each of the lattice's shortest spacings


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest ground of some lines: where, and how high above the depot's."""

    north_m: float
    east_m: float
    up_m: float

    @property
    def place(self) -> str:
        """Where, for people."""
        return _place(self.north_m, self.east_m)


@dataclass(frozen=True, slots=True)
class NoGround:
    """Nobody knows the ground there: outside the strip, or a hole in it."""

    north_m: float
    east_m: float

    @property
    def place(self) -> str:
        """Where, for people."""
        return _place(self.north_m, self.east_m)


def _place(north_m: float, east_m: float) -> str:
    return f"{north_m:.0f} m north, {east_m:.0f} m east of the depot"


class GroundStrip:
    """A `GroundTable` that answers; unknown heights are NaN."""

    def __init__(self, table: GroundTable) -> None:
        self._along_m: Floats = np.array(table.along_m)
        self._across_m: Floats = np.array(table.across_m)
        self._up_m: Floats = np.array(table.up_m, dtype=np.float64)
        course_rad = math.radians(table.course_deg)
        self._cos, self._sin = math.cos(course_rad), math.sin(course_rad)
        spacings = np.diff(self._along_m), np.diff(self._across_m)
        self.cell_m = math.hypot(*(float(steps.max()) for steps in spacings))
        """The longest diagonal of the lattice's cells."""
        self._step_m = min(float(steps.min()) for steps in spacings) / _SIGHT_STEPS

    def up_m(self, ne_m: Floats) -> Floats:
        """Height above the depot's ground at places (n, 2); NaN where nobody knows it."""
        along = ne_m[:, 0] * self._cos + ne_m[:, 1] * self._sin
        across = ne_m[:, 1] * self._cos - ne_m[:, 0] * self._sin
        row, row_share = _cells(self._along_m, along)
        column, column_share = _cells(self._across_m, across)
        up = np.zeros(len(ne_m))
        for i, by_row in ((0, 1.0 - row_share), (1, row_share)):
            for j, by_column in ((0, 1.0 - column_share), (1, column_share)):
                weight = by_row * by_column
                # A height that counts for nothing may be unknown.
                up += np.where(weight == 0.0, 0.0, weight * self._up_m[row + i, column + j])
        inside = _within(self._along_m, along) & _within(self._across_m, across)
        return np.where(inside, up, np.nan)

    def up_at_m(self, place: Ned) -> float | None:
        """The height below one place; None where nobody knows it."""
        up = float(self.up_m(np.array([place[:2]]))[0])
        return None if math.isnan(up) else up

    def highest(self, a: Ned, b: Ned, aside_m: float) -> Peak | NoGround:
        """At least the highest ground within `aside_m` of the straight line from a to b.

        It is the highest point of all cells that the corridor may touch, since a bilinear cell is
        nowhere higher than its corners: at most the highest within a cell's diagonal more.
        """
        ends = np.array([self._turned(a), self._turned(b)])
        for end, place in zip(ends, (a, b), strict=True):
            if not self._has_about(end, aside_m):
                return NoGround(place[0], place[1])
        reach_m = aside_m + self.cell_m
        rows = _near(self._along_m, ends[:, 0], reach_m)
        columns = _near(self._across_m, ends[:, 1], reach_m)
        along, across = np.meshgrid(self._along_m[rows], self._across_m[columns], indexing="ij")
        up_m = self._up_m[rows, columns]
        away_m = _away_m(along, across, ends[0], ends[1])
        # What lies farther off than a cell's diagonal is in no cell that the corridor touches.
        touched = away_m <= reach_m
        unknown = touched & np.isnan(up_m)
        if unknown.any():
            at = np.argmin(np.where(unknown, away_m, np.inf))
            return NoGround(*self._straight(float(along.flat[at]), float(across.flat[at])))
        at = np.argmax(np.where(touched, up_m, -np.inf))
        north_m, east_m = self._straight(float(along.flat[at]), float(across.flat[at]))
        return Peak(north_m, east_m, float(up_m.flat[at]))

    def highest_known_m(self, place: Ned, within_m: float) -> float:
        """At least the highest known ground so near; -infinity where none is known."""
        at = np.array(self._turned(place))
        reach_m = within_m + self.cell_m
        rows = _near(self._along_m, at[:1], reach_m)
        columns = _near(self._across_m, at[1:], reach_m)
        up_m = self._up_m[rows, columns]
        return float(np.nanmax(up_m)) if np.isfinite(up_m).any() else -math.inf

    def span_m(self, ring_ne_m: Floats) -> tuple[float, float] | None:
        """At most the lowest and at least the highest ground in a ring (n, 2); None where some of
        it is unknown. It is that of the whole strip.
        """
        if np.isnan(self._up_m).any() or np.isnan(self.up_m(ring_ne_m)).any():
            return None
        return float(self._up_m.min()), float(self._up_m.max())

    def sees(self, a: Ned, b: Ned) -> bool | None:
        """Whether the straight line from a to b passes over the ground everywhere between.

        Looked at four times in each spacing of the lattice; None where ground is unknown.
        """
        length_m = math.hypot(b[0] - a[0], b[1] - a[1])
        steps = max(int(length_m / self._step_m), 1)
        share = np.linspace(0.0, 1.0, steps + 1)[1:-1, None]
        line = np.array(a) + share * (np.array(b) - np.array(a))
        over_m = -line[:, 2] - self.up_m(line[:, :2])
        if np.isnan(over_m).any():
            return None
        return bool(np.all(over_m > 0.0))

    def _turned(self, place: Ned) -> Ne:
        north, east, _ = place
        return north * self._cos + east * self._sin, east * self._cos - north * self._sin

    def _straight(self, along: float, across: float) -> Ne:
        return along * self._cos - across * self._sin, along * self._sin + across * self._cos

    def _has_about(self, place: Floats, aside_m: float) -> bool:
        spans = zip((self._along_m, self._across_m), place, strict=True)
        return all(axis[0] <= x - aside_m and x + aside_m <= axis[-1] for axis, x in spans)


def _cells(axis: Floats, values: Floats) -> tuple[np.ndarray, Floats]:
    """Index of the cell that holds each value, and the share of the way through it (clamped)."""
    index = np.clip(np.searchsorted(axis, values, side="right") - 1, 0, len(axis) - 2)
    share = (values - axis[index]) / (axis[index + 1] - axis[index])
    return index, np.clip(share, 0.0, 1.0)


def _within(axis: Floats, values: Floats) -> np.ndarray:
    return (axis[0] <= values) & (values <= axis[-1])


def _near(axis: Floats, ends: Floats, reach_m: float) -> slice:
    first = int(np.searchsorted(axis, ends.min() - reach_m))
    return slice(first, int(np.searchsorted(axis, ends.max() + reach_m, side="right")))


def _away_m(along: Floats, across: Floats, a: Floats, b: Floats) -> Floats:
    """Distance of points from a straight line's nearest point."""
    way = b - a
    square = float(way @ way)
    offset_m = along - a[0], across - a[1]
    share = 0.0
    if square > 0.0:
        share = np.clip((offset_m[0] * way[0] + offset_m[1] * way[1]) / square, 0.0, 1.0)
    return np.hypot(offset_m[0] - share * way[0], offset_m[1] - share * way[1])
