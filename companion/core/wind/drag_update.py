"""Drag measurement from tilt and acceleration, and the update of wind, trim and gain by it.

In steady air `m (a_h - thrust_h) = -s D(v - w)`. Thrust acts along the body axis; the vertical
force balance gives its size. Inputs are attitude and ground velocity only, which every autopilot
sends. No accelerometer or throttle is needed.
"""

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power import GRAVITY_MPS2
from companion.core.wind.ekf import StateIndex, WindEstimatorParams, WindState
from companion.core.wind.observation import WindObservation

_MAX_TILT_RAD = 1.2
_MAX_LOG_GAIN = 2.0


def has_usable_attitude_and_velocity(observation: WindObservation) -> bool:
    """Whether attitude and velocity are known, and roll and pitch are in a multirotor's range."""
    if observation.vel_ned_mps is None or observation.yaw_rad is None:
        return False
    if observation.roll_rad is None or observation.pitch_rad is None:
        return False
    return max(abs(observation.roll_rad), abs(observation.pitch_rad)) <= _MAX_TILT_RAD


@dataclass(frozen=True, slots=True)
class ReportedMotion:
    """Reported velocity (NED) and its change since the previous report.

    `thrust_*` is the horizontal thrust acceleration at the time of that velocity, because velocity
    arrives later than attitude. `thrust_change_mps2` is the thrust's change over the interval.
    `interval_s` is None if there is no previous report; then there is no acceleration.
    """

    velocity_n: float
    velocity_e: float
    sink_mps: float
    accel_n: float
    accel_e: float
    thrust_n: float
    thrust_e: float
    thrust_change_mps2: float
    since_s: float | None


class MotionTracker:
    """Derives motion from successive reports of velocity and attitude."""

    __slots__ = ("_before", "_sink_mps", "_sinking_mps2", "_thrusts")

    MAX_INTERVAL_S = 1.0  # no acceleration is derived across a longer gap

    def __init__(self) -> None:
        self.clear_history()

    def clear_history(self) -> None:
        """Discard the history: the vehicle is on the ground, or reports stopped."""
        self._before: tuple[float, float, float] | None = None  # t_s, north, east
        self._sink_mps: float | None = None
        self._sinking_mps2 = 0.0
        self._thrusts: list[tuple[float, float, float]] = []  # t_s, north, east

    def update_and_derive_motion(
        self, observation: WindObservation, p: WindEstimatorParams
    ) -> ReportedMotion:
        """Motion of one observation; `has_usable_attitude_and_velocity` must hold for it."""
        north, east, down = observation.vel_ned_mps or (0.0, 0.0, 0.0)
        before = self._before
        since_s = None if before is None else observation.t_s - before[0]
        if since_s is not None and since_s > self.MAX_INTERVAL_S:
            self.clear_history()
            since_s = None
        self._update_smoothed_sink_rate(down, since_s, p.sink_smoothing_s)
        thrust = _horizontal_thrust_accel_ne_mps2(observation, GRAVITY_MPS2 - self._sinking_mps2)
        late = [
            t for t in self._thrusts if t[0] > observation.t_s - p.latency_s - self.MAX_INTERVAL_S
        ]
        self._thrusts = [*late, (observation.t_s, *thrust)]
        self._before = (observation.t_s, north, east)
        if before is None or since_s is None:
            return ReportedMotion(north, east, down, 0.0, 0.0, *thrust, 0.0, None)
        start = self._interpolated_thrust_accel_ne_mps2(before[0] - p.latency_s)
        end = self._interpolated_thrust_accel_ne_mps2(observation.t_s - p.latency_s)
        return ReportedMotion(
            north,
            east,
            down,
            (north - before[1]) / since_s,
            (east - before[2]) / since_s,
            0.5 * (start[0] + end[0]),
            0.5 * (start[1] + end[1]),
            math.hypot(end[0] - start[0], end[1] - start[1]),
            since_s,
        )

    def _update_smoothed_sink_rate(
        self, down_mps: float, interval_s: float | None, time_constant_s: float
    ) -> None:
        if self._sink_mps is None or interval_s is None:
            self._sink_mps, self._sinking_mps2 = down_mps, 0.0
            return
        step = (1.0 - math.exp(-interval_s / time_constant_s)) * (down_mps - self._sink_mps)
        self._sink_mps += step
        self._sinking_mps2 = step / interval_s

    def _interpolated_thrust_accel_ne_mps2(self, t_s: float) -> tuple[float, float]:
        """Thrust interpolated at `t_s`; clamped to the first and last report."""
        later = self._thrusts[0]
        for early, late in itertools.pairwise(self._thrusts):
            later = late
            if late[0] >= t_s:
                share = min(max((t_s - early[0]) / (late[0] - early[0]), 0.0), 1.0)
                return (
                    early[1] + share * (late[1] - early[1]),
                    early[2] + share * (late[2] - early[2]),
                )
        return later[1], later[2]


def _horizontal_thrust_accel_ne_mps2(
    observation: WindObservation, upward_thrust_accel_mps2: float
) -> tuple[float, float]:
    """Horizontal thrust acceleration (north, east). Thrust points along minus the body's z axis;
    its upward part is `upward_thrust_accel_mps2`.
    """
    roll, pitch, yaw = (
        observation.roll_rad or 0.0,
        observation.pitch_rad or 0.0,
        observation.yaw_rad or 0.0,
    )
    forward = -upward_thrust_accel_mps2 * math.tan(pitch)
    right = upward_thrust_accel_mps2 * math.tan(roll) / math.cos(pitch)
    cos, sin = math.cos(yaw), math.sin(yaw)
    return cos * forward - sin * right, sin * forward + cos * right


@dataclass(frozen=True, slots=True)
class DragMeasurement:
    """Drag acceleration along heading and to its right.

    `measured` and `expected` in m/s2; `size_mps2`, the magnitude that the airframe file and gains
    give; `curvature_pm` (1/m), an upper bound on the change of slope with airspeed; `rows` (2,
    states), d(expected - measured)/dx; `cross_rows`, for each axis the change with the cross-flow
    share of its slope by the wind to north and east.
    """

    measured: tuple[float, float]
    expected: tuple[float, float]
    size_mps2: float
    curvature_pm: tuple[float, float]
    airspeed_mps: float
    rows: Floats
    cross_rows: tuple[tuple[float, float], tuple[float, float]]


def measured_and_expected_drag(
    airframe: Airframe, observation: WindObservation, state_vector: Floats, motion: ReportedMotion
) -> DragMeasurement:
    """Measured drag, and the drag that the state `state_vector` (18,) predicts."""
    mass_kg, yaw_rad = observation.mass_kg, observation.yaw_rad or 0.0
    mean_n, mean_e, gust_n, gust_e, _, _, trim_f, trim_r, log_f, log_r, heading_error = (
        state_vector[:11].tolist()
    )
    heading = yaw_rad + heading_error
    cos, sin = math.cos(heading), math.sin(heading)
    air_n = motion.velocity_n - mean_n - gust_n
    air_e = motion.velocity_e - mean_e - gust_e
    forward, right = cos * air_n + sin * air_e, -sin * air_n + cos * air_e
    speed = max(math.hypot(forward, right, motion.sink_mps), 1e-3)
    cross = min(max(float(state_vector[StateIndex.CROSS_FLOW]), 0.0), 1.0)
    k_f, k_r = airframe.linear_drag_forward_right_n_per_mps(mass_kg, observation.density_kgpm3)
    q_f, q_r = airframe.quadratic_drag_forward_right_n_per_mps2(mass_kg, observation.density_kgpm3)
    scale_f, scale_r = (
        _clamped_gain_from_log(log_f) / mass_kg,
        _clamped_gain_from_log(log_r) / mass_kg,
    )
    flow_f, flow_r = (forward, right, motion.sink_mps), (right, forward, motion.sink_mps)
    drag_f = _axis_drag_and_derivatives(scale_f * k_f, scale_f * q_f, flow_f, cross)
    drag_r = _axis_drag_and_derivatives(scale_r * k_r, scale_r * q_r, flow_r, cross)
    ff, fr, rr, rf = drag_f.by_parallel, drag_f.by_across, drag_r.by_parallel, drag_r.by_across
    # The heading error rotates the acceleration, measured over ground, but not the thrust, which is
    # in body axes. The estimated velocity noises are taken out of the acceleration.
    dt_s = motion.since_s or 1.0
    noise_n, noise_e, before_n, before_e = state_vector[
        StateIndex.NOISE : StateIndex.CROSS_FLOW
    ].tolist()
    accel_n = motion.accel_n - (noise_n - before_n) / dt_s
    accel_e = motion.accel_e - (noise_e - before_e) / dt_s
    accel_f = cos * accel_n + sin * accel_e
    accel_r = cos * accel_e - sin * accel_n
    yaw_cos, yaw_sin = math.cos(yaw_rad), math.sin(yaw_rad)
    thrust_f = yaw_cos * motion.thrust_n + yaw_sin * motion.thrust_e
    thrust_r = yaw_cos * motion.thrust_e - yaw_sin * motion.thrust_n
    turn_f = fr * forward - ff * right - accel_r
    turn_r = rr * forward - rf * right + accel_f
    fn, fe = ff * cos - fr * sin, ff * sin + fr * cos
    rn, re = rf * cos - rr * sin, rf * sin + rr * cos
    g = GRAVITY_MPS2
    row_f = [fn, fe, fn, fe, 0.0, 0.0, g, 0.0, -drag_f.drag, 0.0, turn_f, 0.0, 0.0]
    row_f += [cos / dt_s, sin / dt_s, -cos / dt_s, -sin / dt_s, -drag_f.by_cross]
    row_r = [rn, re, rn, re, 0.0, 0.0, 0.0, g, 0.0, -drag_r.drag, turn_r, 0.0, 0.0]
    row_r += [-sin / dt_s, cos / dt_s, sin / dt_s, -cos / dt_s, -drag_r.by_cross]
    more_ff, more_fr = drag_f.by_parallel_cross, drag_f.by_across_cross
    more_rr, more_rf = drag_r.by_parallel_cross, drag_r.by_across_cross
    return DragMeasurement(
        measured=(accel_f - thrust_f, accel_r - thrust_r),
        expected=(-drag_f.drag + g * trim_f, -drag_r.drag + g * trim_r),
        size_mps2=math.hypot(drag_f.drag, drag_r.drag),
        curvature_pm=(2.0 * scale_f * q_f, 2.0 * scale_r * q_r),
        airspeed_mps=speed,
        rows=np.array([row_f, row_r]),
        cross_rows=(
            (more_ff * cos - more_fr * sin, more_ff * sin + more_fr * cos),
            (more_rf * cos - more_rr * sin, more_rf * sin + more_rr * cos),
        ),
    )


class _AxisDrag(NamedTuple):
    """Drag acceleration along one body axis (m/s2) and its derivatives, by the air velocity along
    and across the axis, by the cross-flow share, and of the first two by that share."""

    drag: float
    by_parallel: float
    by_across: float
    by_cross: float
    by_parallel_cross: float
    by_across_cross: float


def _axis_drag_and_derivatives(
    linear: float, quadratic: float, flow_mps: tuple[float, float, float], cross_flow_share: float
) -> _AxisDrag:
    """Linear and quadratic drag over mass (1/s, 1/m) in a flow along the axis, across it, and down.

    The quadratic part is `quadratic * s * parallel`, where `s` lies between two published laws:
    `cross_flow_share` 1 is the airspeed (PX4, EKF2 drag fusion), 0 the axis's own flow (ArduPilot,
    SITL frame). The vertical flow counts in both.
    """
    parallel, across, down = flow_mps
    own = max(math.hypot(parallel, down), 1e-3)
    speed = max(math.hypot(own, across), 1e-3)
    slant_own, slant = parallel * parallel / own, parallel * parallel / speed
    size = linear + quadratic * ((1.0 - cross_flow_share) * own + cross_flow_share * speed)
    mixed = quadratic * parallel * across / speed
    return _AxisDrag(
        drag=size * parallel,
        by_parallel=size
        + quadratic * ((1.0 - cross_flow_share) * slant_own + cross_flow_share * slant),
        by_across=cross_flow_share * mixed,
        by_cross=quadratic * (speed - own) * parallel,
        by_parallel_cross=quadratic * (speed - own + slant - slant_own),
        by_across_cross=mixed,
    )


def _clamped_gain_from_log(log_gain: float) -> float:
    return math.exp(min(max(log_gain, -_MAX_LOG_GAIN), _MAX_LOG_GAIN))


@dataclass(frozen=True, slots=True)
class TiltInnovation:
    """Innovations (m/s2) of both axes from one drag measurement, their variances, and the update.

    `gain` (states, 2) and `white` (2,) are whitened: the update adds `gain @ white` to the state
    and subtracts `gain @ gain.T` from the covariance. `area` is the square root of the innovation
    covariance's determinant.
    """

    innovations: tuple[float, float]
    variances: tuple[float, float]
    gain: Floats
    white: Floats
    area: float

    def capped_log_density(self, max_sigmas: float, noise_variance_ratio: float) -> float:
        """Log of the innovation's Gaussian density, up to a constant.

        Its size is capped at `max_sigmas`. `noise_variance_ratio` is the observed innovation
        variance over the stated one.
        """
        size = min(float(self.white @ self.white) / noise_variance_ratio, max_sigmas**2)
        return -0.5 * size - math.log(self.area)

    @property
    def mean_nis(self) -> float:
        """Mean normalised innovation squared (NIS) per axis; 1 if consistent."""
        (a, b), (s, t) = self.innovations, self.variances
        return 0.5 * (a * a / s + b * b / t)

    def is_outlier(self, max_sigmas: float) -> bool:
        """Whether the innovation of either axis exceeds `max_sigmas` standard deviations."""
        (a, b), (s, t) = self.innovations, self.variances
        return a * a > max_sigmas**2 * s or b * b > max_sigmas**2 * t

    @property
    def wind_correction_ne_mps(self) -> tuple[float, float]:
        """Correction of the total wind, mean plus gust."""
        mean_n, mean_e, gust_n, gust_e = (self.gain[:4] @ self.white).tolist()
        return mean_n + gust_n, mean_e + gust_e

    @property
    def wind_correction_variance_m2ps2(self) -> float:
        """Expected variance of that correction, summed over both axes."""
        wind = self.gain[:2] + self.gain[2:4]
        return float(np.vdot(wind, wind))


def compute_tilt_innovation_and_set_airspeed(
    state: WindState,
    airframe: Airframe,
    params: WindEstimatorParams,
    observation: WindObservation,
    motion: ReportedMotion,
) -> TiltInnovation:
    """Innovation and update of `state` from one drag measurement.

    Once the wind is known, one linearisation as in an extended Kalman filter. Before, five more
    iterations (Bell and Cathey 1993): drag is quadratic, and its slope in still air would make the
    first estimate far too large.
    """
    known = state.is_wind_std_below_known_limit
    result = _innovation_linearised_about(state, state.x, airframe, params, observation, motion)
    for _ in range(0 if known else 5):
        result = _innovation_linearised_about(
            state, state.x + result.gain @ result.white, airframe, params, observation, motion
        )
    return result


def _innovation_linearised_about(
    state: WindState,
    linearisation_point: Floats,
    airframe: Airframe,
    params: WindEstimatorParams,
    observation: WindObservation,
    motion: ReportedMotion,
) -> TiltInnovation:
    """One linearisation about `linearisation_point` (18,), not always the state's mean."""
    drag = measured_and_expected_drag(airframe, observation, linearisation_point, motion)
    state.airspeed_mps = drag.airspeed_mps
    rows = drag.rows
    left_f = drag.measured[0] - drag.expected[0]
    left_r = drag.measured[1] - drag.expected[1]
    if linearisation_point is not state.x:
        offset_f, offset_r = (rows @ (state.x - linearisation_point)).tolist()
        left_f, left_r = left_f - offset_f, left_r - offset_r
    across = state.cov @ rows.T
    (ff, fr), (_, rr) = (rows @ across).tolist()
    noise_f, noise_r = _measurement_noise_variances(state, airframe, params, drag, motion)
    bend_f, bend_r = _linearisation_error_variances(state, drag)
    ff, rr = ff + noise_f + bend_f, rr + noise_r + bend_r
    # Cholesky factor of the innovation covariance, [[a, 0], [b, c]], and its inverse
    a = math.sqrt(ff)
    b = fr / a
    c = math.sqrt(rr - b * b)
    whitening = np.array([[1.0 / a, -b / (a * c)], [0.0, 1.0 / c]])
    first = left_f / a
    white = np.array([first, (left_r - b * first) / c])
    return TiltInnovation((left_f, left_r), (ff, rr), across @ whitening, white, a * c)


def _measurement_noise_variances(
    state: WindState,
    airframe: Airframe,
    p: WindEstimatorParams,
    drag_measurement: DragMeasurement,
    motion: ReportedMotion,
) -> tuple[float, float]:
    """Measurement noise variance along each axis: attitude noise, fast gusts, timing error in
    transients, and the drag model's error, correlated over seconds.
    """
    dt_s = max(motion.since_s or 0.1, 0.02)
    late = (p.latency_std_s / dt_s * motion.thrust_change_mps2) ** 2
    off = airframe.drag.model_std_frac * drag_measurement.size_mps2
    steady = (p.tilt_noise_m2ps3 + 2.0 * p.model_memory_s * off**2) / dt_s + late
    gust = state.fast_gust_spectral_density_m2ps / dt_s
    (fn, fe), (rn, re) = drag_measurement.rows[:, :2].tolist()
    return steady + gust * (fn * fn + fe * fe), steady + gust * (rn * rn + re * re)


def _linearisation_error_variances(
    state: WindState, drag_measurement: DragMeasurement
) -> tuple[float, float]:
    """Variance along each axis that the linearisation omits while wind, gain and cross-flow share
    are uncertain.

    Half the trace of (H P)^2, with H the drag's second derivatives (Jazwinski 1970, 9.3); those by
    wind are taken at their upper bound. On one heading only a sum of wind, gain and trim is
    observable. Without this term the moving linearisation point would seem to separate them.
    """
    p = state.cov[:, : StateIndex.LAGGED_MEAN].tolist()
    nn = p[0][0] + 2.0 * p[0][2] + p[2][2]
    ne = p[0][1] + p[0][3] + p[2][1] + p[2][3]
    ee = p[1][1] + 2.0 * p[1][3] + p[3][3]
    most = 0.5 * (nn + ee) + math.hypot(0.5 * (nn - ee), ne)
    result: list[float] = []
    for axis, wind_row in enumerate(drag_measurement.rows[:, :2].tolist()):
        left = 0.5 * (drag_measurement.curvature_pm[axis] * most) ** 2
        for at, (n, e) in (
            (StateIndex.LOG_GAIN + axis, wind_row),
            (StateIndex.CROSS_FLOW, drag_measurement.cross_rows[axis]),
        ):
            shared = n * (p[at][0] + p[at][2]) + e * (p[at][1] + p[at][3])
            slope = n * n * nn + 2.0 * n * e * ne + e * e * ee
            left += slope * float(state.cov[at, at]) + shared**2
        result.append(left)
    return result[0], result[1]
