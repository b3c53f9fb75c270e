"""Comparison of a forecast with the wind then measured: recent bias and spread."""

import math
from dataclasses import dataclass, field

import numpy as np

from ground_station.core.schema.day_forecast import ForecastBias

WINDOW_S = 1800.0
"""Measurements of the last half hour count."""

INTERVAL_S = 60.0
"""Interval of comparisons. The compared wind field averages gusts of a minute."""

MIN_COMPARISONS = 5
"""Minimum number of comparisons: fewer may be a single gust."""

STALE_S = 3600.0
"""Age of the last measurement after which the forecast is used without correction."""


@dataclass(frozen=True, slots=True)
class ForecastComparison:
    """One comparison: measured minus forecast wind (north, east), error of the measurement, error
    of the forecast; each one sigma of each component.
    """

    t_s: float
    error_ne_mps: tuple[float, float]
    measured_std_mps: float
    forecast_std_mps: float


@dataclass(frozen=True, slots=True)
class ForecastScore:
    """Score of the last half hour: mean of measured minus forecast wind, the spread about it, and
    the forecast's stated error.
    """

    comparison_count: int
    bias: ForecastBias
    spread_mps: float
    forecast_std_mps: float

    @property
    def is_bias_above_stated_error(self) -> bool:
        """True if the bias exceeds the forecast's stated error, on the mean of both axes."""
        return self.bias.is_persistent

    @property
    def score_text(self) -> str:
        """Score as text."""
        north, east = self.bias.ne_mps
        off = (
            f"off by {math.hypot(north, east):.1f} m/s (north {north:+.1f}, east {east:+.1f}),"
            f" spread {self.spread_mps:.1f}, its own error {self.forecast_std_mps:.1f}"
        )
        if self.is_bias_above_stated_error:
            return f"FORECAST OFF: {off}: using the fleet's wind"
        return f"the forecast of the last half hour: {off}"


@dataclass(slots=True)
class ForecastRecord:
    """Comparisons of the last half hour, on the receiver's clock."""

    _comparisons: list[ForecastComparison] = field(default_factory=list)

    def is_comparison_due(self, now_s: float) -> bool:
        """Return True if the next comparison is due."""
        return not self._comparisons or now_s - self._comparisons[-1].t_s >= INTERVAL_S

    def add_comparison(self, comparison: ForecastComparison) -> None:
        """Add a comparison. Values that are not finite are ignored."""
        numbers = (
            *comparison.error_ne_mps,
            comparison.measured_std_mps,
            comparison.forecast_std_mps,
            comparison.t_s,
        )
        if not all(map(math.isfinite, numbers)):
            return
        self._comparisons = [
            one for one in self._comparisons if comparison.t_s - one.t_s < WINDOW_S
        ]
        self._comparisons.append(comparison)

    def clear_comparisons(self) -> None:
        """Discard all comparisons, because another forecast applies."""
        self._comparisons.clear()

    def score_of_recent_comparisons(self, now_s: float) -> ForecastScore | None:
        """Return the score of the forecast; None: too few or only old comparisons."""
        if len(self._comparisons) < MIN_COMPARISONS or now_s - self._comparisons[-1].t_s > STALE_S:
            return None
        off = np.array([comparison.error_ne_mps for comparison in self._comparisons])
        north, east = (float(x) for x in off.mean(axis=0))
        spread_mps = float(np.sqrt(off.var(axis=0, ddof=1).mean()))
        measured_std_mps = _rms([comparison.measured_std_mps for comparison in self._comparisons])
        forecast_std_mps = _rms([comparison.forecast_std_mps for comparison in self._comparisons])
        # Not divided by the square root of the count: slow deviations affect a whole flight.
        std_mps = max(spread_mps, measured_std_mps)
        is_biased = math.hypot(north, east) / math.sqrt(2.0) > forecast_std_mps
        bias = ForecastBias(self._comparisons[-1].t_s, (north, east), std_mps, is_biased)
        return ForecastScore(len(self._comparisons), bias, spread_mps, forecast_std_mps)


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))
