"""Ground heights in a strip about the depot: at positions, and the maximum along a line."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.ground.ground_table import GroundTable

Ne = tuple[float, float]
"""North and east of the depot, metres."""

_SIGHT_STEPS = 4  # checks per shortest spacing of the lattice


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest ground of some lines: position, and height above the depot's ground."""

    north_m: float
    east_m: float
    up_m: float

    @property
    def position_text(self) -> str:
        """Position as text for people."""
        return _position_text(self.north_m, self.east_m)


@dataclass(frozen=True, slots=True)
class UnknownGround:
    """Unknown ground at a position: outside the strip, or a hole in it."""

    north_m: float
    east_m: float

    @property
    def position_text(self) -> str:
        """Position as text for people."""
        return _position_text(self.north_m, self.east_m)


def _position_text(north_m: float, east_m: float) -> str:
    return f"{north_m:.0f} m north, {east_m:.0f} m east of the depot"


class GroundStrip:
    """Interpolates a `GroundTable`; unknown heights are NaN."""

    def __init__(self, table: GroundTable) -> None:
        self._longitudinal_m: Floats = np.array(table.longitudinal_m)
        self._lateral_m: Floats = np.array(table.lateral_m)
        self._up_m: Floats = np.array(table.up_m, dtype=np.float64)
        course_rad = math.radians(table.course_deg)
        self._cos, self._sin = math.cos(course_rad), math.sin(course_rad)
        spacings = np.diff(self._longitudinal_m), np.diff(self._lateral_m)
        self.cell_m = math.hypot(*(float(steps.max()) for steps in spacings))
        """The longest diagonal of the lattice's cells."""
        self._step_m = min(float(steps.min()) for steps in spacings) / _SIGHT_STEPS

    def ground_heights_m(self, positions_ne_m: Floats) -> Floats:
        """Return the height above the depot's ground at positions (n, 2); NaN if unknown."""
        longitudinal = positions_ne_m[:, 0] * self._cos + positions_ne_m[:, 1] * self._sin
        lateral = positions_ne_m[:, 1] * self._cos - positions_ne_m[:, 0] * self._sin
        row, row_share = _cell_indices_and_fractions(self._longitudinal_m, longitudinal)
        column, column_share = _cell_indices_and_fractions(self._lateral_m, lateral)
        up = np.zeros(len(positions_ne_m))
        for i, by_row in ((0, 1.0 - row_share), (1, row_share)):
            for j, by_column in ((0, 1.0 - column_share), (1, column_share)):
                weight = by_row * by_column
                # A height with weight 0 may be unknown.
                up += np.where(weight == 0.0, 0.0, weight * self._up_m[row + i, column + j])
        inside = _is_within_axis(self._longitudinal_m, longitudinal) & _is_within_axis(
            self._lateral_m, lateral
        )
        return np.where(inside, up, np.nan)

    def ground_height_below_m(self, position_ned_m: Ned) -> float | None:
        """Return the ground height below one position; None if unknown."""
        up = float(self.ground_heights_m(np.array([position_ned_m[:2]]))[0])
        return None if math.isnan(up) else up

    def highest_ground_in_corridor(
        self, a_ned_m: Ned, b_ned_m: Ned, aside_m: float
    ) -> Peak | UnknownGround:
        """Return an upper bound of the ground within `aside_m` of the straight line from a to b.

        It is the highest point of all cells that the corridor may touch, since a bilinear cell is
        nowhere higher than its corners, and at most the highest ground a cell's diagonal further.
        """
        ends = np.array(
            [self._to_longitudinal_lateral_m(a_ned_m), self._to_longitudinal_lateral_m(b_ned_m)]
        )
        for end, position in zip(ends, (a_ned_m, b_ned_m), strict=True):
            if not self._covers_with_margin(end, aside_m):
                return UnknownGround(position[0], position[1])
        radius_m = aside_m + self.cell_m
        rows = _axis_slice_near(self._longitudinal_m, ends[:, 0], radius_m)
        columns = _axis_slice_near(self._lateral_m, ends[:, 1], radius_m)
        longitudinal, lateral = np.meshgrid(
            self._longitudinal_m[rows], self._lateral_m[columns], indexing="ij"
        )
        up_m = self._up_m[rows, columns]
        away_m = _distances_to_segment_m(longitudinal, lateral, ends[0], ends[1])
        # A point more than a cell's diagonal away is in no cell that the corridor touches.
        touched = away_m <= radius_m
        unknown = touched & np.isnan(up_m)
        if unknown.any():
            at = np.argmin(np.where(unknown, away_m, np.inf))
            return UnknownGround(
                *self._to_north_east_m(float(longitudinal.flat[at]), float(lateral.flat[at]))
            )
        at = np.argmax(np.where(touched, up_m, -np.inf))
        north_m, east_m = self._to_north_east_m(
            float(longitudinal.flat[at]), float(lateral.flat[at])
        )
        return Peak(north_m, east_m, float(up_m.flat[at]))

    def highest_known_ground_m(self, position_ned_m: Ned, search_radius_m: float) -> float:
        """Return an upper bound of the known ground within a distance; -infinity if unknown."""
        at = np.array(self._to_longitudinal_lateral_m(position_ned_m))
        radius_m = search_radius_m + self.cell_m
        rows = _axis_slice_near(self._longitudinal_m, at[:1], radius_m)
        columns = _axis_slice_near(self._lateral_m, at[1:], radius_m)
        up_m = self._up_m[rows, columns]
        return float(np.nanmax(up_m)) if np.isfinite(up_m).any() else -math.inf

    def ground_height_bounds_m(self) -> tuple[float, float] | None:
        """Return the lowest and the highest ground of the strip; None if part of it is unknown."""
        if np.isnan(self._up_m).any():
            return None
        return float(self._up_m.min()), float(self._up_m.max())

    def has_line_of_sight(self, a: Ned, b: Ned) -> bool | None:
        """Return whether the straight line from a to b is above the ground all along.

        Checked four times per spacing of the lattice; None where ground is unknown.
        """
        length_m = math.hypot(b[0] - a[0], b[1] - a[1])
        steps = max(int(length_m / self._step_m), 1)
        share = np.linspace(0.0, 1.0, steps + 1)[1:-1, None]
        line = np.array(a) + share * (np.array(b) - np.array(a))
        over_m = -line[:, 2] - self.ground_heights_m(line[:, :2])
        if np.isnan(over_m).any():
            return None
        return bool(np.all(over_m > 0.0))

    def _to_longitudinal_lateral_m(self, position: Ned) -> Ne:
        north, east, _ = position
        return north * self._cos + east * self._sin, east * self._cos - north * self._sin

    def _to_north_east_m(self, longitudinal: float, lateral: float) -> Ne:
        return (
            longitudinal * self._cos - lateral * self._sin,
            longitudinal * self._sin + lateral * self._cos,
        )

    def _covers_with_margin(self, longitudinal_lateral_m: Floats, aside_m: float) -> bool:
        spans = zip((self._longitudinal_m, self._lateral_m), longitudinal_lateral_m, strict=True)
        return all(axis[0] <= x - aside_m and x + aside_m <= axis[-1] for axis, x in spans)


def _cell_indices_and_fractions(axis: Floats, values: Floats) -> tuple[np.ndarray, Floats]:
    """Return the index of each value's cell, and its fraction of the cell (clamped)."""
    index = np.clip(np.searchsorted(axis, values, side="right") - 1, 0, len(axis) - 2)
    share = (values - axis[index]) / (axis[index + 1] - axis[index])
    return index, np.clip(share, 0.0, 1.0)


def _is_within_axis(axis: Floats, values: Floats) -> np.ndarray:
    return (axis[0] <= values) & (values <= axis[-1])


def _axis_slice_near(axis: Floats, end_positions_m: Floats, radius_m: float) -> slice:
    first = int(np.searchsorted(axis, end_positions_m.min() - radius_m))
    return slice(first, int(np.searchsorted(axis, end_positions_m.max() + radius_m, side="right")))


def _distances_to_segment_m(longitudinal: Floats, lateral: Floats, a: Floats, b: Floats) -> Floats:
    """Return the distance of points from the nearest point of a line segment."""
    delta = b - a
    square = float(delta @ delta)
    offset_m = longitudinal - a[0], lateral - a[1]
    share = 0.0
    if square > 0.0:
        share = np.clip((offset_m[0] * delta[0] + offset_m[1] * delta[1]) / square, 0.0, 1.0)
    return np.hypot(offset_m[0] - share * delta[0], offset_m[1] - share * delta[1])
