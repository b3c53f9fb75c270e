"""The forecast wind over time, height above ground and place, with its spread."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame

NEAR_M = 15_000.0
"""How far a forecast of a single point serves: about a cell of a global model."""

DEFAULT_STD_MPS = 2.0
"""Error of a forecast without members, one sigma of each component: as `day/1` has it. Stated by
us; ensembles, or what your fleet has felt, say more.
"""

GUST_PEAK = 3.0
"""A gust over the mean, in standard deviations of the turbulence: about 3 for ten minutes
(Davenport, Proc. ICE 28, 1964).
"""


@dataclass(frozen=True, slots=True)
class WindAt:
    """The forecast wind at one time, height and place; `std_mps`: one sigma of each component."""

    to_ne_mps: tuple[float, float]
    std_mps: float

    @property
    def speed_mps(self) -> float:
        """The mean wind."""
        return math.hypot(*self.to_ne_mps)

    @property
    def from_deg(self) -> float:
        """Where it blows from, clockwise from north."""
        return math.degrees(math.atan2(-self.to_ne_mps[1], -self.to_ne_mps[0])) % 360.0

    def __str__(self) -> str:
        return f"{self.speed_mps:.1f} m/s from {self.from_deg:.0f}"


@dataclass(frozen=True, slots=True)
class OutsideForecast:
    """The forecast does not reach there: in time, height or place."""

    why: str


@dataclass(frozen=True, slots=True)
class ForecastField:
    """Winds on a lattice of times (UTC, Unix seconds), heights above ground, and places.

    `t_s` (t,), `lat_deg` (y,) and `lon_deg` (x,) rise; `height_m` and `std_mps` are (t, h, y, x),
    for pressure levels move with time; `to_ne_mps` (t, h, y, x, 2) is where the air moves to. NaN:
    unknown. `spread` says how the spread is known.
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
        late = np.flatnonzero(np.diff(self.t_s) <= 0.0)
        if late.size:
            before, after = (float(t_s) for t_s in self.t_s[late[0] : late[0] + 2])
            raise LeewayError(
                f"{utc_words(after)} comes after {utc_words(before)}, expected times that ascend"
            )
        if not np.isfinite(self._known()).any():
            raise LeewayError("no wind at any height, expected one at two heights or more")

    @property
    def from_s(self) -> float:
        """The first time."""
        return float(self.t_s[0])

    @property
    def until_s(self) -> float:
        """The last time."""
        return float(self.t_s[-1])

    @property
    def is_point(self) -> bool:
        """Whether it has one place only."""
        return self.lat_deg.size == 1 and self.lon_deg.size == 1

    def at(
        self, t_s: float, height_m: float, lat_deg: float, lon_deg: float
    ) -> WindAt | OutsideForecast | None:
        """The wind: linear in time, bilinear in place, linear in the logarithm of the height.

        The last is the law of the neutral surface layer (Stull, An Introduction to Boundary Layer
        Meteorology, 1988, eq. 9.7.1). None: the forecast has no value there.
        """
        if not self.from_s <= t_s <= self.until_s:
            span = f"{utc_words(self.from_s)} to {utc_words(self.until_s)}"
            return OutsideForecast(f"{utc_words(t_s)} is outside the forecast's {span}")
        corners = self._corners(lat_deg, lon_deg)
        if isinstance(corners, OutsideForecast):
            return corners
        sums = np.zeros(3)
        for at, weight_t in _between(self.t_s, t_s):
            for row, column, weight in corners:
                found = self._in_column(at, row, column, height_m)
                if not isinstance(found, np.ndarray):
                    return found
                sums += weight_t * weight * found
        return WindAt((float(sums[0]), float(sums[1])), float(sums[2]))

    def _known(self) -> Floats:
        """NaN wherever something is unknown; heights below ground are."""
        above = np.where(self.height_m > 0.0, self.height_m, np.nan)
        return above + self.to_ne_mps.sum(axis=-1) + self.std_mps

    def _corners(
        self, lat_deg: float, lon_deg: float
    ) -> list[tuple[int, int, float]] | OutsideForecast:
        """Rows and columns about a place, with their weights."""
        turns = round((float(self.lon_deg.mean()) - lon_deg) / 360.0)
        lon_deg += 360.0 * turns
        if self.is_point:
            return self._single(lat_deg, lon_deg)
        south, north = float(self.lat_deg[0]), float(self.lat_deg[-1])
        west, east = float(self.lon_deg[0]), float(self.lon_deg[-1])
        if not (south <= lat_deg <= north and west <= lon_deg <= east):
            box = f"{south:.3f} to {north:.3f}, {west:.3f} to {east:.3f}"
            place = f"{lat_deg:.5f}, {lon_deg:.5f}"
            return OutsideForecast(f"{place} is outside the forecast's grid ({box})")
        return [
            (row, column, up * right)
            for row, up in _between(self.lat_deg, lat_deg)
            for column, right in _between(self.lon_deg, lon_deg)
        ]

    def _single(
        self, lat_deg: float, lon_deg: float
    ) -> list[tuple[int, int, float]] | OutsideForecast:
        lat, lon = float(self.lat_deg[0]), float(self.lon_deg[0])
        away_m = distance_m(lat, lon, lat_deg, lon_deg)
        if away_m <= NEAR_M:
            return [(0, 0, 1.0)]
        return OutsideForecast(
            f"{lat_deg:.5f}, {lon_deg:.5f} is {away_m / 1000.0:.0f} km from the forecast's point"
            f" {lat:.3f}, {lon:.3f}, expected at most {NEAR_M / 1000.0:.0f} km"
        )

    def _in_column(
        self, at: int, row: int, column: int, height_m: float
    ) -> Floats | OutsideForecast | None:
        """North, east and spread at a height over one point of the lattice."""
        up_m = self.height_m[at, :, row, column]
        values = np.column_stack(
            [self.to_ne_mps[at, :, row, column], self.std_mps[at, :, row, column]]
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
                f" {utc_words(float(self.t_s[at]))}"
            )
        logs = np.log(up_m)
        return np.array([np.interp(math.log(height_m), logs, line) for line in values.T])


def distance_m(lat_a_deg: float, lon_a_deg: float, lat_b_deg: float, lon_b_deg: float) -> float:
    """Between two places, through the ground where they are far apart."""
    frame = LocalFrame(math.radians(lat_a_deg), math.radians(lon_a_deg), 0.0)
    return math.hypot(*frame.to_ned(math.radians(lat_b_deg), math.radians(lon_b_deg), 0.0))


def spread_of(member_ne_mps: Floats) -> tuple[Floats, Floats]:
    """Mean (..., 2) and one sigma (...) of a component, over members (m, ..., 2)."""
    mean = member_ne_mps.mean(axis=0)
    variance = member_ne_mps.var(axis=0, ddof=1)
    return mean, np.sqrt(variance.mean(axis=-1))


def single_std_mps(shape_mps: Floats, gust_over_mean_mps: Floats | None) -> Floats:
    """One sigma where there are no members: the default, or the turbulence of gusts if larger."""
    least = np.full(shape_mps.shape, DEFAULT_STD_MPS)
    if gust_over_mean_mps is None:
        return least
    return np.fmax(least, gust_over_mean_mps / GUST_PEAK)


def utc_words(t_s: float) -> str:
    """A time for people, to the minute."""
    return datetime.fromtimestamp(t_s, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _between(axis: Floats, value: float) -> list[tuple[int, float]]:
    """The places on an axis about a value that lies within it, with their weights."""
    if axis.size == 1:
        return [(0, 1.0)]
    after = min(max(int(np.searchsorted(axis, value)), 1), axis.size - 1)
    share = (value - axis[after - 1]) / (axis[after] - axis[after - 1])
    both = ((after - 1, 1.0 - float(share)), (after, float(share)))
    return [(at, weight) for at, weight in both if weight > 0.0]
