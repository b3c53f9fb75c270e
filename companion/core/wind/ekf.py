"""State of the wind's extended Kalman filter: states, process model, measurement update.

18 states: slow mean wind north and east (m/s); gust on top of it (m/s); lagged mean of both over
the last seconds (m/s); tilt trim along body forward and right (rad); log drag gain of each axis;
heading error (rad); log airspeed scale; airspeed bias (m/s); noise of the latest reported velocity
and of the one before, north and east (m/s); cross-flow share of the drag.

- The slow mean is a random walk. Gusts are Ornstein-Uhlenbeck. Their std is a fraction of the
  wind. Their memory is eddy length over airspeed (frozen turbulence, Taylor 1938).
- The output is the mean wind over a 10 s window centred on now. The past half is the third pair of
  states, a lag whose mean age is about that of the last 5 s. The future half is predicted from the
  slow mean and the decayed gust. What cannot be predicted of the gust widens the covariance.
- An acceleration is the difference of two noisy reported velocities. Each noise enters two
  successive differences with opposite signs, so it is a state. No low-pass filter delays the wind.
- Trims, gains and scales start from the airframe's priors and walk slowly. If the heading never
  changes, only those priors separate them from the wind, and the covariance shows it.
- Nobody knows an airframe's drag across the flow that it was measured in. PX4's drag fusion takes
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
from companion.core.wind.turbulence import Front, Turbulence

STATES = 18


class At(IntEnum):
    """Index of each state in `x`. A pair has north or forward first, then east or right."""

    MEAN = 0
    GUST = 2
    LATELY = 4
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

    [est]: our estimate. [coast]: from a recording at a coast (awegroup, 12 May 2023), mean wind
    8.4 m/s. There, half the variance of the wind's change over 1, 5, 10, 30, 300 s is 0.0043,
    0.0135, 0.017, 0.023, 0.035 of the mean wind squared, each axis. A gust of 15 % with 5 s of
    memory on a walk of 0.006 m2/s3 gives the same.
    """

    prior_wind_std_mps: float = 10.0  # each axis, before any measurement
    mean_walk_m2ps3: float = 0.005  # [coast] at the reference wind; scales with wind squared
    least_walk_m2ps3: float = 0.005  # [coast] lower limit, same scaling; holds in calm air too
    gust_frac: float = 0.15  # [coast] of the mean wind; prior until learned in flight
    gust_length_m: float = 60.0  # used if height is unknown; [coast] has 40 m near ground
    fast_gust_m2ps: float = 0.15  # gusts too fast to track, as noise, at the reference wind
    reference_wind_mps: float = 8.4  # [coast]
    least_wind_mps: float = 3.0  # below it gusts stop scaling with wind (sonic_a: 50 %)
    lag_s: float = 2.7  # time constant of the exponential nearest to the mean of the last 5 s
    trim_walk_rad2ps: float = math.radians(0.2) ** 2 / 60.0  # [est] heat, manoeuvres
    gain_walk_per_s: float = 0.02**2 / 600.0
    gain_parcel_std_frac: float = 0.03  # [est] error of the parcel's own drag
    prior_heading_std_rad: float = math.radians(2.5)  # compass calibration and declination
    heading_walk_rad2ps: float = math.radians(0.5) ** 2 / 300.0
    velocity_std_mps: float = 0.06  # u-blox M8 data sheet says 0.05, unfused
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
    pitot_scale_std_frac: float = 0.08  # [est] position error beside rotors
    pitot_bias_std_mps: float = 0.5  # [est] zero after calibration
    pitot_walk_per_s: float = 0.01**2 / 300.0  # of scale; same value for the bias, in (m/s)^2/s
    scalar_wind_std_mps: float = 2.5  # airspeed is used only once the wind's std is below this
    pitot_std_mps: float = 0.5
    pitot_memory_s: float = 0.5
    pitot_model_std_frac: float = 0.05  # [est] flow angle and rotor wash; not estimated
    pitot_least_mps: float = 4.0  # below this, a pitot on a multirotor reads its own offset
    vector_std_mps: float = 0.5  # [est] a small ultrasonic anemometer on a mast
    autopilot_std_mps: float = 1.0  # used if it reports none
    autopilot_least_std_mps: float = 0.3  # it leaves out errors of its drag coefficients and trims
    autopilot_every_s: float = 1.0
    autopilot_memory_s: float = 10.0  # it is filtered, so its errors are correlated
    gate_sigmas: float = 4.0
    doubt_after_s: float = 4.0
    stuck_after_s: float = 5.0
    watch_memory_s: float = 5.0
    faulty_sigmas: float = 3.0
    sound_sigmas: float = 2.0
    sound_after_s: float = 10.0
    floor_std_mps: float = 0.05  # [est] unmodelled errors
    weighs_calm: bool = True  # a second filter in light wind, for calm air
    learns_turbulence: bool = True  # and sees fronts
    settle_s: float = 5.0
    stale_after_s: float = 15.0


class WindState:
    """Mean `x` (18,) and covariance `cov` (18, 18): one hypothesis of the filter."""

    __slots__ = ("_params", "airspeed_mps", "cov", "front", "gust_length_m", "turbulence", "x")

    def __init__(self, airframe: Airframe, params: WindEstimatorParams) -> None:
        self._params = params
        self.x = np.zeros(STATES)
        self.x[At.CROSS_FLOW] = params.cross_flow
        self.cov = _prior_cov(airframe, params)
        self.airspeed_mps = 0.0
        self.gust_length_m = params.gust_length_m
        self.turbulence = Turbulence()
        self.front = Front()

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
    def weighs_calm(self) -> bool:
        """Whether calm air is a hypothesis at all."""
        return self._params.weighs_calm

    @property
    def wind_is_known(self) -> bool:
        """Whether the wind's std is small enough to linearise the drag about it once."""
        return self.wind_std_mps < self._params.known_wind_std_mps

    @property
    def wind_std_mps(self) -> float:
        """Standard deviation of the slow mean along one axis."""
        return math.sqrt(0.5 * float(self.cov[0, 0] + self.cov[1, 1]))

    @property
    def least_wind_speed_mps(self) -> float:
        """Speed of the slow mean less one standard deviation of an axis."""
        return math.hypot(self.x[0], self.x[1]) - self.wind_std_mps

    @property
    def scale(self) -> float:
        """Wind squared over reference wind squared. The wind has a floor, `least_wind_mps`."""
        p = self._params
        wind = max(math.hypot(self.x[0], self.x[1]), p.least_wind_mps)
        return (wind / p.reference_wind_mps) ** 2

    @property
    def gust_variance_m2ps2(self) -> float:
        """Stationary variance of the gust along each axis."""
        p = self._params
        return self.turbulence.ratio * p.gust_frac**2 * p.reference_wind_mps**2 * self.scale

    @property
    def fast_gust_m2ps(self) -> float:
        """Spectral density of gusts too fast for the filter, treated as white noise.

        Scaled by the turbulence ratio only if that ratio is given (`is_held`). A ratio learned from
        slow gusts says little about fast ones.
        """
        calm = self.turbulence.ratio if self.turbulence.is_held else 1.0
        return self._params.fast_gust_m2ps * self.scale * calm

    @property
    def mean_walk_m2ps3(self) -> float:
        """Process noise of the slow mean. Lower in calm air, but never below what recordings show;
        higher while a front passes.
        """
        p = self._params
        walk = max(p.mean_walk_m2ps3 * min(self.turbulence.ratio, 1.0), p.least_walk_m2ps3)
        return walk * self.scale + self.front.walk_m2ps3

    @property
    def gust_memory_s(self) -> float:
        """Correlation time of a gust: eddy length over airspeed."""
        p = self._params
        return self.gust_length_m / max(self.airspeed_mps, p.least_wind_mps)

    def corrected(
        self,
        step_ne_mps: tuple[float, float],
        expected_m2ps2: float,
        surprise: float,
        dt_s: float,
    ) -> None:
        """Learn the turbulence from one wind correction by tilt, see `Turbulence.corrected`.

        Skipped if the turbulence is given. No fronts are detected then either: in calm air, the
        residue of a turn was taken for a front.
        """
        if self.turbulence.is_held or not self._params.learns_turbulence:
            return
        self.turbulence.corrected(step_ne_mps, expected_m2ps2, surprise, dt_s)
        missed_m2ps2 = self.front.corrected(step_ne_mps, expected_m2ps2, dt_s)
        if missed_m2ps2 > 0.0:
            self.open_wind(missed_m2ps2)

    def wait(self, dt_s: float) -> None:
        """Prediction step over `dt_s`."""
        if dt_s <= 0.0:
            return
        p = self._params
        keep = math.exp(-dt_s / self.gust_memory_s)
        taken = 1.0 - math.exp(-dt_s / p.lag_s)
        variance = self.gust_variance_m2ps2
        left = 1.0 - taken
        move = _STILL.copy()
        move.reshape(-1)[_MOVED] = (keep, keep, left, left, taken, taken, taken, taken)
        self.x = move @ self.x
        cov = move @ self.cov @ move.T
        cov += cov.T  # restore symmetry
        cov *= 0.5
        self.cov = cov
        walk = self.mean_walk_m2ps3 * dt_s
        gust = variance * (1.0 - keep * keep)
        trim, gain = p.trim_walk_rad2ps * dt_s, p.gain_walk_per_s * dt_s
        pitot = p.pitot_walk_per_s * dt_s
        heading = p.heading_walk_rad2ps * dt_s
        new = p.velocity_std_mps**2
        cov.reshape(-1)[:: STATES + 1] += (
            *(walk, walk, gust, gust, 0.0, 0.0, trim, trim, gain, gain, heading, pitot, pitot),
            *(new, new, 0.0, 0.0, 0.0),
        )

    def correct_both(self, gain: Floats, white: Floats) -> None:
        """Kalman update by two scalars at once. `gain` (18, 2) is the covariance of state and
        innovations, whitened. `white` (2,) is the whitened innovations.
        """
        self.x += gain @ white
        self.cov -= gain @ gain.T  # a matrix times its transpose is exactly symmetric

    def correct(self, row: Floats, innovation: float, noise: float) -> None:
        """Kalman update by one scalar with variance `noise`; `row` (18,) is its derivative by
        the state.
        """
        gain = self.cov @ row
        s = float(row @ gain) + noise
        self.x += gain * (innovation / s)
        self.cov -= np.multiply.outer(gain, gain) / s  # exactly symmetric: products commute

    def ten_second_mean(self, waited_s: float) -> tuple[Floats, Floats]:
        """Mean (2,) and covariance (2, 2) of the 10 s mean wind, `waited_s` after the last update.

        The reported velocity is late by `latency_s`, so the predicted part is longer by that much.
        """
        p = self._params
        memory_s = self.gust_memory_s
        ahead_s = 0.5 * _WINDOW_S + p.latency_s
        share = ahead_s / _WINDOW_S
        gust = share * memory_s / ahead_s * (1.0 - math.exp(-ahead_s / memory_s))
        rows = np.zeros((2, STATES))
        for axis in (0, 1):
            rows[axis, At.MEAN + axis] = share
            rows[axis, At.LATELY + axis] = 1.0 - share
            rows[axis, At.GUST + axis] = gust
        variance = self.gust_variance_m2ps2
        unforeseen = share**2 * variance * _mean_variance(ahead_s / memory_s)
        lag = 0.25 * _LAG_MISFIT_S * 2.0 * variance / memory_s
        walked = self.mean_walk_m2ps3 * (waited_s + ahead_s / 12.0)
        blown = 2.0 * variance * (1.0 - math.exp(-waited_s / memory_s))
        spread = unforeseen + lag + walked + blown + p.floor_std_mps**2
        cov = rows @ self.cov @ rows.T
        return rows @ self.x, 0.5 * (cov + cov.T) + spread * _BOTH

    def open_wind(self, variance_m2ps2: float) -> None:
        """Add a variance on each axis to the slow mean and the lagged mean, fully correlated."""
        for at in (0, 1):
            for first in (At.MEAN, At.LATELY):
                for second in (At.MEAN, At.LATELY):
                    self.cov[first + at, second + at] += variance_m2ps2

    def open_trim(self, variance_rad2: float) -> None:
        """Add this variance to both trims."""
        self.cov[[At.TRIM, At.TRIM + 1], [At.TRIM, At.TRIM + 1]] += variance_rad2

    def open_gain(self, variance: float) -> None:
        """Add this variance to both drag gains, fully correlated: both axes changed together."""
        self.cov[At.LOG_GAIN : At.HEADING, At.LOG_GAIN : At.HEADING] += variance


_WINDOW_S = 10.0
_LAG_MISFIT_S = 0.075  # integral of (mean of 5 s less lag of 2.7 s)^2 over a random walk's past
_BOTH = np.eye(2)
_MEAN = [At.MEAN, At.MEAN + 1]
_GUST = [At.GUST, At.GUST + 1]
_LATELY = [At.LATELY, At.LATELY + 1]
_NOISE = [At.NOISE, At.NOISE + 1]
_NOISE_BEFORE = [At.NOISE_BEFORE, At.NOISE_BEFORE + 1]


def _still() -> Floats:
    """Transition over no time: identity, but the last velocity noise becomes the one before."""
    move = np.eye(STATES)
    move[_NOISE, _NOISE] = move[_NOISE_BEFORE, _NOISE_BEFORE] = 0.0
    move[_NOISE_BEFORE, _NOISE] = 1.0
    return move


_STILL = _still()
# Flat indices into the transition matrix that `wait` fills, as (row, column): gust on itself,
# lagged mean on itself, on the slow mean, on the gust.
_MOVED = np.array(
    [
        STATES * (row + axis) + column + axis
        for row, column in (
            (At.GUST, At.GUST),
            (At.LATELY, At.LATELY),
            (At.LATELY, At.MEAN),
            (At.LATELY, At.GUST),
        )
        for axis in (0, 1)
    ]
)


def gust_length_m(height_m: float) -> float:
    """Eddy length at a height above ground: L_u of MIL-F-8785C, 3.7.3.4. Valid from 10 to 1,000
    feet, clamped beyond. 35 m at 3 m, 150 m at 30 m.
    """
    feet = min(max(height_m / 0.3048, 10.0), 1000.0)
    return 0.3048 * feet / (0.177 + 0.000823 * feet) ** 1.2


def _mean_variance(spans: float) -> float:
    """Variance of the mean over `spans` correlation times of an Ornstein-Uhlenbeck process of
    variance 1 that starts at a known value: the double integral of exp(-|s - u|) - exp(-(s + u)).
    """
    a, once, twice = spans, math.exp(-spans), math.exp(-2.0 * spans)
    return 2.0 / a**2 * (a - (1.0 - once) - (1.0 - once) + 0.5 * (1.0 - twice))


def _prior_cov(airframe: Airframe, p: WindEstimatorParams) -> Floats:
    drag = airframe.drag
    wind = p.prior_wind_std_mps**2
    gust = (p.gust_frac * p.least_wind_mps) ** 2
    trim = math.radians(drag.trim_std_deg) ** 2
    common, own = drag.gain_std_frac**2, drag.axis_gain_std_frac**2
    diagonal = [wind, wind, gust, gust, wind, wind, trim, trim, common + own, common + own]
    diagonal += [p.prior_heading_std_rad**2, p.pitot_scale_std_frac**2, p.pitot_bias_std_mps**2]
    diagonal += [p.velocity_std_mps**2] * 4 + [p.cross_flow_std**2]
    cov = np.diag(diagonal)
    cov[At.LOG_GAIN, At.LOG_GAIN + 1] = cov[At.LOG_GAIN + 1, At.LOG_GAIN] = common
    cov[_MEAN, _LATELY] = cov[_LATELY, _MEAN] = wind
    return cov
