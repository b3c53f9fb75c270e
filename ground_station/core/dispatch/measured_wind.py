"""The wind that the fleet measures now, against the forecast that the day was planned with."""

import math
from collections import deque
from dataclasses import dataclass, field

from ground_station.core.schema.day import Forecast

WINDOW_S = 120.0
MIN_SPAN_S = 60.0
"""Gusts and turns average out over this time; the companions' filters remember half a minute."""


@dataclass(slots=True)
class MeasuredWind:
    """Winds that drones in flight have reported in the last two minutes."""

    _samples: deque[tuple[float, float, float]] = field(default_factory=deque)

    def add(self, t_s: float, to_n_mps: float, to_e_mps: float) -> None:
        """Add the wind that a drone in flight reports: where the air moves to."""
        self._samples.append((t_s, to_n_mps, to_e_mps))

    def mean_to_ne_mps(self, t_s: float) -> tuple[float, float] | None:
        """The mean, where the air moves to; None: too few reports."""
        while self._samples and t_s - self._samples[0][0] > WINDOW_S:
            self._samples.popleft()
        if not self._samples or self._samples[-1][0] - self._samples[0][0] < MIN_SPAN_S:
            return None
        count = len(self._samples)
        return sum(w[1] for w in self._samples) / count, sum(w[2] for w in self._samples) / count

    def off_sigmas(self, t_s: float, forecast: Forecast) -> float:
        """Distance from the forecast in its standard deviations; 0 where there are too few
        reports.
        """
        mean = self.mean_to_ne_mps(t_s)
        if mean is None:
            return 0.0
        north, east = forecast.to_ne_mps
        return math.hypot(mean[0] - north, mean[1] - east) / forecast.std_mps

    def forecast(self, t_s: float, before: Forecast) -> Forecast:
        """The forecast to plan with from now on; its standard deviation is the old one's."""
        mean = self.mean_to_ne_mps(t_s)
        if mean is None:
            return before
        from_deg = math.degrees(math.atan2(-mean[1], -mean[0])) % 360.0
        return Forecast(speed_mps=math.hypot(*mean), from_deg=from_deg, std_mps=before.std_mps)
