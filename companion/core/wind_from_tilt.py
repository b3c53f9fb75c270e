"""Wind from tilt and acceleration: the drag that they tell, and what it says of wind, trim, gain.

In steady air `m (a_h - thrust_h) = -s D(v - w)`, with the thrust along the body's axis and its size
from the vertical balance. No accelerometer, no throttle: only attitude and ground velocity, which
every autopilot sends.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.airframe import Airframe
from companion.core.power import GRAVITY_MPS2
from companion.core.wind_observation import WindObservation
from companion.core.wind_state import STATES, FloatArray, WindEstimatorParams, WindState

_GREATEST_TILT_RAD = 1.2
_GREATEST_LOG_GAIN = 2.0


@dataclass(frozen=True, slots=True)
class Smoothed:
    """Velocity and horizontal drag acceleration through one and the same low-pass filter (NED)."""

    age_s: float
    velocity_n: float
    velocity_e: float
    velocity_d: float
    thrust_n: float
    thrust_e: float
    accel_n: float
    accel_e: float
    accel_d: float
    transient_mps2: float  # thrust now less thrust smoothed


def has_tilt(seen: WindObservation) -> bool:
    """Whether attitude and velocity are known, and such as a multirotor flies."""
    if seen.vel_ned_mps is None or seen.yaw_rad is None:
        return False
    if seen.roll_rad is None or seen.pitch_rad is None:
        return False
    return max(abs(seen.roll_rad), abs(seen.pitch_rad)) <= _GREATEST_TILT_RAD


def smoothed(
    before: Smoothed | None, seen: WindObservation, dt_s: float, memory_s: float
) -> Smoothed:
    """The low-pass filters one step on; what a filtered velocity gains IS the acceleration."""
    north, east, down = seen.vel_ned_mps or (0.0, 0.0, 0.0)
    lift = GRAVITY_MPS2 - (before.accel_d if before else 0.0)
    thrust_n, thrust_e = _thrust_ne(seen, lift)
    if before is None or not 0.0 < dt_s < 1.0:
        return Smoothed(0.0, north, east, down, thrust_n, thrust_e, 0.0, 0.0, 0.0, 0.0)
    share = 1.0 - math.exp(-dt_s / memory_s)
    step_n = share * (north - before.velocity_n)
    step_e = share * (east - before.velocity_e)
    step_d = share * (down - before.velocity_d)
    return Smoothed(
        before.age_s + dt_s,
        before.velocity_n + step_n,
        before.velocity_e + step_e,
        before.velocity_d + step_d,
        before.thrust_n + share * (thrust_n - before.thrust_n),
        before.thrust_e + share * (thrust_e - before.thrust_e),
        step_n / dt_s,
        step_e / dt_s,
        step_d / dt_s,
        math.hypot(thrust_n - before.thrust_n, thrust_e - before.thrust_e),
    )


def _thrust_ne(seen: WindObservation, lift_mps2: float) -> tuple[float, float]:
    """Horizontal thrust acceleration: along minus the body's z axis, `lift_mps2` of it upward."""
    roll, pitch, yaw = seen.roll_rad or 0.0, seen.pitch_rad or 0.0, seen.yaw_rad or 0.0
    forward = -lift_mps2 * math.tan(pitch)
    right = lift_mps2 * math.tan(roll) / math.cos(pitch)
    cos, sin = math.cos(yaw), math.sin(yaw)
    return cos * forward - sin * right, sin * forward + cos * right


@dataclass(frozen=True, slots=True)
class DragSeen:
    """Drag acceleration along heading and right: measured, expected, its size by the airframe file
    (m/s2), the airspeed, and the rows d(expected - measured)/dx."""

    measured: tuple[float, float]
    expected: tuple[float, float]
    size_mps2: float
    airspeed_mps: float
    rows: tuple[FloatArray, FloatArray]


def drag_seen(
    airframe: Airframe, mass_kg: float, x: FloatArray, smooth: Smoothed, yaw_rad: float
) -> DragSeen:
    """What drag was measured, and what the state `x` makes of it."""
    mean_n, mean_e, gust_n, gust_e, _, _, trim_f, trim_r, log_f, log_r, turned, _, _ = x.tolist()
    heading = yaw_rad + turned
    cos, sin = math.cos(heading), math.sin(heading)
    gain_f, gain_r = _gain(log_f), _gain(log_r)
    air_n = smooth.velocity_n - mean_n - gust_n
    air_e = smooth.velocity_e - mean_e - gust_e
    forward, right = cos * air_n + sin * air_e, -sin * air_n + cos * air_e
    speed = max(math.hypot(forward, right), 1e-3)
    k_f, k_r = airframe.drag_linear_n_per_mps(mass_kg)
    q_f, q_r = airframe.drag_quadratic_n_per_mps2(mass_kg)
    drag_f = gain_f * (k_f + q_f * speed) * forward / mass_kg
    drag_r = gain_r * (k_r + q_r * speed) * right / mass_kg
    # d drag / d (forward, right); the wind enters with the opposite sign.
    ff = gain_f * (k_f + q_f * (speed + forward * forward / speed)) / mass_kg
    fr = gain_f * q_f * forward * right / speed / mass_kg
    rr = gain_r * (k_r + q_r * (speed + right * right / speed)) / mass_kg
    rf = gain_r * q_r * forward * right / speed / mass_kg
    # The acceleration is the ground track's, the thrust the body's: only the first turns.
    accel_f = cos * smooth.accel_n + sin * smooth.accel_e
    accel_r = cos * smooth.accel_e - sin * smooth.accel_n
    yaw_cos, yaw_sin = math.cos(yaw_rad), math.sin(yaw_rad)
    thrust_f = yaw_cos * smooth.thrust_n + yaw_sin * smooth.thrust_e
    thrust_r = yaw_cos * smooth.thrust_e - yaw_sin * smooth.thrust_n
    turn_f = fr * forward - ff * right - accel_r
    turn_r = rr * forward - rf * right + accel_f
    fn, fe = ff * cos - fr * sin, ff * sin + fr * cos
    rn, re = rf * cos - rr * sin, rf * sin + rr * cos
    g = GRAVITY_MPS2
    row_f = [fn, fe, fn, fe, 0.0, 0.0, g, 0.0, -drag_f, 0.0, turn_f, 0.0, 0.0]
    row_r = [rn, re, rn, re, 0.0, 0.0, 0.0, g, 0.0, -drag_r, turn_r, 0.0, 0.0]
    return DragSeen(
        measured=(accel_f - thrust_f, accel_r - thrust_r),
        expected=(-drag_f + g * trim_f, -drag_r + g * trim_r),
        size_mps2=math.hypot(drag_f, drag_r),
        airspeed_mps=speed,
        rows=(np.array(row_f), np.array(row_r)),
    )


def _gain(log_gain: float) -> float:
    return math.exp(min(max(log_gain, -_GREATEST_LOG_GAIN), _GREATEST_LOG_GAIN))


@dataclass(frozen=True, slots=True)
class TiltTaken:
    """How surprising a tilt was: the innovation (m/s2) of either axis, and its variance; the
    wind's correction, and the trace of the variance that the filter expected of it."""

    innovations: tuple[float, float]
    variances: tuple[float, float]
    wind_step_ne_mps: tuple[float, float]
    wind_step_variance_m2ps2: float

    def is_outlier(self, sigmas: float) -> bool:
        """Whether either axis is more than `sigmas` off."""
        limit = sigmas**2
        pairs = zip(self.innovations, self.variances, strict=True)
        return any(e * e > limit * s for e, s in pairs)


def take_tilt(
    state: WindState,
    airframe: Airframe,
    params: WindEstimatorParams,
    seen: WindObservation,
    smooth: Smoothed,
    dt_s: float,
) -> TiltTaken:
    """Correct `state` by one measurement of drag.

    An extended filter's one linearisation, or more (Bell and Cathey 1993) while the wind is
    unknown: drag is quadratic, its slope in still air would throw the first estimate far out.
    """
    prior, prior_cov = state.x.copy(), state.cov.copy()
    rounds = 1 if state.wind_is_known else 6
    innovations, noises = (0.0, 0.0), (0.0, 0.0)
    rows: tuple[FloatArray, FloatArray] = (prior, prior)
    for _ in range(rounds):
        drag = drag_seen(airframe, seen.mass_kg, state.x, smooth, seen.yaw_rad or 0.0)
        rows = drag.rows
        ahead = [float(row @ (prior - state.x)) for row in rows]
        left = [drag.measured[i] - drag.expected[i] - ahead[i] for i in (0, 1)]
        innovations = (left[0], left[1])
        noises = (
            _noise(state, airframe, params, drag, 0, smooth, dt_s),
            _noise(state, airframe, params, drag, 1, smooth, dt_s),
        )
        state.airspeed_mps = drag.airspeed_mps
        state.x, state.cov = prior.copy(), prior_cov.copy()
        for i in (0, 1):
            moved = float(rows[i] @ (state.x - prior))
            state.correct(rows[i], innovations[i] - moved, noises[i])
    step = state.x - prior
    gained = prior_cov - state.cov
    return TiltTaken(
        innovations,
        (
            float(rows[0] @ prior_cov @ rows[0]) + noises[0],
            float(rows[1] @ prior_cov @ rows[1]) + noises[1],
        ),
        (float(step[0] + step[2]), float(step[1] + step[3])),
        float(np.einsum("i,ij,j->", _WIND_N, gained, _WIND_N))
        + float(np.einsum("i,ij,j->", _WIND_E, gained, _WIND_E)),
    )


_WIND_N, _WIND_E = np.zeros(STATES), np.zeros(STATES)
_WIND_N[[0, 2]] = 1.0
_WIND_E[[1, 3]] = 1.0


def _noise(
    state: WindState,
    airframe: Airframe,
    p: WindEstimatorParams,
    drag: DragSeen,
    axis: int,
    smooth: Smoothed,
    dt_s: float,
) -> float:
    """Variance of one drag measurement: sensors, gusts too fast for the filter, what a transient's
    delays do, and what the drag model errs by for seconds on end."""
    row = drag.rows[axis]
    gust = p.fast_gust_m2ps * state.scale * float(row[0] ** 2 + row[1] ** 2)
    transient = (p.delay_std_s / p.smoothing_s * smooth.transient_mps2) ** 2 * p.smoothing_s
    off = airframe.drag.model_std_frac * drag.size_mps2
    model = 2.0 * p.model_memory_s * off**2
    return (p.tilt_noise_m2ps3 + gust + transient + model) / max(dt_s, 0.02)
