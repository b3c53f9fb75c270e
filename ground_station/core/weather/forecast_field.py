"""The forecast wind over time, height above ground and position, with its spread."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame

POINT_RADIUS_M = 15_000.0
"""Validity radius of a forecast of a single point: about a cell of a global model."""

DEFAULT_STD_MPS = 2.0
"""Error of a forecast without members, one sigma of each component, as in `day/1`. An assumption of
this project; ensembles or the fleet's measurements are more accurate.
"""

GUST_PEAK = 3.0
"""Peak of a gust over the mean, in standard deviations of the turbulence: about 3 for ten minutes
(Davenport, Proc. ICE 28, 1964).
"""


@dataclass(frozen=True, slots=True)
class WindAt:
    """The forecast wind at a time, height and position; `std_mps`: one sigma of each component."""

    to_ne_mps: tuple[float, float]
    std_mps: float

    @property
    def speed_mps(self) -> float:
        """Mean wind speed."""
        return math.hypot(*self.to_ne_mps)

    @property
    def from_deg(self) -> float:
        """Direction that the wind blows from, clockwise from north."""
        return math.degrees(math.atan2(-self.to_ne_mps[1], -self.to_ne_mps[0])) % 360.0

    def __str__(self) -> str:
        return f"{self.speed_mps:.1f} m/s from {self.from_deg:.0f}"


@dataclass(frozen=True, slots=True)
class OutsideForecast:
    """A time, height or position outside the forecast."""

    reason: str


@dataclass(frozen=True, slots=True)
class ForecastField:
    """Winds on a lattice of times (UTC, Unix seconds), heights above ground, and positions.

    `unix_s` (t,), `lat_deg` (y,) and `lon_deg` (x,) rise; `height_m` and `std_mps` are (t, h, y,
    x), because pressure levels move with time; `to_ne_mps` (t, h, y, x, 2) is the motion of the
    air. NaN: unknown. `spread`: source of the spread, as text.
    """

    t_s: Floats
    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    to_ne_mps: Floats
    std_mps: Floats
    spread: str

    def __post_init__(self) -> None:
        if self.t_s.size < 2:
            raise LeewayError(f"{self.t_s.size} times, expected 2 or more")
        unsorted = np.flatnonzero(np.diff(self.t_s) <= 0.0)
        if unsorted.size:
            before, after = (float(t_s) for t_s in self.t_s[unsorted[0] : unsorted[0] + 2])
            raise LeewayError(
                f"{format_utc(after)} comes after {format_utc(before)}, expected times that ascend"
            )
        if not np.isfinite(self._finite_where_known()).any():
            raise LeewayError("no wind at any height, expected one at two heights or more")

    @property
    def start_unix_s(self) -> float:
        """The first time."""
        return float(self.t_s[0])

    @property
    def end_unix_s(self) -> float:
        """The last time."""
        return float(self.t_s[-1])

    @property
    def has_single_position(self) -> bool:
        """True if it has one position only."""
        return self.lat_deg.size == 1 and self.lon_deg.size == 1

    def wind_at_unix_time(
        self, unix_s: float, height_m: float, lat_deg: float, lon_deg: float
    ) -> WindAt | OutsideForecast | None:
        """Return the wind: linear in time, bilinear in position, linear in the logarithm of the
        height.

        The last is the neutral surface layer's law (Stull, An Introduction to Boundary Layer
        Meteorology, 1988, eq. 9.7.1). None: the forecast has no value there.
        """
        if not self.start_unix_s <= unix_s <= self.end_unix_s:
            span = f"{format_utc(self.start_unix_s)} to {format_utc(self.end_unix_s)}"
            return OutsideForecast(f"{format_utc(unix_s)} is outside the forecast's {span}")
        corners = self._grid_indices_and_weights(lat_deg, lon_deg)
        if isinstance(corners, OutsideForecast):
            return corners
        sums = np.zeros(3)
        for at, weight_t in _bracketing_indices_and_weights(self.t_s, unix_s):
            for row, column, weight in corners:
                found = self._column_wind(at, row, column, height_m)
                if not isinstance(found, np.ndarray):
                    return found
                sums += weight_t * weight * found
        return WindAt((float(sums[0]), float(sums[1])), float(sums[2]))

    def _finite_where_known(self) -> Floats:
        """Return a finite value where all is known, else NaN; heights below ground are unknown."""
        above = np.where(self.height_m > 0.0, self.height_m, np.nan)
        return above + self.to_ne_mps.sum(axis=-1) + self.std_mps

    def _grid_indices_and_weights(
        self, lat_deg: float, lon_deg: float
    ) -> list[tuple[int, int, float]] | OutsideForecast:
        """Return the rows and columns about a position, with their weights."""
        revolutions = round((float(self.lon_deg.mean()) - lon_deg) / 360.0)
        lon_deg += 360.0 * revolutions
        if self.has_single_position:
            return self._point_index_and_weight(lat_deg, lon_deg)
        south, north = float(self.lat_deg[0]), float(self.lat_deg[-1])
        west, east = float(self.lon_deg[0]), float(self.lon_deg[-1])
        if not (south <= lat_deg <= north and west <= lon_deg <= east):
            box = f"{south:.3f} to {north:.3f}, {west:.3f} to {east:.3f}"
            position_text = f"{lat_deg:.5f}, {lon_deg:.5f}"
            return OutsideForecast(f"{position_text} is outside the forecast's grid ({box})")
        return [
            (row, column, up * right)
            for row, up in _bracketing_indices_and_weights(self.lat_deg, lat_deg)
            for column, right in _bracketing_indices_and_weights(self.lon_deg, lon_deg)
        ]

    def _point_index_and_weight(
        self, lat_deg: float, lon_deg: float
    ) -> list[tuple[int, int, float]] | OutsideForecast:
        lat, lon = float(self.lat_deg[0]), float(self.lon_deg[0])
        away_m = distance_m(lat, lon, lat_deg, lon_deg)
        if away_m <= POINT_RADIUS_M:
            return [(0, 0, 1.0)]
        return OutsideForecast(
            f"{lat_deg:.5f}, {lon_deg:.5f} is {away_m / 1000.0:.0f} km from the forecast's point"
            f" {lat:.3f}, {lon:.3f}, expected at most {POINT_RADIUS_M / 1000.0:.0f} km"
        )

    def _column_wind(
        self, time_index: int, row: int, column: int, height_m: float
    ) -> Floats | OutsideForecast | None:
        """Return north, east and spread at a height over one point of the lattice."""
        up_m = self.height_m[time_index, :, row, column]
        values = np.column_stack(
            [self.to_ne_mps[time_index, :, row, column], self.std_mps[time_index, :, row, column]]
        )
        known = np.isfinite(values).all(axis=1) & (up_m > 0.0)
        if not known.any():
            return None
        order = np.argsort(up_m[known])
        up_m, values = up_m[known][order], values[known][order]
        if not up_m[0] <= height_m <= up_m[-1]:
            span = f"{up_m[0]:.0f} to {up_m[-1]:.0f} m above ground"
            return OutsideForecast(
                f"{height_m:.0f} m is outside the forecast's heights, {span}, at"
                f" {format_utc(float(self.t_s[time_index]))}"
            )
        logs = np.log(up_m)
        return np.array([np.interp(math.log(height_m), logs, line) for line in values.T])


def distance_m(lat_a_deg: float, lon_a_deg: float, lat_b_deg: float, lon_b_deg: float) -> float:
    """Return the distance between two positions, along the chord for long distances."""
    frame = LocalFrame(math.radians(lat_a_deg), math.radians(lon_a_deg), 0.0)
    return math.hypot(*frame.to_ned(math.radians(lat_b_deg), math.radians(lon_b_deg), 0.0))


def ensemble_mean_and_std(member_ne_mps: Floats) -> tuple[Floats, Floats]:
    """Return the mean (..., 2) and one sigma (...) of a component, over members (m, ..., 2)."""
    mean = member_ne_mps.mean(axis=0)
    variance = member_ne_mps.var(axis=0, ddof=1)
    return mean, np.sqrt(variance.mean(axis=-1))


def std_without_members_mps(
    array_of_result_shape: Floats, gust_over_mean_mps: Floats | None
) -> Floats:
    """Return one sigma without members: the default, or the turbulence of gusts if larger."""
    least = np.full(array_of_result_shape.shape, DEFAULT_STD_MPS)
    if gust_over_mean_mps is None:
        return least
    return np.fmax(least, gust_over_mean_mps / GUST_PEAK)


def format_utc(unix_s: float) -> str:
    """Format a time to the minute."""
    return datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _bracketing_indices_and_weights(axis: Floats, value: float) -> list[tuple[int, float]]:
    """Return the indices on an axis about a value within it, with their weights."""
    if axis.size == 1:
        return [(0, 1.0)]
    after = min(max(int(np.searchsorted(axis, value)), 1), axis.size - 1)
    share = (value - axis[after - 1]) / (axis[after] - axis[after - 1])
    both = ((after - 1, 1.0 - float(share)), (after, float(share)))
    return [(at, weight) for at, weight in both if weight > 0.0]
