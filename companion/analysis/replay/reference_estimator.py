"""The reference wind estimator: a textbook extended Kalman filter, for comparison.

The filter is filterpy's. Its state is the horizontal wind alone, modelled as a random walk. It uses
the same observations as `WindEstimator`:

- tilt and acceleration measure the drag: `a_h - thrust_h = -D(v - w) / m`, with exact drag
  coefficients of the airframe;
- an airspeed (scalar along the nose, magnitude, or both axes) counts as unbiased;
- an autopilot's wind estimate is used unchanged.

It lacks states for trim, drag gain, heading error and the pitot's scale and bias, a model of gusts,
outlier rejection and detection of a faulty pitot, so its covariance includes noise only. A
comparison (`companion replay --estimator reference`) shows the benefit of these. Flight code does
not import filterpy.
"""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import GRAVITY_MPS2
from companion.core.wind.observation import WindBelief, WindObservation

SNAPSHOT_FORMAT = "reference-estimator/1"
MAX_STEP_S = 1.0  # over a longer gap the acceleration is unknown
MIN_STEP_S = 0.02
MAX_TILT_RAD = 1.2


@dataclass(frozen=True, slots=True)
class ReferenceParams:
    """Noises of the reference estimator. An error with a correlation time `memory` enters as white
    noise of equal spectral density at frequency 0, `2 memory variance`."""

    prior_wind_std_mps: float = 10.0  # each axis, before the first observation
    # Half the variance of what a coastal wind of 8.4 m/s changes in 30 s is 0.023 of its square
    # (each axis): a random walk of 2 x 0.023 x 8.4^2 / 30 s.
    wind_diffusion_m2ps3: float = 0.11
    velocity_std_mps: float = 0.06  # u-blox M8 data sheet: 0.05, unfused
    tilt_noise_m2ps3: float = 0.05**2 * 0.1  # attitude noise, 0.3 deg at 10 Hz
    model_memory_s: float = 5.0  # correlation time of a model error
    airspeed_std_mps: float = 0.5
    airspeed_memory_s: float = 0.5
    airspeed_model_std_frac: float = 0.05  # flow angle and wash, `model_memory_s` long
    autopilot_std_mps: float = 1.0  # without a stated covariance
    autopilot_min_std_mps: float = 0.3  # excludes its coefficient and trim errors
    autopilot_memory_s: float = 10.0  # it is filtered: its errors are correlated
    settle_s: float = 5.0
    stale_after_s: float = 15.0


class ReferenceEstimator:
    """Reference filter, one per vehicle, with the interface of `WindEstimator`."""

    def __init__(self, airframe: Airframe, params: ReferenceParams | None = None) -> None:
        self._airframe = airframe
        self._params = params or ReferenceParams()
        self._filter = ExtendedKalmanFilter(dim_x=2, dim_z=2)
        self._filter.x = np.zeros(2)
        self._filter.P = self._params.prior_wind_std_mps**2 * np.eye(2)
        self._t_s: float | None = None
        self._previous_velocity: tuple[float, float, float] | None = None  # t_s, north, east
        self._last_used_s: dict[str, float] = {}
        self._observed_s = 0.0

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Update with one observation; no observation is rejected, so the result is empty.

        Late or repeated times are ignored. Raises ValueError on NaN or infinity.
        """
        observation.raise_if_invalid()
        before_s = self._t_s
        if before_s is not None and observation.t_s <= before_s:
            return ()
        dt_s = 0.0 if before_s is None else observation.t_s - before_s
        self._t_s = observation.t_s
        self._filter.Q = self._params.wind_diffusion_m2ps3 * dt_s * np.eye(2)
        self._filter.predict()
        if observation.airborne:
            self._correct_wind_by_tilt(observation)
            self._correct_wind_by_airspeed(observation, dt_s)
        else:
            self._previous_velocity = None
        self._correct_wind_by_autopilot_wind(observation, dt_s)
        return ()

    def belief(self, t_s: float) -> WindBelief:
        """Return the wind at `t_s` >= the last update; its covariance increases with time."""
        p = self._params
        waited_s = 0.0 if self._t_s is None else max(t_s - self._t_s, 0.0)
        cov = self._filter.P + p.wind_diffusion_m2ps3 * waited_s * np.eye(2)
        recent_sources = tuple(
            sorted(n for n, at in self._last_used_s.items() if t_s - at <= p.stale_after_s)
        )
        settled = self._observed_s >= p.settle_s or "autopilot" in recent_sources
        return WindBelief(
            t_s, self._filter.x.copy(), cov, recent_sources, settled and bool(recent_sources)
        )

    def snapshot(self) -> dict[str, object]:
        """Return the content of a checkpoint."""
        wind, cov = self._filter.x.tolist(), self._filter.P.tolist()
        return {"format": SNAPSHOT_FORMAT, "t_s": self._t_s, "x": wind, "cov": cov}

    def restore(self, snapshot: dict[str, object]) -> None:
        """Resume from a checkpoint. Raises LeewayError for an invalid one."""
        if snapshot.get("format") != SNAPSHOT_FORMAT:
            raise LeewayError(f"checkpoint: expected a {SNAPSHOT_FORMAT} snapshot")
        try:
            t_s = msgspec.convert(snapshot["t_s"], float | None)
            x = np.array(msgspec.convert(snapshot["x"], tuple[float, float]))
            row = tuple[float, float]
            cov = np.array(msgspec.convert(snapshot["cov"], tuple[row, row]))
        except (KeyError, msgspec.ValidationError) as error:
            raise LeewayError(f"checkpoint: {error}") from error
        self._t_s, self._filter.x, self._filter.P = t_s, x, cov

    # -- updates ---------------------------------------------------------------------------------

    def _correct_wind_by_tilt(self, observation: WindObservation) -> None:
        moved = self._store_velocity_and_get_acceleration(observation)
        if moved is None or observation.vel_ned_mps is None or observation.yaw_rad is None:
            return
        accel_ne_mps2, dt_s = moved
        rotation = _heading_to_ne_rotation(observation.yaw_rad)
        measured = rotation.T @ (accel_ne_mps2 - _thrust_ne_mps2(observation))
        air_fr = rotation.T @ (np.array(observation.vel_ned_mps[:2]) - self._filter.x)
        drag, slope = _drag_acceleration_and_derivative(
            self._airframe, observation, air_fr, observation.vel_ned_mps[2]
        )
        p = self._params
        model_error = self._airframe.drag.model_std_frac * math.hypot(*drag)
        density = p.tilt_noise_m2ps3 + 2.0 * p.model_memory_s * model_error**2
        variance = density / dt_s + 2.0 * (p.velocity_std_mps / dt_s) ** 2
        # Air velocity decreases with wind: d(-drag)/d(wind) is the slope itself.
        self._apply_kalman_correction(
            "tilt", observation.t_s, _Measurement(measured, -drag, slope @ rotation.T, variance)
        )
        self._observed_s += dt_s

    def _store_velocity_and_get_acceleration(
        self, observation: WindObservation
    ) -> tuple[Floats, float] | None:
        """Return acceleration (north, east) since the previous velocity, and the time step."""
        before, self._previous_velocity = self._previous_velocity, None
        if (
            observation.vel_ned_mps is None
            or observation.roll_rad is None
            or observation.pitch_rad is None
        ):
            return None
        north, east, _ = observation.vel_ned_mps
        self._previous_velocity = (observation.t_s, north, east)
        tilted = max(abs(observation.roll_rad), abs(observation.pitch_rad)) > MAX_TILT_RAD
        if before is None or tilted or observation.t_s - before[0] > MAX_STEP_S:
            return None
        dt_s = max(observation.t_s - before[0], MIN_STEP_S)
        return np.array([north - before[1], east - before[2]]) / dt_s, dt_s

    def _correct_wind_by_airspeed(self, observation: WindObservation, dt_s: float) -> None:
        if observation.vel_ned_mps is None or observation.yaw_rad is None or dt_s <= 0.0:
            return
        p = self._params
        air_ne = np.array(observation.vel_ned_mps[:2]) - self._filter.x
        model_error = p.airspeed_model_std_frac * math.hypot(*air_ne)
        density = p.airspeed_memory_s * p.airspeed_std_mps**2 + p.model_memory_s * model_error**2
        variance = 2.0 * density / max(dt_s, MIN_STEP_S)
        if observation.airspeed_fr_mps is not None:
            rotation = _heading_to_ne_rotation(observation.yaw_rad)
            measured = np.array(observation.airspeed_fr_mps)
            self._apply_kalman_correction(
                "pitot",
                observation.t_s,
                _Measurement(measured, rotation.T @ air_ne, -rotation.T, variance),
            )
        elif observation.airspeed_mps is not None:
            if observation.airspeed_is_magnitude:
                unit_direction = air_ne / max(math.hypot(*air_ne), 1e-6)
            else:
                level = math.cos(observation.pitch_rad or 0.0)
                unit_direction = level * _heading_to_ne_rotation(observation.yaw_rad)[:, 0]
            measured, expected = (
                np.array([observation.airspeed_mps]),
                np.array([unit_direction @ air_ne]),
            )
            self._apply_kalman_correction(
                "pitot",
                observation.t_s,
                _Measurement(measured, expected, -unit_direction[None], variance),
            )

    def _correct_wind_by_autopilot_wind(self, observation: WindObservation, dt_s: float) -> None:
        if observation.autopilot_wind_to_ne_mps is None or dt_s <= 0.0:
            return
        p = self._params
        autopilot_variance_m2ps2 = p.autopilot_std_mps**2
        if observation.autopilot_wind_cov_m2ps2 is not None:
            nn, _, ee = observation.autopilot_wind_cov_m2ps2
            autopilot_variance_m2ps2 = 0.5 * (nn + ee) + p.autopilot_min_std_mps**2
        variance = 2.0 * p.autopilot_memory_s * autopilot_variance_m2ps2 / max(dt_s, MIN_STEP_S)
        measured = np.array(observation.autopilot_wind_to_ne_mps)
        reading = _Measurement(measured, self._filter.x, np.eye(2), variance)
        self._apply_kalman_correction("autopilot", observation.t_s, reading)

    def _apply_kalman_correction(
        self, source: str, t_s: float, measurement: "_Measurement"
    ) -> None:
        """Apply the extended filter's correction, linearised about the estimated wind."""
        noise = measurement.variance * np.eye(len(measurement.measured))
        self._filter.update(
            measurement.measured, lambda _: measurement.slope, lambda _: measurement.expected, noise
        )
        self._last_used_s[source] = t_s


@dataclass(frozen=True, slots=True)
class _Measurement:
    """A measurement (m,), its expected value for the estimated wind, the derivative by the wind
    (m, 2) and the variance of each row."""

    measured: Floats
    expected: Floats
    slope: Floats
    variance: float


def _heading_to_ne_rotation(yaw_rad: float) -> Floats:
    """Return the rotation from (forward, right) to (north, east)."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[cos, -sin], [sin, cos]])


def _thrust_ne_mps2(observation: WindObservation) -> Floats:
    """Return horizontal thrust acceleration; its vertical part balances gravity."""
    roll, pitch = observation.roll_rad or 0.0, observation.pitch_rad or 0.0
    forward = -GRAVITY_MPS2 * math.tan(pitch)
    right = GRAVITY_MPS2 * math.tan(roll) / math.cos(pitch)
    return _heading_to_ne_rotation(observation.yaw_rad or 0.0) @ np.array([forward, right])


def _drag_acceleration_and_derivative(
    airframe: Airframe, observation: WindObservation, air_velocity_fr_mps: Floats, sink_mps: float
) -> tuple[Floats, Floats]:
    """Return drag acceleration (m/s2; forward, right) and its air-velocity derivative (2, 2)."""
    speed = max(math.hypot(*air_velocity_fr_mps, sink_mps), 1e-3)
    mass_kg, density = observation.mass_kg, observation.density_kgpm3
    linear = np.array(airframe.linear_drag_forward_right_n_per_mps(mass_kg, density)) / mass_kg
    quadratic = (
        np.array(airframe.quadratic_drag_forward_right_n_per_mps2(mass_kg, density)) / mass_kg
    )
    drag = (linear + quadratic * speed) * air_velocity_fr_mps
    slope = np.diag(linear + quadratic * speed)
    slope += np.outer(quadratic * air_velocity_fr_mps, air_velocity_fr_mps) / speed
    return drag, slope
