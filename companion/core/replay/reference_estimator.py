"""The reference wind estimator: a textbook extended Kalman filter, to compare ours with.

The filter is filterpy's. Its state is the horizontal wind alone, and the wind is a random walk. It
takes the observations that our estimator takes:

- tilt and acceleration tell the drag: `a_h - thrust_h = -D(v - w) / m`, with the airframe's drag
  coefficients taken as exact;
- an airspeed (scalar along the nose, magnitude, or both axes) is taken as unbiased;
- an autopilot's wind estimate enters as it is.

What it has not: states for trim, drag gain, heading error and the pitot's scale and bias, a model
of gusts, outlier rejection, a judgement of a faulty pitot. So its covariance knows of noise only.
What a comparison shows is what these add (`companion replay --estimator reference`). It never
flies: nothing that flies imports filterpy.
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
LONGEST_STEP_S = 1.0  # a longer gap hides what the vehicle did
SHORTEST_STEP_S = 0.02
GREATEST_TILT_RAD = 1.2


@dataclass(frozen=True, slots=True)
class ReferenceParams:
    """Noises of the reference estimator. What errs for `memory` seconds on end enters as the white
    noise of the same spectral density at frequency 0, `2 memory variance`."""

    prior_wind_std_mps: float = 10.0  # each axis, before anything is seen
    # Half the variance of what a coastal wind of 8.4 m/s changes in 30 s is 0.023 of its square
    # (each axis): a random walk of 2 x 0.023 x 8.4^2 / 30 s.
    walk_m2ps3: float = 0.11
    velocity_std_mps: float = 0.06  # u-blox M8 data sheet: 0.05, unfused
    tilt_noise_m2ps3: float = 0.05**2 * 0.1  # attitude noise, 0.3 deg at 10 Hz
    model_memory_s: float = 5.0  # how long a sensor's model errs the same way
    airspeed_std_mps: float = 0.5
    airspeed_memory_s: float = 0.5
    airspeed_model_std_frac: float = 0.05  # flow angle and wash, `model_memory_s` long
    autopilot_std_mps: float = 1.0  # where it states none
    autopilot_least_std_mps: float = 0.3  # it knows neither its coefficients' nor its trims' error
    autopilot_memory_s: float = 10.0  # it is filtered: its errors last
    settle_s: float = 5.0
    stale_after_s: float = 15.0


class ReferenceEstimator:
    """Holds the filter; one per vehicle. The interface is `WindEstimator`'s."""

    def __init__(self, airframe: Airframe, params: ReferenceParams | None = None) -> None:
        self._airframe = airframe
        self._params = params or ReferenceParams()
        self._filter = ExtendedKalmanFilter(dim_x=2, dim_z=2)
        self._filter.x = np.zeros(2)
        self._filter.P = self._params.prior_wind_std_mps**2 * np.eye(2)
        self._t_s: float | None = None
        self._velocity_before: tuple[float, float, float] | None = None  # t_s, north, east
        self._entered_s: dict[str, float] = {}
        self._seen_s = 0.0

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Take one observation; nothing is ever left out, so there are no words for it.

        Late or repeated times are ignored. Raises ValueError on NaN or infinity.
        """
        observation.refuse_nan()
        before_s = self._t_s
        if before_s is not None and observation.t_s <= before_s:
            return ()
        dt_s = 0.0 if before_s is None else observation.t_s - before_s
        self._t_s = observation.t_s
        self._filter.Q = self._params.walk_m2ps3 * dt_s * np.eye(2)
        self._filter.predict()
        if observation.airborne:
            self._take_tilt(observation)
            self._take_airspeed(observation, dt_s)
        else:
            self._velocity_before = None
        self._take_autopilot(observation, dt_s)
        return ()

    def belief(self, t_s: float) -> WindBelief:
        """The wind at `t_s` >= the last update; waiting only makes it less certain."""
        p = self._params
        waited_s = 0.0 if self._t_s is None else max(t_s - self._t_s, 0.0)
        cov = self._filter.P + p.walk_m2ps3 * waited_s * np.eye(2)
        fresh = tuple(sorted(n for n, at in self._entered_s.items() if t_s - at <= p.stale_after_s))
        settled = self._seen_s >= p.settle_s or "autopilot" in fresh
        return WindBelief(t_s, self._filter.x.copy(), cov, fresh, settled and bool(fresh))

    def snapshot(self) -> dict[str, object]:
        """What a checkpoint keeps."""
        wind, cov = self._filter.x.tolist(), self._filter.P.tolist()
        return {"format": SNAPSHOT_FORMAT, "t_s": self._t_s, "x": wind, "cov": cov}

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint; raises LeewayError when it is not one."""
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

    # -- what enters -----------------------------------------------------------------------------

    def _take_tilt(self, seen: WindObservation) -> None:
        moved = self._acceleration(seen)
        if moved is None or seen.vel_ned_mps is None or seen.yaw_rad is None:
            return
        accel_ne_mps2, dt_s = moved
        turn = _from_heading(seen.yaw_rad)
        measured = turn.T @ (accel_ne_mps2 - _thrust_ne_mps2(seen))
        air_fr = turn.T @ (np.array(seen.vel_ned_mps[:2]) - self._filter.x)
        drag, slope = _drag(self._airframe, seen, air_fr, seen.vel_ned_mps[2])
        p = self._params
        off = self._airframe.drag.model_std_frac * math.hypot(*drag)
        density = p.tilt_noise_m2ps3 + 2.0 * p.model_memory_s * off**2
        variance = density / dt_s + 2.0 * (p.velocity_std_mps / dt_s) ** 2
        # The air's velocity falls as the wind rises: d(-drag)/d(wind) is the slope itself.
        self._correct("tilt", seen.t_s, _Reading(measured, -drag, slope @ turn.T, variance))
        self._seen_s += dt_s

    def _acceleration(self, seen: WindObservation) -> tuple[Floats, float] | None:
        """Acceleration (north, east) since the velocity before, and the time between them."""
        before, self._velocity_before = self._velocity_before, None
        if seen.vel_ned_mps is None or seen.roll_rad is None or seen.pitch_rad is None:
            return None
        north, east, _ = seen.vel_ned_mps
        self._velocity_before = (seen.t_s, north, east)
        tilted = max(abs(seen.roll_rad), abs(seen.pitch_rad)) > GREATEST_TILT_RAD
        if before is None or tilted or seen.t_s - before[0] > LONGEST_STEP_S:
            return None
        dt_s = max(seen.t_s - before[0], SHORTEST_STEP_S)
        return np.array([north - before[1], east - before[2]]) / dt_s, dt_s

    def _take_airspeed(self, seen: WindObservation, dt_s: float) -> None:
        if seen.vel_ned_mps is None or seen.yaw_rad is None or dt_s <= 0.0:
            return
        p = self._params
        air_ne = np.array(seen.vel_ned_mps[:2]) - self._filter.x
        off = p.airspeed_model_std_frac * math.hypot(*air_ne)
        density = p.airspeed_memory_s * p.airspeed_std_mps**2 + p.model_memory_s * off**2
        variance = 2.0 * density / max(dt_s, SHORTEST_STEP_S)
        if seen.airspeed_fr_mps is not None:
            turn = _from_heading(seen.yaw_rad)
            measured = np.array(seen.airspeed_fr_mps)
            self._correct("pitot", seen.t_s, _Reading(measured, turn.T @ air_ne, -turn.T, variance))
        elif seen.airspeed_mps is not None:
            if seen.airspeed_is_magnitude:
                along = air_ne / max(math.hypot(*air_ne), 1e-6)
            else:
                level = math.cos(seen.pitch_rad or 0.0)
                along = level * _from_heading(seen.yaw_rad)[:, 0]
            measured, expected = np.array([seen.airspeed_mps]), np.array([along @ air_ne])
            self._correct("pitot", seen.t_s, _Reading(measured, expected, -along[None], variance))

    def _take_autopilot(self, seen: WindObservation, dt_s: float) -> None:
        if seen.autopilot_wind_to_ne_mps is None or dt_s <= 0.0:
            return
        p = self._params
        said_m2ps2 = p.autopilot_std_mps**2
        if seen.autopilot_wind_cov_m2ps2 is not None:
            nn, _, ee = seen.autopilot_wind_cov_m2ps2
            said_m2ps2 = 0.5 * (nn + ee) + p.autopilot_least_std_mps**2
        variance = 2.0 * p.autopilot_memory_s * said_m2ps2 / max(dt_s, SHORTEST_STEP_S)
        measured = np.array(seen.autopilot_wind_to_ne_mps)
        reading = _Reading(measured, self._filter.x, np.eye(2), variance)
        self._correct("autopilot", seen.t_s, reading)

    def _correct(self, source: str, t_s: float, reading: "_Reading") -> None:
        """The extended filter's correction, linearised about the wind as believed."""
        noise = reading.variance * np.eye(len(reading.measured))
        self._filter.update(
            reading.measured, lambda _: reading.slope, lambda _: reading.expected, noise
        )
        self._entered_s[source] = t_s


@dataclass(frozen=True, slots=True)
class _Reading:
    """A measurement (m,), what the wind as believed makes of it, its derivative by the wind (m, 2)
    and the variance of each of its rows."""

    measured: Floats
    expected: Floats
    slope: Floats
    variance: float


def _from_heading(yaw_rad: float) -> Floats:
    """Turns (forward, right) into (north, east)."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[cos, -sin], [sin, cos]])


def _thrust_ne_mps2(seen: WindObservation) -> Floats:
    """Horizontal thrust acceleration: along minus the body's z axis, with gravity held up."""
    roll, pitch = seen.roll_rad or 0.0, seen.pitch_rad or 0.0
    forward = -GRAVITY_MPS2 * math.tan(pitch)
    right = GRAVITY_MPS2 * math.tan(roll) / math.cos(pitch)
    return _from_heading(seen.yaw_rad or 0.0) @ np.array([forward, right])


def _drag(
    airframe: Airframe, seen: WindObservation, air_fr_mps: Floats, sink_mps: float
) -> tuple[Floats, Floats]:
    """Drag acceleration forward and right (m/s2), and its derivative by the air velocity (2, 2)."""
    speed = max(math.hypot(*air_fr_mps, sink_mps), 1e-3)
    mass_kg, density = seen.mass_kg, seen.density_kgpm3
    linear = np.array(airframe.drag_linear_n_per_mps(mass_kg, density)) / mass_kg
    quadratic = np.array(airframe.drag_quadratic_n_per_mps2(mass_kg, density)) / mass_kg
    drag = (linear + quadratic * speed) * air_fr_mps
    slope = np.diag(linear + quadratic * speed)
    slope += np.outer(quadratic * air_fr_mps, air_fr_mps) / speed
    return drag, slope
