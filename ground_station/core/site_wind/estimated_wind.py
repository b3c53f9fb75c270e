"""The estimated wind at one position, height and time."""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field.field_process import FieldPoints
from companion.core.wind_field.settled_field import FieldEstimate
from companion.core.wind_field.wind_reports import MemberWindReport
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_forecast import MAX_SPEED_MPS, MAX_STD_MPS, MIN_STD_MPS

VectorNe = tuple[float, float]
"""North and east."""


@dataclass(frozen=True, slots=True)
class SiteWindEstimate:
    """Wind estimate at a position, height and time: air motion, and covariance nn, ne, ee.

    The two axes are independent: ne is 0.
    """

    to_ne_mps: VectorNe
    cov_m2ps2: tuple[float, float, float]

    @property
    def speed_mps(self) -> float:
        """Mean wind speed."""
        return math.hypot(*self.to_ne_mps)

    @property
    def from_deg(self) -> float:
        """Direction that the wind blows from, clockwise from north."""
        return wind_from_direction_deg(self.to_ne_mps)

    @property
    def larger_axis_std_mps(self) -> float:
        """Standard error of one axis: the larger one, one sigma."""
        return math.sqrt(max(self.cov_m2ps2[0], self.cov_m2ps2[2]))

    @property
    def as_constant_forecast(self) -> Forecast:
        """The estimate as the constant wind of a day, limited to the ranges of `day/1`."""
        return Forecast(
            speed_mps=min(self.speed_mps, MAX_SPEED_MPS),
            from_deg=self.from_deg,
            std_mps=min(max(self.larger_axis_std_mps, MIN_STD_MPS), MAX_STD_MPS),
        )

    def chi_square_of_report(self, report: MemberWindReport) -> float:
        """Return the chi-square (two degrees of freedom) of a wind report under this estimate."""
        residual_mps = np.subtract(report.mean_to_ne_mps, self.to_ne_mps)
        variance = self.cov_m2ps2[0], self.cov_m2ps2[2]
        return float(
            np.sum(residual_mps**2 / np.add(report.conservative_variance_ne_m2ps2, variance))
        )


def wind_estimate_at(
    field: FieldEstimate, position_ne_m: VectorNe, height_m: float, t_s: float, averaging_s: float
) -> SiteWindEstimate:
    """Return the wind estimate of a field, as a mean over `averaging_s` about a time."""
    points = FieldPoints(np.array([position_ne_m]), np.array([height_m]), np.array([t_s]))
    found = field.forecast_at_points(points, averaging_s)
    north, east = (float(x) for x in found.mean_to_ne_mps[0])
    nn, ee = (
        _first_covariance_entry(found.north_cov_m2ps2),
        _first_covariance_entry(found.east_cov_m2ps2),
    )
    return SiteWindEstimate((north, east), (nn, 0.0, ee))


def wind_from_direction_deg(to_ne_mps: VectorNe) -> float:
    """Return the direction that a wind blows from, clockwise from north."""
    north, east = to_ne_mps
    return math.degrees(math.atan2(-east, -north)) % 360.0


def _first_covariance_entry(cov: Floats) -> float:
    return float(cov[0, 0])
