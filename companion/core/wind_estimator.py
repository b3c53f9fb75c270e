"""Row 5: a Kalman filter for the horizontal wind where the vehicle is.

State, 5: wind to north and east (m/s), tilt trim along body forward and right (rad), logarithm of
the drag gain.

- The tilt and the acceleration tell the drag: in steady air `m (a_h - thrust_h) = -s D(v - w)`,
  with the thrust along the body's axis and its size from the vertical balance. No accelerometer,
  no throttle: only attitude and ground velocity, which every autopilot sends.
- The trims are along BODY axes: what causes them (a level that is off, a centre of gravity beside
  the thrust's) turns with the airframe. So flying on another heading, or faster, tells trim from
  wind; on one heading for ever they stay apart only by their priors, and the covariance says so.
- The drag gain s (about 1, never negative) is what the airframe file gets wrong of the drag as a
  whole. Its prior is tight (`gain_std_frac`): with a loose one such a filter diverges
  (shared/data/README.md).
- A plain numpy filter: filterpy is the oracle in the tests only, as it would put matplotlib on
  the vehicle's disk.

What is estimated is the mean over about 10 s, not each gust: gusts enter as measurement noise with
their own memory, and `belief()` adds a floor for what the drag model does not know.
"""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.core.airframe import Airframe
from companion.core.errors import LeewayError
from companion.core.power import GRAVITY_MPS2

FloatArray = NDArray[np.float64]

SNAPSHOT_FORMAT = "wind-estimator/1"


@dataclass(frozen=True, slots=True)
class WindObservation:
    """What telemetry says at one instant; None is unknown and never enters the filter.

    `airspeed_mps` only from a real pitot on the forward axis (or `airspeed_is_magnitude`), and
    `autopilot_wind_to_ne_mps` only when the flavour's adapter knows it to be a real estimate.
    """

    t_s: float
    airborne: bool
    mass_kg: float
    vel_ned_mps: tuple[float, float, float] | None = None
    roll_rad: float | None = None
    pitch_rad: float | None = None
    yaw_rad: float | None = None
    airspeed_mps: float | None = None
    airspeed_is_magnitude: bool = False
    autopilot_wind_to_ne_mps: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class WindBelief:
    """Mean and covariance of the horizontal wind (10 s mean at the vehicle), where it moves to.

    `sources` names what entered lately, of "tilt", "pitot", "autopilot". `valid` is False until
    enough has entered, and again when nothing entered for long.
    """

    t_s: float
    mean_to_ne_mps: FloatArray
    cov_ne_m2ps2: FloatArray
    sources: tuple[str, ...]
    valid: bool


@dataclass(frozen=True, slots=True)
class WindEstimatorParams:
    """Noises and limits, with where they come from.

    [coast] from shared/data/wind/coast_2023_1hz.csv at its mean wind of 8.6 m/s: the 10 s mean
    walks by 0.08 to 0.16 m^2/s^3, and the best exponential average follows it with a memory of
    3 s, which is the root of gust memory over walk; turbulence grows with the wind, so both do.
    """

    prior_wind_std_mps: float = 6.0
    prior_trim_std_rad: float = math.radians(1.0)  # a levelled autopilot; 2 deg were seen
    trim_walk_rad2ps: float = math.radians(0.1) ** 2 / 60.0
    gain_walk_per_s: float = 0.02**2 / 600.0
    wind_walk_m2ps3: float = 0.12  # [coast]
    gust_memory_m2ps: float = 1.1  # [coast] gust variance times twice its memory
    reference_wind_mps: float = 8.6  # [coast]
    least_scale: float = 0.35
    smoothing_s: float = 0.3
    tilt_noise_m2ps3: float = 0.1**2 * 0.2  # attitude and velocity noise, as spectral density
    delay_std_s: float = 0.15  # between attitude and velocity as reported
    known_wind_std_mps: float = 1.5
    pitot_std_mps: float = 0.5
    pitot_least_mps: float = 4.0  # below, a pitot on a multirotor reads its own offset
    autopilot_std_mps: float = 1.0
    autopilot_every_s: float = 1.0
    gate_sigmas: float = 4.0
    stuck_after_s: float = 5.0
    doubt_after_s: float = 4.0
    floor_std_mps: float = 0.3
    settle_s: float = 5.0
    stale_after_s: float = 15.0


class WindEstimator:
    """Holds the filter's state; one per vehicle."""

    def __init__(self, airframe: Airframe, params: WindEstimatorParams | None = None) -> None:
        self._airframe = airframe
        self._params = params or WindEstimatorParams()
        p = self._params
        self._x = np.zeros(5)
        variances = (
            p.prior_wind_std_mps**2,
            p.prior_wind_std_mps**2,
            p.prior_trim_std_rad**2,
            p.prior_trim_std_rad**2,
            airframe.drag.gain_std_frac**2,
        )
        self._cov = np.diag(variances)
        self._t_s: float | None = None
        self._entered_s: dict[str, float] = {}
        self._tilt_s = 0.0
        self._smooth: _Smoothed | None = None
        self._pitot = _PitotWatch()
        self._rejected_since_s: float | None = None

    @property
    def trim_rad(self) -> tuple[float, float]:
        """Tilt trim believed, along body forward and right."""
        return float(self._x[2]), float(self._x[3])

    @property
    def drag_gain(self) -> float:
        """Drag as flown over drag as in the airframe file."""
        return math.exp(float(self._x[4]))

    @property
    def drag_gain_std(self) -> float:
        """Relative standard deviation of the drag gain."""
        return math.sqrt(float(self._cov[4, 4]))

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Take one observation (10 Hz or so); returns what was left out and why, in words.

        Late or repeated times are ignored. Raises ValueError on NaN or infinity.
        """
        _refuse_nan(observation)
        before_s = self._t_s
        if before_s is not None and observation.t_s <= before_s:
            return ()
        dt_s = 0.0 if before_s is None else observation.t_s - before_s
        self._t_s = observation.t_s
        self._cov[(0, 1, 2, 3, 4), (0, 1, 2, 3, 4)] += self._growth(dt_s)
        left_out: list[str] = []
        if observation.airborne:
            left_out += self._take_tilt(observation, dt_s)
            left_out += self._take_pitot(observation, dt_s)
        else:
            self._smooth = None
        left_out += self._take_autopilot(observation)
        return tuple(left_out)

    def belief(self, t_s: float) -> WindBelief:
        """The wind at `t_s` >= the last update; waiting only makes it less certain."""
        p = self._params
        waited_s = 0.0 if self._t_s is None else max(t_s - self._t_s, 0.0)
        cov = self._cov[:2, :2] + (self._growth(waited_s)[0] + p.floor_std_mps**2) * np.eye(2)
        fresh = [n for n, at in self._entered_s.items() if t_s - at <= p.stale_after_s]
        settled = self._tilt_s >= p.settle_s or "autopilot" in fresh
        return WindBelief(
            t_s, self._x[:2].copy(), cov, tuple(sorted(fresh)), settled and bool(fresh)
        )

    def snapshot(self) -> dict[str, object]:
        """What a checkpoint keeps: trims and gain are worth more than the wind of then."""
        return {
            "format": SNAPSHOT_FORMAT,
            "t_s": self._t_s,
            "x": self._x.tolist(),
            "cov": self._cov.tolist(),
        }

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint; raises LeewayError when it is not one."""
        if snapshot.get("format") != SNAPSHOT_FORMAT:
            raise LeewayError(f"checkpoint: expected a {SNAPSHOT_FORMAT} snapshot")
        try:
            t_s = msgspec.convert(snapshot["t_s"], float | None)
            x = np.array(msgspec.convert(snapshot["x"], list[float]))
            cov = np.array(msgspec.convert(snapshot["cov"], list[list[float]]))
        except (KeyError, ValueError, msgspec.ValidationError) as error:
            raise LeewayError(f"checkpoint: {error}") from error
        usable = x.shape == (5,) and cov.shape == (5, 5) and np.isfinite([*x, *cov.ravel()]).all()
        if not usable or float(np.linalg.eigvalsh(cov)[0]) < 0.0:
            raise LeewayError("checkpoint: expected 5 finite states and their covariance")
        self._t_s, self._x, self._cov = t_s, x, 0.5 * (cov + cov.T)

    # -- the filter ----------------------------------------------------------------------------

    def _scale(self) -> float:
        """Turbulence here over turbulence at the reference wind, in variance."""
        p = self._params
        return max(math.hypot(self._x[0], self._x[1]) / p.reference_wind_mps, p.least_scale) ** 2

    def _growth(self, dt_s: float) -> tuple[float, float, float, float, float]:
        p = self._params
        wind = p.wind_walk_m2ps3 * self._scale() * dt_s
        trim = p.trim_walk_rad2ps * dt_s
        return wind, wind, trim, trim, p.gain_walk_per_s * dt_s

    def _take_tilt(self, seen: WindObservation, dt_s: float) -> list[str]:
        if seen.vel_ned_mps is None or seen.roll_rad is None or seen.pitch_rad is None:
            self._smooth = None
            return []
        if seen.yaw_rad is None or max(abs(seen.roll_rad), abs(seen.pitch_rad)) > 1.2:
            return []
        smooth = _smoothed(self._smooth, seen, dt_s, self._params.smoothing_s)
        self._smooth = smooth
        if smooth.age_s < 3.0 * self._params.smoothing_s:
            return []
        measured = smooth.drag_forward_right(seen.yaw_rad)
        prior, prior_cov = self._x.copy(), self._cov
        innovation, noise, rows = [0.0, 0.0], [0.0, 0.0], (prior, prior)
        for _ in range(self._linearisations()):
            drag = _drag_model(self._airframe, seen.mass_kg, self._x, smooth, seen.yaw_rad)
            rows = drag.jacobian
            ahead = [float(row @ (prior - self._x)) for row in rows]
            innovation = [measured[i] - drag.expected[i] - ahead[i] for i in (0, 1)]
            noise = [self._tilt_noise(row, smooth, dt_s) for row in rows]
            if self._is_outlier(prior_cov, rows, innovation, noise):
                self._x = prior
                return self._doubt_tilt(seen.t_s)
            self._x, self._cov = prior.copy(), prior_cov.copy()
            for i in (0, 1):
                moved = float(rows[i] @ (self._x - prior))
                self._correct(rows[i], innovation[i] - moved, noise[i])
        self._rejected_since_s = None
        self._entered_s["tilt"] = seen.t_s
        self._tilt_s += dt_s
        return []

    def _linearisations(self) -> int:
        """An extended filter's one, or more (Bell and Cathey 1993) while the wind is unknown.

        Drag is quadratic: its slope in still air would throw the first estimate far out.
        """
        variance = float(self._cov[0, 0] + self._cov[1, 1])
        return 1 if variance < 2.0 * self._params.known_wind_std_mps**2 else 6

    def _tilt_noise(self, row: FloatArray, smooth: "_Smoothed", dt_s: float) -> float:
        """Variance of one drag measurement: sensors, gusts, and what a transient's delays do."""
        p = self._params
        gust = p.gust_memory_m2ps * self._scale() * float(row[0] ** 2 + row[1] ** 2)
        transient = (p.delay_std_s / p.smoothing_s * smooth.transient_mps2) ** 2 * p.smoothing_s
        return (p.tilt_noise_m2ps3 + gust + transient) / max(dt_s, 0.02)

    def _doubt_tilt(self, t_s: float) -> list[str]:
        """Leave an outlier out; when they go on, it is the estimate that is wrong: open it."""
        if self._rejected_since_s is None:
            self._rejected_since_s = t_s
        if t_s - self._rejected_since_s > self._params.doubt_after_s:
            self._cov[0, 0] += 4.0
            self._cov[1, 1] += 4.0
            self._rejected_since_s = None
            return ["tilt disagrees with the wind estimate for long: estimate reopened"]
        return ["tilt disagrees with the wind estimate: left out"]

    def _take_pitot(self, seen: WindObservation, dt_s: float) -> list[str]:
        if seen.airspeed_mps is None or seen.vel_ned_mps is None or seen.yaw_rad is None:
            return []
        if self._linearisations() > 1:  # a scalar cannot start a vector
            return []
        p = self._params
        if self._pitot.is_stuck(seen.t_s, seen.airspeed_mps, p.stuck_after_s):
            return ["pitot reads the same for long: left out"]
        air_n = seen.vel_ned_mps[0] - self._x[0]
        air_e = seen.vel_ned_mps[1] - self._x[1]
        row = np.zeros(5)
        if seen.airspeed_is_magnitude:
            expected = max(math.hypot(air_n, air_e), 1e-6)
            row[0], row[1] = -air_n / expected, -air_e / expected
        else:
            tilt = math.cos(seen.pitch_rad) if seen.pitch_rad is not None else 1.0
            north, east = tilt * math.cos(seen.yaw_rad), tilt * math.sin(seen.yaw_rad)
            expected = air_n * north + air_e * east
            row[0], row[1] = -north, -east
        if expected < p.pitot_least_mps and seen.airspeed_mps < p.pitot_least_mps:
            return []
        gust = p.gust_memory_m2ps * self._scale()
        # Its own error is as slow as a gust: a scale or a mounting that is off does not average.
        r = (p.pitot_std_mps**2 + gust) / max(dt_s, 0.02)
        if self._is_outlier(self._cov, (row,), [seen.airspeed_mps - expected], [r]):
            return [f"pitot reads {seen.airspeed_mps:.1f} m/s, {expected:.1f} expected: left out"]
        self._correct(row, seen.airspeed_mps - expected, r)
        self._entered_s["pitot"] = seen.t_s
        return []

    def _take_autopilot(self, seen: WindObservation) -> list[str]:
        wind, p = seen.autopilot_wind_to_ne_mps, self._params
        last_s = self._entered_s.get("autopilot", -math.inf)
        if wind is None or seen.t_s - last_s < p.autopilot_every_s:
            return []
        # It is filtered over seconds and drinks from the same tilt: heavy, and only now and then.
        r = p.autopilot_std_mps**2 * (10.0 / p.autopilot_every_s)
        rows = (np.array([1.0, 0, 0, 0, 0]), np.array([0, 1.0, 0, 0, 0]))
        innovations = [wind[0] - float(self._x[0]), wind[1] - float(self._x[1])]
        if self._is_outlier(self._cov, rows, innovations, [r, r]):
            return ["the autopilot's wind disagrees with the wind estimate: left out"]
        for axis, row in enumerate(rows):
            self._correct(row, wind[axis] - float(self._x[axis]), r)
        self._entered_s["autopilot"] = seen.t_s
        return []

    def _is_outlier(
        self,
        cov: FloatArray,
        rows: tuple[FloatArray, ...],
        innovations: list[float],
        noise: list[float],
    ) -> bool:
        limit = self._params.gate_sigmas**2
        return any(
            e * e > limit * (float(row @ cov @ row) + r)
            for row, e, r in zip(rows, innovations, noise, strict=True)
        )

    def _correct(self, row: FloatArray, innovation: float, r: float) -> None:
        gain_row = self._cov @ row
        s = float(row @ gain_row) + r
        self._x += gain_row * (innovation / s)
        self._cov -= gain_row[:, None] * (gain_row / s)
        self._cov += self._cov.T
        self._cov *= 0.5


@dataclass(frozen=True, slots=True)
class _Smoothed:
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

    def drag_forward_right(self, yaw_rad: float) -> tuple[float, float]:
        """Acceleration by drag along the heading and to its right, m/s^2."""
        north, east = self.accel_n - self.thrust_n, self.accel_e - self.thrust_e
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        return cos * north + sin * east, -sin * north + cos * east


def _smoothed(
    before: _Smoothed | None, seen: WindObservation, dt_s: float, memory_s: float
) -> _Smoothed:
    """The low-pass filters one step on; what a filtered velocity gains IS the acceleration."""
    north, east, down = seen.vel_ned_mps or (0.0, 0.0, 0.0)
    lift = GRAVITY_MPS2 - (before.accel_d if before else 0.0)
    thrust_n, thrust_e = _thrust_ne(seen, lift)
    if before is None or not 0.0 < dt_s < 1.0:
        return _Smoothed(0.0, north, east, down, thrust_n, thrust_e, 0.0, 0.0, 0.0, 0.0)
    share = 1.0 - math.exp(-dt_s / memory_s)
    step_n = share * (north - before.velocity_n)
    step_e = share * (east - before.velocity_e)
    step_d = share * (down - before.velocity_d)
    return _Smoothed(
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
class _DragModel:
    """Expected drag acceleration along heading and right, and its rows d/dx."""

    expected: tuple[float, float]
    jacobian: tuple[FloatArray, FloatArray]


def _drag_model(
    airframe: Airframe, mass_kg: float, x: FloatArray, smooth: _Smoothed, yaw_rad: float
) -> _DragModel:
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    wind_n, wind_e, trim_f, trim_r, log_gain = x.tolist()
    gain = math.exp(min(max(log_gain, -3.0), 3.0))
    air_n, air_e = smooth.velocity_n - wind_n, smooth.velocity_e - wind_e
    forward, right = cos * air_n + sin * air_e, -sin * air_n + cos * air_e
    speed = max(math.hypot(forward, right), 1e-3)
    k_f, k_r = airframe.drag_linear_n_per_mps(mass_kg)
    q_f = airframe.drag.quadratic_forward_n_per_mps2
    q_r = airframe.drag.quadratic_right_n_per_mps2
    drag_f = (k_f + q_f * speed) * forward / mass_kg
    drag_r = (k_r + q_r * speed) * right / mass_kg
    # d drag / d (forward, right); the wind enters with the opposite sign.
    ff = (k_f + q_f * (speed + forward * forward / speed)) / mass_kg * gain
    fr = q_f * forward * right / speed / mass_kg * gain
    rr = (k_r + q_r * (speed + right * right / speed)) / mass_kg * gain
    rf = q_r * forward * right / speed / mass_kg * gain
    row_f = np.array([ff * cos - fr * sin, ff * sin + fr * cos, GRAVITY_MPS2, 0.0, -gain * drag_f])
    row_r = np.array([rf * cos - rr * sin, rf * sin + rr * cos, 0.0, GRAVITY_MPS2, -gain * drag_r])
    expected = (
        -gain * drag_f + GRAVITY_MPS2 * trim_f,
        -gain * drag_r + GRAVITY_MPS2 * trim_r,
    )
    return _DragModel(expected, (row_f, row_r))


class _PitotWatch:
    """Notices a pitot that repeats itself: a live one never does for seconds."""

    def __init__(self) -> None:
        self._value_mps: float | None = None
        self._since_s = 0.0

    def is_stuck(self, t_s: float, value_mps: float, after_s: float) -> bool:
        if self._value_mps is None or abs(value_mps - self._value_mps) > 1e-3:
            self._value_mps, self._since_s = value_mps, t_s
        return t_s - self._since_s > after_s


def _refuse_nan(seen: WindObservation) -> None:
    numbers = [seen.t_s, seen.mass_kg, *(seen.vel_ned_mps or ())]
    numbers += [*(seen.autopilot_wind_to_ne_mps or ())]
    optional = (seen.roll_rad, seen.pitch_rad, seen.yaw_rad, seen.airspeed_mps)
    numbers += [v for v in optional if v is not None]
    if not all(map(math.isfinite, numbers)) or seen.mass_kg <= 0.0:
        raise ValueError(f"wind observation with a number that is none: {seen}")
