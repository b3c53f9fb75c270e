"""State of the wind's extended Kalman filter: states, process model, measurement update.

18 states: slow mean wind north and east (m/s); gust on top of it (m/s); lagged mean of both over
the last seconds (m/s); tilt trim along body forward and right (rad); log drag gain of each axis;
heading error (rad); log airspeed scale; airspeed bias (m/s); noise of the latest reported velocity
and of the one before, north and east (m/s); cross-flow share of the drag.

- The slow mean is a random walk. Gusts are Ornstein-Uhlenbeck. Their std is a fraction of the
  wind. Their memory is eddy length over airspeed (frozen turbulence, Taylor 1938).
- The output is the mean wind over a 10 s window centred on now. The past half is the third pair of
  states, a lag whose mean age is about that of the last 5 s. The future half is predicted from the
  slow mean and the decayed gust. The unpredictable part of the gust widens the covariance.
- An acceleration is the difference of two noisy reported velocities. Each noise enters two
  successive differences with opposite signs, so it is a state. No low-pass filter delays the wind.
- Trims, gains and scales start from the airframe's priors and walk slowly. If the heading never
  changes, only those priors separate them from the wind, and the covariance shows it.
- An airframe's drag across the measured flow direction is unknown. PX4's drag fusion takes
  each axis's drag with the whole airspeed, ArduPilot's simulator with the axis's own flow. At 10
  m/s across a wind of 9 these differ by a fifth. The cross-flow share lies between them.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.turbulence import LastingChangeDetector, Turbulence

STATES = 18


class StateIndex(IntEnum):
    """Index of each state in `x`. A pair has north or forward first, then east or right."""

    MEAN = 0
    GUST = 2
    LAGGED_MEAN = 4
    TRIM = 6
    LOG_GAIN = 8
    HEADING = 10
    LOG_SCALE = 11
    BIAS = 12
    NOISE = 13
    NOISE_BEFORE = 15
    CROSS_FLOW = 17


@dataclass(frozen=True, slots=True)
class WindEstimatorParams:
    """Process and measurement noises, thresholds, and their sources.

    [est]: own estimate. [coast]: from a recording at a coast (awegroup, 12 May 2023), mean wind
    8.4 m/s. There, half the variance of the wind's change over 1, 5, 10, 30, 300 s is 0.0043,
    0.0135, 0.017, 0.023, 0.035 of the mean wind squared, each axis. A gust of 15 % with 5 s of
    memory on a walk of 0.006 m2/s3 gives the same.
    """

    prior_wind_std_mps: float = 10.0  # each axis, before any measurement
    mean_process_noise_m2ps3: float = (
        0.005  # [coast] at the reference wind; scales with wind squared
    )
    min_process_noise_m2ps3: float = (
        0.005  # [coast] lower limit, same scaling; holds in calm air too
    )
    gust_frac: float = 0.15  # [coast] of the mean wind; prior until learned in flight
    gust_length_m: float = 60.0  # used if height is unknown; [coast] has 40 m near ground
    fast_gust_m2ps: float = 0.15  # gusts too fast to track, as noise, at the reference wind
    reference_wind_mps: float = 8.4  # [coast]
    least_wind_mps: float = 3.0  # below it gusts stop scaling with wind (sonic_a: 50 %)
    lag_s: float = 2.7  # time constant of the exponential nearest to the mean of the last 5 s
    trim_process_noise_rad2ps: float = math.radians(0.2) ** 2 / 60.0  # [est] heat, manoeuvres
    gain_process_noise_per_s: float = 0.02**2 / 600.0
    gain_parcel_std_frac: float = 0.03  # [est] error of the parcel's own drag
    prior_heading_std_rad: float = math.radians(2.5)  # compass calibration and declination
    heading_process_noise_rad2ps: float = math.radians(0.5) ** 2 / 300.0
    velocity_std_mps: float = 0.06  # u-blox M8 data sheet: 0.05, unfused
    latency_s: float = 0.02  # velocity behind attitude: PX4 sends 50, 100 a second; GNSS 0.12
    latency_std_s: float = 0.08  # [est]
    sink_smoothing_s: float = 0.3  # of the vertical velocity, which sets the lift
    tilt_noise_m2ps3: float = 0.05**2 * 0.1  # attitude noise, 0.3 deg at 10 Hz, as spectral density
    model_memory_s: float = 5.0  # [est] correlation time of the drag model's error
    # [est] Share of the airspeed (1) against the axis's own flow (0): nearer to the first, and wide
    # enough for both.
    cross_flow: float = 0.85
    cross_flow_std: float = 0.2
    known_wind_std_mps: float = 1.5
    gain_waits_for_wind: bool = False  # for airframes of unknown drag
    pitot_scale_std_frac: float = 0.08  # [est] position error near rotors
    pitot_bias_std_mps: float = 0.5  # [est] zero after calibration
    pitot_process_noise_per_s: float = (
        0.01**2 / 300.0
    )  # of scale; same value for the bias, in (m/s)^2/s
    scalar_wind_std_mps: float = 2.5  # airspeed is used only once the wind's std is below this
    pitot_std_mps: float = 0.5
    pitot_memory_s: float = 0.5
    pitot_model_std_frac: float = 0.05  # [est] flow angle and rotor wash; not estimated
    pitot_min_mps: float = 4.0  # below this, a pitot on a multirotor reads its own offset
    vector_std_mps: float = 0.5  # [est] a small ultrasonic anemometer on a mast
    autopilot_std_mps: float = 1.0  # used if it reports none
    autopilot_least_std_mps: float = 0.3  # excludes errors of its drag coefficients and trims
    autopilot_interval_s: float = 1.0
    autopilot_memory_s: float = 10.0  # it is filtered, so its errors are correlated
    gate_sigmas: float = 4.0
    reset_after_s: float = 4.0
    stuck_after_s: float = 5.0
    pitot_check_memory_s: float = 5.0
    faulty_sigmas: float = 3.0
    recovery_sigmas: float = 2.0
    recovery_after_s: float = 10.0
    unmodelled_std_mps: float = 0.05  # [est] unmodelled errors
    has_calm_hypothesis: bool = True  # a second filter in light wind, for calm air
    learns_turbulence: bool = True  # and detects fronts
    settle_s: float = 5.0
    stale_after_s: float = 15.0


class WindState:
    """Mean `x` (18,) and covariance `cov` (18, 18): one hypothesis of the filter."""

    __slots__ = ("_params", "airspeed_mps", "cov", "front", "gust_length_m", "turbulence", "x")

    def __init__(self, airframe: Airframe, params: WindEstimatorParams) -> None:
        self._params = params
        self.x = np.zeros(STATES)
        self.x[StateIndex.CROSS_FLOW] = params.cross_flow
        self.cov = _prior_state_covariance(airframe, params)
        self.airspeed_mps = 0.0
        self.gust_length_m = params.gust_length_m
        self.turbulence = Turbulence()
        self.front = LastingChangeDetector()

    def copy(self) -> "WindState":
        """An independent copy, for a second hypothesis."""
        other = object.__new__(WindState)
        other._params = self._params
        other.x, other.cov = self.x.copy(), self.cov.copy()
        other.gust_length_m = self.gust_length_m
        other.airspeed_mps, other.turbulence = self.airspeed_mps, replace(self.turbulence)
        other.front = replace(self.front)
        return other

    def snapshot(self) -> dict[str, object]:
        """Contents of a checkpoint."""
        return {
            "x": self.x.tolist(),
            "cov": self.cov.tolist(),
            "airspeed_mps": self.airspeed_mps,
            "turbulence": self.turbulence.ratio,
        }

    def restore(self, snapshot: dict[str, object]) -> None:
        """Restore a checkpoint; raises KeyError, ValueError or LeewayError if it is invalid."""
        x = np.array(msgspec.convert(snapshot["x"], list[float]))
        cov = np.array(msgspec.convert(snapshot["cov"], list[list[float]]))
        airspeed_mps = msgspec.convert(snapshot["airspeed_mps"], float)
        turbulence = msgspec.convert(snapshot["turbulence"], float)
        usable = (
            x.shape == (STATES,)
            and cov.shape == (STATES, STATES)
            and np.isfinite([*x, *cov.ravel(), airspeed_mps, turbulence]).all()
        )
        if not usable or float(np.linalg.eigvalsh(cov)[0]) < -1e-9 or turbulence <= 0.0:
            raise LeewayError(f"checkpoint: expected {STATES} finite states and their covariance")
        self.x, self.cov = x, 0.5 * (cov + cov.T)
        self.airspeed_mps, self.turbulence.ratio = airspeed_mps, turbulence

    @property
    def allows_calm_hypothesis(self) -> bool:
        """Whether calm air is a hypothesis at all."""
        return self._params.has_calm_hypothesis

    @property
    def is_wind_std_below_known_limit(self) -> bool:
        """Whether the wind's std is small enough to linearise the drag about it once."""
        return self.mean_wind_axis_std_mps < self._params.known_wind_std_mps

    @property
    def mean_wind_axis_std_mps(self) -> float:
        """Standard deviation of the slow mean along one axis."""
        return math.sqrt(0.5 * float(self.cov[0, 0] + self.cov[1, 1]))

    @property
    def mean_wind_speed_minus_std_mps(self) -> float:
        """Speed of the slow mean less one standard deviation of an axis."""
        return math.hypot(self.x[0], self.x[1]) - self.mean_wind_axis_std_mps

    @property
    def squared_wind_ratio_to_reference(self) -> float:
        """Wind squared over reference wind squared. The wind has a floor, `least_wind_mps`."""
        p = self._params
        wind = max(math.hypot(self.x[0], self.x[1]), p.least_wind_mps)
        return (wind / p.reference_wind_mps) ** 2

    @property
    def gust_variance_m2ps2(self) -> float:
        """Stationary variance of the gust along each axis."""
        p = self._params
        return (
            self.turbulence.ratio
            * p.gust_frac**2
            * p.reference_wind_mps**2
            * self.squared_wind_ratio_to_reference
        )

    @property
    def fast_gust_spectral_density_m2ps(self) -> float:
        """Spectral density of gusts too fast for the filter, treated as white noise.

        Scaled by the turbulence ratio only if that ratio is given (`is_given`). A ratio learned
        from slow gusts does not determine fast ones.
        """
        calm = self.turbulence.ratio if self.turbulence.is_given else 1.0
        return self._params.fast_gust_m2ps * self.squared_wind_ratio_to_reference * calm

    @property
    def mean_process_noise_m2ps3(self) -> float:
        """Process noise of the slow mean. Lower in calm air, but never below what recordings show;
        higher while a front passes.
        """
        p = self._params
        process_noise = max(
            p.mean_process_noise_m2ps3 * min(self.turbulence.ratio, 1.0), p.min_process_noise_m2ps3
        )
        return process_noise * self.squared_wind_ratio_to_reference + self.front.process_noise_m2ps3

    @property
    def gust_correlation_time_s(self) -> float:
        """Correlation time of a gust: eddy length over airspeed."""
        p = self._params
        return self.gust_length_m / max(self.airspeed_mps, p.least_wind_mps)

    def update_turbulence_and_front(
        self,
        wind_correction_ne_mps: tuple[float, float],
        expected_variance_m2ps2: float,
        mean_nis: float,
        dt_s: float,
    ) -> None:
        """Learn the turbulence from one wind correction by tilt, see `Turbulence`.

        Skipped if the turbulence is given. No fronts are detected then either: in calm air, the
        residue of a turn was taken for a front.
        """
        if self.turbulence.is_given or not self._params.learns_turbulence:
            return
        self.turbulence.update_turbulence_ratio(
            wind_correction_ne_mps, expected_variance_m2ps2, mean_nis, dt_s
        )
        excess_m2ps2 = self.front.update_and_detect_front_m2ps2(
            wind_correction_ne_mps, expected_variance_m2ps2, dt_s
        )
        if excess_m2ps2 > 0.0:
            self.inflate_mean_wind_variance(excess_m2ps2)

    def predict_state(self, dt_s: float) -> None:
        """Prediction step over `dt_s`."""
        if dt_s <= 0.0:
            return
        p = self._params
        keep = math.exp(-dt_s / self.gust_correlation_time_s)
        lag_fraction = 1.0 - math.exp(-dt_s / p.lag_s)
        variance = self.gust_variance_m2ps2
        left = 1.0 - lag_fraction
        transition = _ZERO_TIME_TRANSITION.copy()
        transition.reshape(-1)[_TRANSITION_INDICES] = (
            keep,
            keep,
            left,
            left,
            lag_fraction,
            lag_fraction,
            lag_fraction,
            lag_fraction,
        )
        self.x = transition @ self.x
        cov = transition @ self.cov @ transition.T
        cov += cov.T  # restore symmetry
        cov *= 0.5
        self.cov = cov
        process_noise = self.mean_process_noise_m2ps3 * dt_s
        gust = variance * (1.0 - keep * keep)
        trim, gain = p.trim_process_noise_rad2ps * dt_s, p.gain_process_noise_per_s * dt_s
        pitot = p.pitot_process_noise_per_s * dt_s
        heading = p.heading_process_noise_rad2ps * dt_s
        new = p.velocity_std_mps**2
        cov.reshape(-1)[:: STATES + 1] += (
            *(
                process_noise,
                process_noise,
                gust,
                gust,
                0.0,
                0.0,
                trim,
                trim,
                gain,
                gain,
                heading,
                pitot,
                pitot,
            ),
            *(new, new, 0.0, 0.0, 0.0),
        )

    def correct_by_two_scalars(self, whitened_gain: Floats, whitened_innovations: Floats) -> None:
        """Kalman update by two scalars at once. `whitened_gain` (18, 2) is the covariance of state
        and innovations, whitened. `whitened_innovations` (2,) is the whitened innovations. With
        `gain_waits_for_wind`, drag gains are not estimated until the wind is known, but their error
        counts (Schmidt 1966): gusts in a hover seem to refute a wide prior.
        """
        gains = slice(StateIndex.LOG_GAIN, StateIndex.HEADING)
        kept_x, kept_cov = self.x[gains].copy(), self.cov[gains, gains].copy()
        waits = self._params.gain_waits_for_wind and not self.is_wind_std_below_known_limit
        self.x += whitened_gain @ whitened_innovations
        # A matrix times its transpose is exactly symmetric.
        self.cov -= whitened_gain @ whitened_gain.T
        if waits:
            self.x[gains], self.cov[gains, gains] = kept_x, kept_cov

    def correct_by_scalar(
        self, measurement_row: Floats, innovation: float, noise_variance: float
    ) -> None:
        """Kalman update by one scalar with variance `noise_variance`; `measurement_row` (18,) is
        its derivative by the state.
        """
        gain = self.cov @ measurement_row
        s = float(measurement_row @ gain) + noise_variance
        self.x += gain * (innovation / s)
        self.cov -= np.multiply.outer(gain, gain) / s  # exactly symmetric: products commute

    def ten_second_wind_mean_and_cov(self, since_last_update_s: float) -> tuple[Floats, Floats]:
        """Mean (2,) and covariance (2, 2) of the 10 s mean wind, `since_last_update_s` after the
        last update.

        The reported velocity is late by `latency_s`, so the predicted part is longer by that much.
        """
        p = self._params
        memory_s = self.gust_correlation_time_s
        future_s = 0.5 * _WINDOW_S + p.latency_s
        share = future_s / _WINDOW_S
        gust = share * memory_s / future_s * (1.0 - math.exp(-future_s / memory_s))
        rows = np.zeros((2, STATES))
        for axis in (0, 1):
            rows[axis, StateIndex.MEAN + axis] = share
            rows[axis, StateIndex.LAGGED_MEAN + axis] = 1.0 - share
            rows[axis, StateIndex.GUST + axis] = gust
        variance = self.gust_variance_m2ps2
        unpredicted_variance = (
            share**2 * variance * _ornstein_uhlenbeck_mean_variance(future_s / memory_s)
        )
        lag = 0.25 * _LAG_MISFIT_S * 2.0 * variance / memory_s
        drift_variance = self.mean_process_noise_m2ps3 * (since_last_update_s + future_s / 12.0)
        gust_change_variance = 2.0 * variance * (1.0 - math.exp(-since_last_update_s / memory_s))
        spread = (
            unpredicted_variance
            + lag
            + drift_variance
            + gust_change_variance
            + p.unmodelled_std_mps**2
        )
        cov = rows @ self.cov @ rows.T
        return rows @ self.x, 0.5 * (cov + cov.T) + spread * _IDENTITY

    def inflate_mean_wind_variance(self, variance_m2ps2: float) -> None:
        """Add a variance on each axis to the slow mean and the lagged mean, fully correlated."""
        for at in (0, 1):
            for first in (StateIndex.MEAN, StateIndex.LAGGED_MEAN):
                for second in (StateIndex.MEAN, StateIndex.LAGGED_MEAN):
                    self.cov[first + at, second + at] += variance_m2ps2

    def inflate_trim_variance(self, variance_rad2: float) -> None:
        """Add this variance to both trims."""
        self.cov[
            [StateIndex.TRIM, StateIndex.TRIM + 1], [StateIndex.TRIM, StateIndex.TRIM + 1]
        ] += variance_rad2

    def inflate_drag_gain_variance(self, variance: float) -> None:
        """Add this variance to both drag gains, fully correlated: both axes changed together."""
        self.cov[
            StateIndex.LOG_GAIN : StateIndex.HEADING, StateIndex.LOG_GAIN : StateIndex.HEADING
        ] += variance


_WINDOW_S = 10.0
_LAG_MISFIT_S = 0.075  # integral of (mean of 5 s less lag of 2.7 s)^2 over a random walk's past
_IDENTITY = np.eye(2)
_MEAN = [StateIndex.MEAN, StateIndex.MEAN + 1]
_LAGGED_MEAN = [StateIndex.LAGGED_MEAN, StateIndex.LAGGED_MEAN + 1]
_NOISE = [StateIndex.NOISE, StateIndex.NOISE + 1]
_NOISE_BEFORE = [StateIndex.NOISE_BEFORE, StateIndex.NOISE_BEFORE + 1]


def _zero_time_transition() -> Floats:
    """Transition over no time: identity, but the last velocity noise becomes the one before."""
    transition = np.eye(STATES)
    transition[_NOISE, _NOISE] = transition[_NOISE_BEFORE, _NOISE_BEFORE] = 0.0
    transition[_NOISE_BEFORE, _NOISE] = 1.0
    return transition


_ZERO_TIME_TRANSITION = _zero_time_transition()
# Flat indices into the transition matrix that `predict_state` fills, as (row, column): gust on
# itself, lagged mean on itself, on the slow mean, on the gust.
_TRANSITION_INDICES = np.array(
    [
        STATES * (row + axis) + column + axis
        for row, column in (
            (StateIndex.GUST, StateIndex.GUST),
            (StateIndex.LAGGED_MEAN, StateIndex.LAGGED_MEAN),
            (StateIndex.LAGGED_MEAN, StateIndex.MEAN),
            (StateIndex.LAGGED_MEAN, StateIndex.GUST),
        )
        for axis in (0, 1)
    ]
)


def eddy_length_at_height_m(height_m: float) -> float:
    """Eddy length at a height above ground: L_u of MIL-F-8785C, 3.7.3.4. Valid from 10 to 1,000
    feet, clamped beyond. 35 m at 3 m, 150 m at 30 m.
    """
    feet = min(max(height_m / 0.3048, 10.0), 1000.0)
    return 0.3048 * feet / (0.177 + 0.000823 * feet) ** 1.2


def _ornstein_uhlenbeck_mean_variance(averaging_time_in_memories: float) -> float:
    """Variance of the mean over `averaging_time_in_memories` correlation times of an
    Ornstein-Uhlenbeck process of variance 1 that starts at a known value: the double integral of
    exp(-|s - u|) - exp(-(s + u)).
    """
    a, decay, squared_decay = (
        averaging_time_in_memories,
        math.exp(-averaging_time_in_memories),
        math.exp(-2.0 * averaging_time_in_memories),
    )
    return 2.0 / a**2 * (a - (1.0 - decay) - (1.0 - decay) + 0.5 * (1.0 - squared_decay))


def _prior_state_covariance(airframe: Airframe, p: WindEstimatorParams) -> Floats:
    drag = airframe.drag
    wind = p.prior_wind_std_mps**2
    gust = (p.gust_frac * p.least_wind_mps) ** 2
    trim = math.radians(drag.trim_std_deg) ** 2
    common, own = drag.gain_std_frac**2, drag.axis_gain_std_frac**2
    diagonal = [wind, wind, gust, gust, wind, wind, trim, trim, common + own, common + own]
    diagonal += [p.prior_heading_std_rad**2, p.pitot_scale_std_frac**2, p.pitot_bias_std_mps**2]
    diagonal += [p.velocity_std_mps**2] * 4 + [p.cross_flow_std**2]
    cov = np.diag(diagonal)
    cov[StateIndex.LOG_GAIN, StateIndex.LOG_GAIN + 1] = cov[
        StateIndex.LOG_GAIN + 1, StateIndex.LOG_GAIN
    ] = common
    cov[_MEAN, _LAGGED_MEAN] = cov[_LAGGED_MEAN, _MEAN] = wind
    return cov
