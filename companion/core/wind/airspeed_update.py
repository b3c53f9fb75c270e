"""Wind from airspeed: a pitot on the forward axis, a magnitude, a vector; and the pitot's check.

Scale and bias of a pitot near rotors are unknown: both are states. The remaining error, from flow
angle and rotor wash, is correlated over seconds and treated as noise. A stuck pitot repeats its
value; an iced one reads low or drifts, and is detected by comparison with the wind from tilt alone.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.ekf import STATES, StateIndex, WindEstimatorParams, WindState
from companion.core.wind.observation import WindObservation


@dataclass(frozen=True, slots=True)
class AirspeedMeasurement:
    """One scalar measurement: measured and expected (m/s), derivative by the state, noise."""

    measured_mps: float
    expected_mps: float
    row: Floats
    noise_m2ps2: float

    def normalised_innovation(self, state: WindState) -> float:
        """Return the innovation over its standard deviation."""
        variance = float(self.row @ state.cov @ self.row) + self.noise_m2ps2
        return (self.measured_mps - self.expected_mps) / math.sqrt(variance)


def pitot_measurement_or_none(
    state: WindState, params: WindEstimatorParams, observation: WindObservation, interval_s: float
) -> AirspeedMeasurement | None:
    """Return the measurement of a scalar airspeed; `None` if too slow, or without ground velocity
    or heading."""
    if (
        observation.airspeed_mps is None
        or observation.vel_ned_mps is None
        or observation.yaw_rad is None
    ):
        return None
    air_n, air_e = _air_velocity_ne_mps(state, observation.vel_ned_mps)
    if observation.airspeed_is_magnitude:
        speed = max(math.hypot(air_n, air_e), 1e-6)
        north, east, heading_derivative_mps = air_n / speed, air_e / speed, 0.0
    else:
        level = math.cos(observation.pitch_rad) if observation.pitch_rad is not None else 1.0
        heading = observation.yaw_rad + float(state.x[StateIndex.HEADING])
        north, east = level * math.cos(heading), level * math.sin(heading)
        speed = air_n * north + air_e * east
        heading_derivative_mps = air_e * north - air_n * east
    scale = math.exp(float(state.x[StateIndex.LOG_SCALE]))
    expected = scale * speed + float(state.x[StateIndex.BIAS])
    if max(speed, observation.airspeed_mps) < params.pitot_min_mps:
        return None
    row = np.zeros(STATES)
    row[StateIndex.MEAN] = row[StateIndex.GUST] = -scale * north
    row[StateIndex.MEAN + 1] = row[StateIndex.GUST + 1] = -scale * east
    row[StateIndex.HEADING] = scale * heading_derivative_mps
    row[StateIndex.LOG_SCALE] = scale * speed
    row[StateIndex.BIAS] = 1.0
    own = params.pitot_std_mps**2 * params.pitot_memory_s
    model = 2.0 * params.model_memory_s * (params.pitot_model_std_frac * speed) ** 2
    gust = params.fast_gust_m2ps * state.squared_wind_ratio_to_reference
    noise = (own + model + gust) / min(max(interval_s, 0.02), 1.0)
    return AirspeedMeasurement(observation.airspeed_mps, expected, row, noise)


def vector_airspeed_measurements(
    state: WindState, params: WindEstimatorParams, observation: WindObservation, dt_s: float
) -> list[AirspeedMeasurement]:
    """Return the air velocity along heading and right of it, from a sensor with two axes, or []."""
    if (
        observation.airspeed_fr_mps is None
        or observation.vel_ned_mps is None
        or observation.yaw_rad is None
    ):
        return []
    air_n, air_e = _air_velocity_ne_mps(state, observation.vel_ned_mps)
    heading = observation.yaw_rad + float(state.x[StateIndex.HEADING])
    cos, sin = math.cos(heading), math.sin(heading)
    scale = math.exp(float(state.x[StateIndex.LOG_SCALE]))
    forward, right = cos * air_n + sin * air_e, cos * air_e - sin * air_n
    own = params.vector_std_mps**2 * params.pitot_memory_s
    off = params.pitot_model_std_frac * math.hypot(air_n, air_e)
    gust = params.fast_gust_m2ps * state.squared_wind_ratio_to_reference
    noise = (own + 2.0 * params.model_memory_s * off**2 + gust) / min(max(dt_s, 0.02), 1.0)
    found = []
    for measured, component_mps, (north, east), heading_derivative_mps in (
        (observation.airspeed_fr_mps[0], forward, (cos, sin), right),
        (observation.airspeed_fr_mps[1], right, (-sin, cos), -forward),
    ):
        row = np.zeros(STATES)
        row[StateIndex.MEAN] = row[StateIndex.GUST] = -scale * north
        row[StateIndex.MEAN + 1] = row[StateIndex.GUST + 1] = -scale * east
        row[StateIndex.HEADING] = scale * heading_derivative_mps
        row[StateIndex.LOG_SCALE] = scale * component_mps
        found.append(AirspeedMeasurement(measured, scale * component_mps, row, noise))
    return found


def _air_velocity_ne_mps(
    state: WindState, vel_ned_mps: tuple[float, float, float]
) -> tuple[float, float]:
    mean_n, mean_e, gust_n, gust_e = state.x[:4].tolist()
    return vel_ned_mps[0] - mean_n - gust_n, vel_ned_mps[1] - mean_e - gust_e


class PitotMonitor:
    """Detects new readings, and a stuck or iced pitot."""

    __slots__ = ("_agrees_since_s", "_mean", "_since_s", "_value_mps", "faulty")

    def __init__(self) -> None:
        self._value_mps: float | None = None
        self._since_s = 0.0
        self._mean = 0.0
        self._agrees_since_s: float | None = None
        self.faulty = False

    def record_reading_interval_and_stuck(
        self, t_s: float, airspeed_mps: float, stuck_after_s: float
    ) -> tuple[float | None, bool]:
        """Return (time since the previous reading, None if repeated; whether it is stuck).

        The readings of a working pitot never repeat exactly.
        """
        if self._value_mps is not None and airspeed_mps == self._value_mps:
            stuck = t_s - self._since_s > stuck_after_s
            self.faulty = self.faulty or stuck
            self._agrees_since_s = None
            return None, stuck
        interval_s = t_s - self._since_s if self._value_mps is not None else 0.1
        self._value_mps, self._since_s = airspeed_mps, t_s
        return interval_s, False

    def update_fault_state(
        self, t_s: float, innovation_sigmas: float, interval_s: float, p: WindEstimatorParams
    ) -> None:
        """Process one normalised innovation, relative to the wind from tilt alone.

        If all errors are slow, its mean over some seconds has at most the innovation's own spread,
        so that `faulty_sigmas` limits the mean of a working pitot, too.
        """
        share = 1.0 - math.exp(-min(interval_s, 1.0) / p.pitot_check_memory_s)
        bounded = min(max(innovation_sigmas, -2.0 * p.faulty_sigmas), 2.0 * p.faulty_sigmas)
        self._mean += share * (bounded - self._mean)
        if abs(self._mean) > p.faulty_sigmas:
            self.faulty = True
        if abs(self._mean) > p.recovery_sigmas:
            self._agrees_since_s = None
        elif self._agrees_since_s is None:
            self._agrees_since_s = t_s
        elif self.faulty and t_s - self._agrees_since_s > p.recovery_after_s:
            self.faulty = False
