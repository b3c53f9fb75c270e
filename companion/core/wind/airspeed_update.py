"""Wind from airspeed: a pitot on the forward axis, a magnitude, a vector; and whether to trust it.

A pitot beside rotors has a scale and a bias that nobody knows: both are states. What is left, the
angle of the flow and the wash, errs for seconds on end and is noise. A pitot that is stuck repeats
itself; one that ices reads low, or drifts: it is judged by what tilt alone makes of the air.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.ekf import STATES, At, WindEstimatorParams, WindState
from companion.core.wind.observation import WindObservation


@dataclass(frozen=True, slots=True)
class AirspeedSeen:
    """One scalar: measured and expected (m/s), its derivative by the state, and its noise."""

    measured_mps: float
    expected_mps: float
    row: Floats
    noise_m2ps2: float

    def surprise(self, state: WindState) -> float:
        """Innovation over its standard deviation."""
        variance = float(self.row @ state.cov @ self.row) + self.noise_m2ps2
        return (self.measured_mps - self.expected_mps) / math.sqrt(variance)


def pitot_seen(
    state: WindState, params: WindEstimatorParams, seen: WindObservation, fresh_s: float
) -> AirspeedSeen | None:
    """What a scalar airspeed says to `state`; `None` where it says nothing: too slow, or no way
    to tell the air from the ground."""
    if seen.airspeed_mps is None or seen.vel_ned_mps is None or seen.yaw_rad is None:
        return None
    air_n, air_e = _air_ne(state, seen.vel_ned_mps)
    if seen.airspeed_is_magnitude:
        speed = max(math.hypot(air_n, air_e), 1e-6)
        north, east, turned = air_n / speed, air_e / speed, 0.0
    else:
        level = math.cos(seen.pitch_rad) if seen.pitch_rad is not None else 1.0
        heading = seen.yaw_rad + float(state.x[At.HEADING])
        north, east = level * math.cos(heading), level * math.sin(heading)
        speed = air_n * north + air_e * east
        turned = air_e * north - air_n * east
    scale = math.exp(float(state.x[At.LOG_SCALE]))
    expected = scale * speed + float(state.x[At.BIAS])
    if max(speed, seen.airspeed_mps) < params.pitot_least_mps:
        return None
    row = np.zeros(STATES)
    row[At.MEAN] = row[At.GUST] = -scale * north
    row[At.MEAN + 1] = row[At.GUST + 1] = -scale * east
    row[At.HEADING] = scale * turned
    row[At.LOG_SCALE] = scale * speed
    row[At.BIAS] = 1.0
    own = params.pitot_std_mps**2 * params.pitot_memory_s
    model = 2.0 * params.model_memory_s * (params.pitot_model_std_frac * speed) ** 2
    gust = params.fast_gust_m2ps * state.scale
    noise = (own + model + gust) / min(max(fresh_s, 0.02), 1.0)
    return AirspeedSeen(seen.airspeed_mps, expected, row, noise)


def vector_seen(
    state: WindState, params: WindEstimatorParams, seen: WindObservation, dt_s: float
) -> list[AirspeedSeen]:
    """Air velocity along heading and right of it, from a sensor with two axes; none without."""
    if seen.airspeed_fr_mps is None or seen.vel_ned_mps is None or seen.yaw_rad is None:
        return []
    air_n, air_e = _air_ne(state, seen.vel_ned_mps)
    heading = seen.yaw_rad + float(state.x[At.HEADING])
    cos, sin = math.cos(heading), math.sin(heading)
    scale = math.exp(float(state.x[At.LOG_SCALE]))
    forward, right = cos * air_n + sin * air_e, cos * air_e - sin * air_n
    own = params.vector_std_mps**2 * params.pitot_memory_s
    off = params.pitot_model_std_frac * math.hypot(air_n, air_e)
    gust = params.fast_gust_m2ps * state.scale
    noise = (own + 2.0 * params.model_memory_s * off**2 + gust) / min(max(dt_s, 0.02), 1.0)
    found = []
    for measured, along, (north, east), turned in (
        (seen.airspeed_fr_mps[0], forward, (cos, sin), right),
        (seen.airspeed_fr_mps[1], right, (-sin, cos), -forward),
    ):
        row = np.zeros(STATES)
        row[At.MEAN] = row[At.GUST] = -scale * north
        row[At.MEAN + 1] = row[At.GUST + 1] = -scale * east
        row[At.HEADING] = scale * turned
        row[At.LOG_SCALE] = scale * along
        found.append(AirspeedSeen(measured, scale * along, row, noise))
    return found


def _air_ne(state: WindState, vel_ned_mps: tuple[float, float, float]) -> tuple[float, float]:
    mean_n, mean_e, gust_n, gust_e = state.x[:4].tolist()
    return vel_ned_mps[0] - mean_n - gust_n, vel_ned_mps[1] - mean_e - gust_e


class PitotWatch:
    """Tells a new reading from an old one, and a sound pitot from a stuck or an iced one."""

    __slots__ = ("_agrees_since_s", "_mean", "_since_s", "_value_mps", "faulty")

    def __init__(self) -> None:
        self._value_mps: float | None = None
        self._since_s = 0.0
        self._mean = 0.0
        self._agrees_since_s: float | None = None
        self.faulty = False

    def look(self, t_s: float, value_mps: float, stuck_after_s: float) -> tuple[float | None, bool]:
        """(seconds since the reading before, None for that very reading; whether it is stuck).

        No live pitot repeats itself to the last bit.
        """
        if self._value_mps is not None and value_mps == self._value_mps:
            stuck = t_s - self._since_s > stuck_after_s
            self.faulty = self.faulty or stuck
            self._agrees_since_s = None
            return None, stuck
        fresh_s = t_s - self._since_s if self._value_mps is not None else 0.1
        self._value_mps, self._since_s = value_mps, t_s
        return fresh_s, False

    def judge(self, t_s: float, surprise: float, fresh_s: float, p: WindEstimatorParams) -> None:
        """Take one innovation over its standard deviation, by what tilt alone makes of the air.

        Its mean over some seconds has at most that innovation's own spread where all that errs is
        slow, so `faulty_sigmas` of it are `faulty_sigmas` of a sound pitot.
        """
        share = 1.0 - math.exp(-min(fresh_s, 1.0) / p.watch_memory_s)
        bounded = min(max(surprise, -2.0 * p.faulty_sigmas), 2.0 * p.faulty_sigmas)
        self._mean += share * (bounded - self._mean)
        if abs(self._mean) > p.faulty_sigmas:
            self.faulty = True
        if abs(self._mean) > p.sound_sigmas:
            self._agrees_since_s = None
        elif self._agrees_since_s is None:
            self._agrees_since_s = t_s
        elif self.faulty and t_s - self._agrees_since_s > p.sound_after_s:
            self.faulty = False
