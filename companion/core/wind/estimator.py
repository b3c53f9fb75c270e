"""The horizontal wind at the vehicle, with its covariance, from every measurement there is.

- Tilt and acceleration measure drag (`drag_update`). An airspeed sensor measures the speed of the
  air, or its vector (`airspeed_update`). An autopilot may send its own estimate with a covariance.
  Any of them may be missing, appear and disappear.
- Trims are states along BODY axes: their causes (a level that is off, a centre of gravity beside
  the thrust) turn with the airframe. Another heading or speed tells trim from wind; on one heading
  only their priors do (`ekf`).
- A heading error turns the air velocity: 3 degrees at 14 m/s are 0.7 m/s of cross-wind. The way
  back on the opposite heading shows it.
- In light wind two filters, one for calm and one for turbulent air, are weighed against each other
  (`multiple_model`); in wind there is the second alone.
- A step of the reported heading suspends all that depends on it, until the heading is known again
  (`heading_watch`). The wind before the step is kept and ages; no wind is valid meanwhile.
- While an airspeed is used, both filters run once more without it. The airspeed is checked against
  these, and when it proves false they take over at once.
- A released parcel changes the drag by more than its mass tells, so the gains are opened again.
- The filter is plain numpy. filterpy is the oracle in the tests and the reference in replay
  (`companion.core.replay.reference_estimator`); it never flies.
"""

import math
from dataclasses import replace

import msgspec
import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.airspeed_update import (
    AirspeedSeen,
    PitotWatch,
    pitot_seen,
    vector_seen,
)
from companion.core.wind.drag_update import MotionWatch, TiltTold, has_tilt, tilt_told
from companion.core.wind.ekf import STATES, At, WindEstimatorParams, WindState, gust_length_m
from companion.core.wind.heading_watch import HeadingWatch
from companion.core.wind.multiple_model import Airs
from companion.core.wind.observation import WindBelief, WindObservation

__all__ = ["WindBelief", "WindEstimator", "WindEstimatorParams", "WindObservation"]

SNAPSHOT_FORMAT = "wind-estimator/5"


KNOWN_DRAG_STD_FRAC = 0.1
REOPENED_WIND_MPS, REOPENED_TRIM_RAD = 0.5, math.radians(0.3)  # after a step of the heading
FRONT_WALK_M2PS3 = 0.05  # ten times the recordings': fronts are what a way home is lost to


def params_for(airframe: Airframe) -> WindEstimatorParams:
    """The filter's noises for an airframe: where drag is known, the wind may walk faster.

    Where it is not, a fast walk cannot be told from drag that is off: on the real flight with the
    generic airframe the error is 1.20 m/s with the slow walk of the recordings, 1.44 with the
    fast one. With drag known, a front of 7 m/s in 90 s (params/flights/default.toml) is followed
    to 1.3 m/s and NEES 3 with the fast walk, 2.1 and 11 with the slow one.
    """
    if airframe.drag.gain_std_frac <= KNOWN_DRAG_STD_FRAC:
        return WindEstimatorParams(mean_walk_m2ps3=FRONT_WALK_M2PS3)
    return WindEstimatorParams()


class WindEstimator:
    """Holds the filter's state; one per vehicle."""

    def __init__(self, airframe: Airframe, params: WindEstimatorParams | None = None) -> None:
        self._airframe = airframe
        drag = airframe.drag
        self._mean_trim_rad = math.radians(drag.trim_forward_deg), math.radians(drag.trim_right_deg)
        self._params = params or params_for(airframe)
        self._alone = Airs.unseen(airframe, self._params)  # without any airspeed
        self._with_airspeed: Airs | None = None
        self._t_s: float | None = None
        self._entered_s: dict[str, float] = {}
        self._tilt_s = 0.0
        self._motion = MotionWatch()
        self._heading = HeadingWatch()
        self._pitot = PitotWatch()
        self._rejected_since_s: float | None = None
        self._mass_kg: float | None = None

    @property
    def _believed_airs(self) -> Airs:
        return self._with_airspeed or self._alone

    @property
    def _believed(self) -> WindState:
        return self._believed_airs.likelier

    @property
    def trim_rad(self) -> tuple[float, float]:
        """Tilt trim believed beside the airframe's mean trim, along body forward and right."""
        x = self._believed.x
        return float(x[At.TRIM]), float(x[At.TRIM + 1])

    @property
    def drag_gains(self) -> tuple[float, float]:
        """Drag as flown over drag as in the airframe file, forward and right."""
        x = self._believed.x
        return math.exp(float(x[At.LOG_GAIN])), math.exp(float(x[At.LOG_GAIN + 1]))

    @property
    def drag_gain_stds(self) -> tuple[float, float]:
        """Relative standard deviations of the drag gains."""
        variance = np.diag(self._believed.cov)
        return math.sqrt(variance[At.LOG_GAIN]), math.sqrt(variance[At.LOG_GAIN + 1])

    @property
    def heading_error_rad(self) -> float:
        """True heading less the heading reported, as believed."""
        return float(self._believed.x[At.HEADING])

    @property
    def airspeed_scale(self) -> float:
        """Airspeed as it reads over airspeed as it is."""
        return math.exp(float(self._believed.x[At.LOG_SCALE]))

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Take one observation (10 Hz or so); returns what was left out and why, in words.

        Late or repeated times are ignored. Raises ValueError on NaN or infinity.
        """
        observation.refuse_nan()
        if any(self._mean_trim_rad):
            observation = observation.levelled(*self._mean_trim_rad)
        before_s = self._t_s
        if before_s is not None and observation.t_s <= before_s:
            return ()
        dt_s = 0.0 if before_s is None else observation.t_s - before_s
        self._t_s = observation.t_s
        for state in self._states():
            if observation.height_m is not None:
                state.gust_length_m = gust_length_m(observation.height_m)
            state.wait(dt_s)
        self._notice_mass(observation.mass_kg)
        left_out: list[str] = []
        if observation.airborne:
            left_out += self._take_heading(observation)
        else:
            self._motion.forget()
            self._heading = HeadingWatch()
        if self._heading.off_rad:
            return tuple(left_out)
        if observation.airborne:
            left_out += self._take_tilt(observation)
            left_out += self._take_pitot(observation)
            left_out += self._take_vector(observation, dt_s)
        left_out += self._take_autopilot(observation)
        return tuple(left_out)

    def belief(self, t_s: float) -> WindBelief:
        """The wind at `t_s` >= the last update; waiting only makes it less certain."""
        p = self._params
        waited_s = 0.0 if self._t_s is None else max(t_s - self._t_s, 0.0)
        mean, cov = self._believed_airs.ten_second_mean(waited_s)
        fresh = [n for n, at in self._entered_s.items() if t_s - at <= p.stale_after_s]
        settled = self._tilt_s >= p.settle_s or "autopilot" in fresh
        return WindBelief(t_s, mean, cov, tuple(sorted(fresh)), settled and bool(fresh))

    def snapshot(self) -> dict[str, object]:
        """What a checkpoint keeps: trims and gains are worth more than the wind of then."""
        airs = self._believed_airs
        return {
            "format": SNAPSHOT_FORMAT,
            "t_s": self._t_s,
            "usual": airs.usual.snapshot(),
            "calm": None if airs.calm is None else airs.calm.snapshot(),
            "chance_calm": airs.chance_calm,
            "heading_off_rad": self._heading.off_rad,
        }

    def restore(self, snapshot: dict[str, object]) -> None:
        """Go on from a checkpoint; raises LeewayError when it is not one."""
        if snapshot.get("format") != SNAPSHOT_FORMAT:
            raise LeewayError(f"checkpoint: expected a {SNAPSHOT_FORMAT} snapshot")
        try:
            t_s = msgspec.convert(snapshot["t_s"], float | None)
            chance = msgspec.convert(snapshot["chance_calm"], float)
            off_rad = msgspec.convert(snapshot.get("heading_off_rad", 0.0), float)
            usual = self._restored(snapshot["usual"])
            calm = None if snapshot["calm"] is None else self._restored(snapshot["calm"])
        except (KeyError, ValueError, msgspec.ValidationError) as error:
            raise LeewayError(f"checkpoint: {error}") from error
        if not 0.0 <= chance < 1.0:
            raise LeewayError("checkpoint: expected a chance of calm from 0 to under 1")
        self._t_s, self._with_airspeed = t_s, None
        self._alone = Airs(usual, calm, chance)
        self._heading = HeadingWatch(off_rad)

    def _restored(self, snapshot: object) -> WindState:
        state = WindState(self._airframe, self._params)
        state.restore(msgspec.convert(snapshot, dict[str, object]))
        return state

    # -- what enters -----------------------------------------------------------------------------

    def _banks(self) -> list[Airs]:
        second = self._with_airspeed
        return [self._alone] if second is None else [self._alone, second]

    def _states(self) -> list[WindState]:
        return [state for airs in self._banks() for state in airs.states]

    def _notice_mass(self, mass_kg: float) -> None:
        """The parcel went: what was learned of the drag with it holds less without it."""
        if self._mass_kg is not None and abs(mass_kg - self._mass_kg) > 0.01 * self._mass_kg:
            for state in self._states():
                state.open_gain(self._params.gain_parcel_std_frac**2)
        self._mass_kg = mass_kg

    def _take_heading(self, seen: WindObservation) -> list[str]:
        """Suspend what depends on the heading while it is not known."""
        heading, was_off = self._heading, self._heading.off_rad != 0.0
        step = heading.step(seen)
        if step:
            self._entered_s.clear()
            self._tilt_s = 0.0
        elif was_off and self._heading_fits(seen):
            heading.off_rad = 0.0
        if step or (was_off and not heading.off_rad):
            self._motion.forget()
        if was_off and not heading.off_rad:
            trim_rad = min(REOPENED_TRIM_RAD, math.radians(self._airframe.drag.trim_std_deg))
            for state in self._states():
                state.open_wind(REOPENED_WIND_MPS**2)
                state.open_trim(trim_rad**2)
            return ["heading known again: estimate reopened"]
        size_deg = round(abs(math.degrees(step)), -1)
        return (
            [f"heading stepped by {size_deg:.0f} deg, more than a turn: not used"] if step else []
        )

    def _heading_fits(self, seen: WindObservation) -> bool:
        if not has_tilt(seen):
            self._motion.forget()
            return False
        motion = self._motion.take(seen, self._params)
        if motion.since_s is None or seen.yaw_rad is None:
            return False
        misfits: list[float] = []
        for turn_rad in (0.0, -self._heading.off_rad):
            turned = replace(seen, yaw_rad=seen.yaw_rad + turn_rad)
            at = self._airframe, self._params, turned, motion.turned(turn_rad)
            white = tilt_told(self._believed, *at).white
            misfits.append(min(float(white @ white), self._params.gate_sigmas**2))
        return self._heading.weigh(misfits[0], misfits[1], motion.since_s)

    def _take_tilt(self, seen: WindObservation) -> list[str]:
        if not has_tilt(seen):
            self._motion.forget()
            return []
        p = self._params
        motion = self._motion.take(seen, p)
        if motion.since_s is None:
            return []
        believed = self._believed
        rejected = False
        for airs in self._banks():
            states = airs.states
            told = [tilt_told(state, self._airframe, p, seen, motion) for state in states]
            if all(state.wind_std_mps < p.scalar_wind_std_mps for state in states):
                airs.weigh(told, p.gate_sigmas, motion.since_s)
            for state, one in zip(states, told, strict=True):
                left_out = _told_tilt(state, one, p, motion.since_s)
                rejected = rejected or (left_out and state is believed)
            airs.mind_wind()
        if rejected:
            return self._doubt_tilt(seen.t_s)
        self._rejected_since_s = None
        self._entered_s["tilt"] = seen.t_s
        self._tilt_s += motion.since_s
        return []

    def _doubt_tilt(self, t_s: float) -> list[str]:
        """Leave an outlier out; when they go on, it is the estimate that is wrong: open it."""
        if self._rejected_since_s is None:
            self._rejected_since_s = t_s
        if t_s - self._rejected_since_s > self._params.doubt_after_s:
            for state in self._states():
                state.open_wind(4.0)
            self._rejected_since_s = None
            return ["tilt disagrees with the wind estimate for long: estimate reopened"]
        return ["tilt disagrees with the wind estimate: left out"]

    def _take_pitot(self, seen: WindObservation) -> list[str]:
        p = self._params
        alone = self._alone.likelier
        if seen.airspeed_mps is None or alone.wind_std_mps > p.scalar_wind_std_mps:
            return []
        fresh_s, stuck = self._pitot.look(seen.t_s, seen.airspeed_mps, p.stuck_after_s)
        if stuck:
            self._with_airspeed = None
            return ["pitot reads the same for long: left out"]
        if fresh_s is None:
            return []
        by_tilt = pitot_seen(alone, p, seen, fresh_s)
        if by_tilt is None:
            return []
        self._pitot.judge(seen.t_s, by_tilt.surprise(alone), fresh_s, p)
        if self._pitot.faulty:
            self._with_airspeed = None
            return ["pitot disagrees with tilt for long: left out"]
        if self._with_airspeed is None:
            self._with_airspeed = self._alone.copy()
        airs = self._with_airspeed
        told = pitot_seen(airs.likelier, p, seen, fresh_s)
        if told is None:
            return []
        if abs(told.surprise(airs.likelier)) > p.gate_sigmas:
            reads, expected = told.measured_mps, told.expected_mps
            return [f"pitot reads {reads:.1f} m/s, {expected:.1f} expected: left out"]
        for state in airs.states:
            if (one := pitot_seen(state, p, seen, fresh_s)) is not None:
                self._enter(state, one, seen.t_s)
        return []

    def _take_vector(self, seen: WindObservation, dt_s: float) -> list[str]:
        p = self._params
        if seen.airspeed_fr_mps is None:
            return []
        if self._with_airspeed is None:
            self._with_airspeed = self._alone.copy()
        state = self._with_airspeed.likelier
        told = vector_seen(state, p, seen, dt_s)
        if state.wind_is_known and any(abs(t.surprise(state)) > p.gate_sigmas for t in told):
            return ["airspeed vector disagrees with the wind estimate: left out"]
        for each in self._with_airspeed.states:
            for axis in range(len(told)):  # the second is expected from what the first left
                self._enter(each, vector_seen(each, p, seen, dt_s)[axis], seen.t_s)
        return []

    def _enter(self, state: WindState, told: AirspeedSeen, t_s: float) -> None:
        state.correct(told.row, told.measured_mps - told.expected_mps, told.noise_m2ps2)
        self._entered_s["pitot"] = t_s

    def _take_autopilot(self, seen: WindObservation) -> list[str]:
        wind, p = seen.autopilot_wind_to_ne_mps, self._params
        last_s = self._entered_s.get("autopilot")
        if wind is None or (last_s is not None and seen.t_s - last_s < p.autopilot_every_s):
            return []
        # It is filtered over seconds, and its errors last as long: few of its words are new.
        repeats = p.autopilot_memory_s / p.autopilot_every_s
        noise = repeats * (_autopilot_cov(seen, p))
        whitening = np.linalg.inv(np.linalg.cholesky(noise))
        rows = np.zeros((2, STATES))
        rows[:, [At.LATELY, At.LATELY + 1]] = whitening
        told = whitening @ np.array(wind)
        x, cov = self._believed.x, self._believed.cov
        for row, value in zip(rows, told, strict=True):
            if (value - float(row @ x)) ** 2 > p.gate_sigmas**2 * (float(row @ cov @ row) + 1.0):
                return ["the autopilot's wind disagrees with the wind estimate: left out"]
        for state in self._states():
            for row, value in zip(rows, told, strict=True):
                state.correct(row, float(value) - float(row @ state.x), 1.0)
        self._entered_s["autopilot"] = seen.t_s
        return []


def _told_tilt(state: WindState, told: TiltTold, params: WindEstimatorParams, dt_s: float) -> bool:
    """Correct a state by what a measurement of drag told it; True: left out, being an outlier."""
    if told.is_outlier(params.gate_sigmas):
        return True
    known = state.wind_std_mps < params.scalar_wind_std_mps
    state.correct_both(told.gain, told.white)
    if known:
        step, variance = told.wind_step_ne_mps, told.wind_step_variance_m2ps2
        state.corrected(step, variance, told.surprise, dt_s)
    return False


def _autopilot_cov(seen: WindObservation, p: WindEstimatorParams) -> np.ndarray:
    if seen.autopilot_wind_cov_m2ps2 is None:
        return p.autopilot_std_mps**2 * np.eye(2)
    nn, ne, ee = seen.autopilot_wind_cov_m2ps2
    return np.array([[nn, ne], [ne, ee]]) + p.autopilot_least_std_mps**2 * np.eye(2)
