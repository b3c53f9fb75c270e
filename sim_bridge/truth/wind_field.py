"""The true wind at a vehicle: a mean over time, a profile over height, and turbulence.

Wind vectors point where the air MOVES TO.
"""

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Protocol

from sim_bridge.truth.dryden import DrydenTurbulence
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.wind_log import WindLog, wind_to_ne_mps

_HEIGHT_20FT_M = 6.096
_MIN_PROFILE_HEIGHT_M = 1.0


class MeanWind(Protocol):
    """Wind at the reference height as a function of time."""

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        """Return the direction and speed of air motion, north and east."""
        ...


class SteadyWind:
    """A constant wind."""

    __slots__ = ("_vector",)

    def __init__(self, speed_mps: float, from_deg: float) -> None:
        self._vector = wind_to_ne_mps(speed_mps, from_deg)

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        return self._vector


class RampedWind:
    """Wind with speed and direction linear in time between points, constant outside them.

    Points are (t_s, speed_mps, from_deg). Directions are interpolated numerically: 350 to 370 veers
    by 20 degrees through north, and 350 to 10 backs by 340.
    """

    __slots__ = ("_points", "_times")

    def __init__(self, points: Sequence[tuple[float, float, float]]) -> None:
        times = [point[0] for point in points]
        if not points or any(b <= a for a, b in itertools.pairwise(times)):
            raise TruthError(
                f"wind points at t_s = {times}: expected at least one, in rising order"
            )
        self._points = list(points)
        self._times = times

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        after = bisect_right(self._times, t_s)
        if after == 0 or after == len(self._points):
            _, speed, from_deg = self._points[max(after - 1, 0)]
            return wind_to_ne_mps(speed, from_deg)
        start_s, speed0, from0 = self._points[after - 1]
        end_s, speed1, from1 = self._points[after]
        share = (t_s - start_s) / (end_s - start_s)
        return wind_to_ne_mps(speed0 + share * (speed1 - speed0), from0 + share * (from1 - from0))


class RecordedWind:
    """Replay of a recording: the VECTOR is interpolated linearly; the last one is held.

    `start_s` is the recording's own time at which the simulation's t_s = 0 falls.
    """

    __slots__ = ("_east", "_last", "_north", "_start_s", "_times", "remaining_s")

    def __init__(self, log: WindLog, start_s: float | None = None) -> None:
        first, last = log.t_s[0], log.t_s[-1]
        start_s = first if start_s is None else start_s
        if not first <= start_s < last:
            raise TruthError(f"wind start_s = {start_s:g}: expected {first:g} to below {last:g}")
        self._times, self._north, self._east = log.t_s, log.to_north_mps, log.to_east_mps
        self._start_s = start_s
        self._last = len(log.t_s) - 1
        self.remaining_s = last - start_s

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        time_s = self._start_s + t_s
        times = self._times
        after = bisect_right(times, time_s)
        if after > self._last or after == 0:
            index = min(after, self._last)
            return self._north[index], self._east[index]
        start_s = times[after - 1]
        share = (time_s - start_s) / (times[after] - start_s)
        north, east = self._north[after - 1], self._east[after - 1]
        return (
            north + share * (self._north[after] - north),
            east + share * (self._east[after] - east),
        )


class WindField:
    """The wind that one vehicle meets: mean times power-law profile, plus its own gusts."""

    __slots__ = ("_exponent", "_mean", "_reference_m", "_turbulence", "front_to_ne_mps")

    def __init__(
        self,
        mean: MeanWind,
        *,
        profile_exponent: float = 0.0,
        reference_height_m: float = 10.0,
        turbulence: DrydenTurbulence | None = None,
    ) -> None:
        """Power law V(h) = V_ref (h / h_ref)^exponent (0: the same at all heights; 1/7 is the
        classic neutral value over open ground); below 1 m it is held at its value there."""
        self._mean = mean
        self.front_to_ne_mps: tuple[float, float] = (0.0, 0.0)
        """Added to the mean at the reference height: a front, while a fault lets one pass."""
        self._exponent = profile_exponent
        self._reference_m = reference_height_m
        self._turbulence = turbulence

    def _height_factor(self, height_m: float) -> float:
        if self._exponent == 0.0:
            return 1.0
        return (max(height_m, _MIN_PROFILE_HEIGHT_M) / self._reference_m) ** self._exponent

    def mean_wind_to_ne_mps(self, t_s: float, height_m: float) -> tuple[float, float]:
        """Mean wind at a height above ground, without gusts (for perfect knowledge)."""
        north, east = self._mean.to_ne_mps(t_s)
        factor = self._height_factor(height_m)
        return north * factor, east * factor

    def advance_and_get_wind_ned_mps(
        self, t_s: float, dt_s: float, height_m: float, airspeed_mps: float
    ) -> tuple[float, float, float]:
        """Wind to north, east and down at the vehicle, gusts advanced by `dt_s`.

        `airspeed_mps` is how fast the vehicle moves through the frozen field of gusts.
        """
        mean_north, mean_east = self._mean.to_ne_mps(t_s)
        reference_north = mean_north + self.front_to_ne_mps[0]
        reference_east = mean_east + self.front_to_ne_mps[1]
        factor = self._height_factor(height_m)
        north, east = reference_north * factor, reference_east * factor
        if self._turbulence is None:
            return north, east, 0.0
        reference_mps = math.hypot(reference_north, reference_east)
        at_20ft_mps = reference_mps * self._height_factor(_HEIGHT_20FT_M)
        longitudinal, across, down = self._turbulence.advance_and_get_gust_mps(
            dt_s, height_m, at_20ft_mps, airspeed_mps
        )
        if reference_mps > 0.0:
            cos_to, sin_to = reference_north / reference_mps, reference_east / reference_mps
        else:
            cos_to, sin_to = 1.0, 0.0
        return (
            north + longitudinal * cos_to - across * sin_to,
            east + longitudinal * sin_to + across * cos_to,
            down,
        )
