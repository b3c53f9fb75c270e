"""The wind as the fleet measures it now, against the wind that the day was planned with."""

import math
from collections import deque
from dataclasses import dataclass, field

from ground_station.core.schema.day import Forecast

WINDOW_S = 120.0
LEAST_S = 60.0
"""Gusts and turns even out over this; the companions' own filters remember half a minute."""


@dataclass(slots=True)
class MeasuredWind:
    """Winds told by drones in flight, of the last two minutes."""

    _told: deque[tuple[float, float, float]] = field(default_factory=deque)

    def hear(self, t_s: float, to_n_mps: float, to_e_mps: float) -> None:
        """A drone in flight tells its wind."""
        self._told.append((t_s, to_n_mps, to_e_mps))

    def mean_to_ne_mps(self, t_s: float) -> tuple[float, float] | None:
        """Where the air moves to; None: too little was told."""
        while self._told and t_s - self._told[0][0] > WINDOW_S:
            self._told.popleft()
        if not self._told or self._told[-1][0] - self._told[0][0] < LEAST_S:
            return None
        count = len(self._told)
        return sum(w[1] for w in self._told) / count, sum(w[2] for w in self._told) / count

    def off_sigmas(self, t_s: float, forecast: Forecast) -> float:
        """How far from the forecast, in its standard deviations; 0 where too little was told."""
        mean = self.mean_to_ne_mps(t_s)
        if mean is None:
            return 0.0
        north, east = forecast.to_ne_mps
        return math.hypot(mean[0] - north, mean[1] - east) / forecast.std_mps

    def forecast(self, t_s: float, before: Forecast) -> Forecast:
        """To plan with from now; as wrong as the forecast was said to be."""
        mean = self.mean_to_ne_mps(t_s)
        if mean is None:
            return before
        from_deg = math.degrees(math.atan2(-mean[1], -mean[0])) % 360.0
        return Forecast(speed_mps=math.hypot(*mean), from_deg=from_deg, std_mps=before.std_mps)
