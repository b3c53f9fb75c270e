"""The wind at one place, height and time, as a site's field has it."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field.field_process import FieldPoints
from companion.core.wind_field.settled_field import SettledField
from companion.core.wind_field.tellings import WindTelling
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_forecast import LEAST_STD_MPS, MOST_SPEED_MPS, MOST_STD_MPS

Vector = tuple[float, float]
"""North and east."""


@dataclass(frozen=True, slots=True)
class BelievedWind:
    """The wind at a place, height and time, where the air moves to, and its covariance nn, ne, ee.

    The two axes are independent: ne is 0.
    """

    to_ne_mps: Vector
    cov_m2ps2: tuple[float, float, float]

    @property
    def speed_mps(self) -> float:
        """The mean wind."""
        return math.hypot(*self.to_ne_mps)

    @property
    def from_deg(self) -> float:
        """Where it blows from, clockwise from north."""
        return blows_from_deg(self.to_ne_mps)

    @property
    def std_mps(self) -> float:
        """Its error on one axis: the larger one, one sigma."""
        return math.sqrt(max(self.cov_m2ps2[0], self.cov_m2ps2[2]))

    @property
    def forecast(self) -> Forecast:
        """The same as the constant wind of a day, within what a day can state."""
        return Forecast(
            speed_mps=min(self.speed_mps, MOST_SPEED_MPS),
            from_deg=self.from_deg,
            std_mps=min(max(self.std_mps, LEAST_STD_MPS), MOST_STD_MPS),
        )

    def misfit_square(self, told: WindTelling) -> float:
        """Chi-square of two degrees of a telling under this wind."""
        off = np.subtract(told.mean_to_ne_mps, self.to_ne_mps)
        variance = self.cov_m2ps2[0], self.cov_m2ps2[2]
        return float(np.sum(off**2 / np.add(told.variance_m2ps2, variance)))


def believed_at(
    field: SettledField, place_ne_m: Vector, height_m: float, t_s: float, averaged_s: float
) -> BelievedWind:
    """The wind of a field, as a mean over `averaged_s` about a time."""
    points = FieldPoints(np.array([place_ne_m]), np.array([height_m]), np.array([t_s]))
    found = field.forecast(points, averaged_s)
    north, east = (float(x) for x in found.mean_to_ne_mps[0])
    nn, ee = _only(found.north_cov_m2ps2), _only(found.east_cov_m2ps2)
    return BelievedWind((north, east), (nn, 0.0, ee))


def blows_from_deg(to_ne_mps: Vector) -> float:
    """Where a wind blows from, clockwise from north."""
    north, east = to_ne_mps
    return math.degrees(math.atan2(-east, -north)) % 360.0


def _only(cov: Floats) -> float:
    return float(cov[0, 0])
