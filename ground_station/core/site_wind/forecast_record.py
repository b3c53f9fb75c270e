"""A forecast against what the fleet then felt: its bias and the spread about it, lately."""

import math
from dataclasses import dataclass, field

import numpy as np

from ground_station.core.schema.day_forecast import ForecastBias

KEPT_S = 1800.0
"""What was felt over the last half hour counts."""

EVERY_S = 60.0
"""Between two looks. Gusts of a minute are averaged by the belief that is looked at."""

LEAST_LOOKS = 5
"""Fewer are one gust."""

STALE_S = 3600.0
"""Nobody has felt anything for so long: the forecast stands alone again."""


@dataclass(frozen=True, slots=True)
class ForecastLook:
    """One comparison: felt less forecast (north, east), the error of what was felt, and the
    forecast's own error; each one sigma of each component.
    """

    t_s: float
    off_ne_mps: tuple[float, float]
    felt_std_mps: float
    forecast_std_mps: float


@dataclass(frozen=True, slots=True)
class ForecastScore:
    """The last half hour: the mean of felt less forecast, the spread about it, and the forecast's
    own error as it was stated.
    """

    looks: int
    bias: ForecastBias
    spread_mps: float
    stated_mps: float

    @property
    def is_off(self) -> bool:
        """Whether the forecast is off by more than its own error, on the mean of both axes."""
        return self.bias.lasts

    @property
    def words(self) -> str:
        """For people."""
        north, east = self.bias.ne_mps
        off = (
            f"off by {math.hypot(north, east):.1f} m/s (north {north:+.1f}, east {east:+.1f}),"
            f" spread {self.spread_mps:.1f}, its own error {self.stated_mps:.1f}"
        )
        if self.is_off:
            return f"FORECAST OFF: {off}: the fleet is believed"
        return f"the forecast of the last half hour: {off}"


@dataclass(slots=True)
class ForecastRecord:
    """Comparisons of the last half hour, on the listener's clock."""

    _looks: list[ForecastLook] = field(default_factory=list)

    def is_due(self, now_s: float) -> bool:
        """Whether the next comparison may be noted."""
        return not self._looks or now_s - self._looks[-1].t_s >= EVERY_S

    def note(self, look: ForecastLook) -> None:
        """Take a comparison. What is not finite is left out."""
        numbers = (*look.off_ne_mps, look.felt_std_mps, look.forecast_std_mps, look.t_s)
        if not all(map(math.isfinite, numbers)):
            return
        self._looks = [one for one in self._looks if look.t_s - one.t_s < KEPT_S]
        self._looks.append(look)

    def forget(self) -> None:
        """Another forecast has come: what was felt against the old one says nothing of it."""
        self._looks.clear()

    def score(self, now_s: float) -> ForecastScore | None:
        """How good the forecast was; None: too little is known, or it is long ago."""
        if len(self._looks) < LEAST_LOOKS or now_s - self._looks[-1].t_s > STALE_S:
            return None
        off = np.array([look.off_ne_mps for look in self._looks])
        north, east = (float(x) for x in off.mean(axis=0))
        spread_mps = float(np.sqrt(off.var(axis=0, ddof=1).mean()))
        felt_mps = _rms([look.felt_std_mps for look in self._looks])
        stated_mps = _rms([look.forecast_std_mps for look in self._looks])
        # Not over the square root of their number: what differs for minutes meets a whole flight.
        std_mps = max(spread_mps, felt_mps)
        is_off = math.hypot(north, east) / math.sqrt(2.0) > stated_mps
        bias = ForecastBias(self._looks[-1].t_s, (north, east), std_mps, is_off)
        return ForecastScore(len(self._looks), bias, spread_mps, stated_mps)


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))
