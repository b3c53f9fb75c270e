"""Estimator of the horizontal wind at the vehicle, with its covariance, from all measurements.

- Tilt and acceleration measure drag (`drag_update`). An airspeed sensor measures the speed of the
  air, or its vector (`airspeed_update`). An autopilot may send its own estimate with a covariance.
  Any of them may be missing, appear and disappear.
- Trims are states along BODY axes: their causes (a levelling error, a centre of gravity off the
  thrust axis) turn with the airframe. Another heading or speed separates trim from wind; on one
  heading only their priors do (`ekf`).
- A heading error turns the air velocity: 3 degrees at 14 m/s are 0.7 m/s of cross-wind. The return
  flight on the opposite heading makes it observable.
- In light wind two filters, one for calm and one for turbulent air, are weighted by likelihood
  (`multiple_model`); in stronger wind there is the second alone.
- A step of the reported attitude or velocity from arming on suspends all measurements, until it is
  known again (`step_watch`). The earlier wind is kept and ages, and is not valid meanwhile.
- While an airspeed is used, copies of the filters run without it. The airspeed is checked against
  them, and they replace it immediately if it is faulty.
- A released parcel changes the drag by more than its mass, so the gains' variance is increased.
- The filter is plain numpy. filterpy is the oracle in the tests and the reference in replay
  (`companion.analysis.replay.reference_estimator`); it never flies.
"""

import math

import msgspec
import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.airspeed_update import (
    AirspeedMeasurement,
    PitotMonitor,
    pitot_measurement_or_none,
    vector_airspeed_measurements,
)
from companion.core.wind.drag_update import (
    MotionTracker,
    TiltInnovation,
    compute_tilt_innovation_and_set_airspeed,
    has_usable_attitude_and_velocity,
)
from companion.core.wind.ekf import (
    STATES,
    StateIndex,
    WindEstimatorParams,
    WindState,
    eddy_length_at_height_m,
)
from companion.core.wind.multiple_model import AirHypotheses
from companion.core.wind.observation import StepMessage, WindBelief, WindObservation
from companion.core.wind.step_watch import ReportWatch

__all__ = ["WindBelief", "WindEstimator", "WindEstimatorParams", "WindObservation"]

SNAPSHOT_FORMAT = "wind-estimator/5"


KNOWN_DRAG_STD_FRAC = 0.1
INFLATED_WIND_STD_MPS, INFLATED_TRIM_STD_RAD = 0.5, math.radians(0.3)  # after a step of the reports
FRONT_PROCESS_NOISE_M2PS3 = (
    0.05  # ten times the recordings': fronts cause most losses on return flights
)


def default_params_for_airframe(airframe: Airframe) -> WindEstimatorParams:
    """Return the filter's noises for an airframe: with known drag the wind's random walk is faster.

    Otherwise a fast walk cannot be separated from a drag error: on the real flight with the generic
    airframe the error is 1.20 m/s with the slow walk of the recordings, 1.44 with the fast one.
    With drag known, a front of 7 m/s in 90 s (params/flights/default.toml) is followed to 1.3 m/s
    and NEES 3 with the fast walk, 2.1 and 11 with the slow one. Unknown gains wait for the wind.
    """
    if airframe.drag.gain_std_frac <= KNOWN_DRAG_STD_FRAC:
        return WindEstimatorParams(mean_process_noise_m2ps3=FRONT_PROCESS_NOISE_M2PS3)
    return WindEstimatorParams(gain_waits_for_wind=True)


class WindEstimator:
    """Wind estimator of one vehicle."""

    def __init__(self, airframe: Airframe, params: WindEstimatorParams | None = None) -> None:
        self._airframe = airframe
        drag = airframe.drag
        self._mean_trim_rad = math.radians(drag.trim_forward_deg), math.radians(drag.trim_right_deg)
        self._params = params or default_params_for_airframe(airframe)
        self._without_airspeed = AirHypotheses.create_before_observations(
            airframe, self._params
        )  # without any airspeed
        self._with_airspeed: AirHypotheses | None = None
        self._t_s: float | None = None
        self._last_used_s: dict[str, float] = {}
        self._tilt_s = 0.0
        self._motion = MotionTracker()
        self._step_free_motion = MotionTracker()
        self._watch = ReportWatch()
        self._pitot = PitotMonitor()
        self._rejected_since_s: float | None = None
        self._mass_kg: float | None = None

    @property
    def _active_hypotheses(self) -> AirHypotheses:
        return self._with_airspeed or self._without_airspeed

    @property
    def _active_state(self) -> WindState:
        return self._active_hypotheses.likelier_filter_state

    @property
    def trim_deviation_forward_right_rad(self) -> tuple[float, float]:
        """Estimated tilt trim less the airframe's mean trim, along body forward and right."""
        x = self._active_state.x
        return float(x[StateIndex.TRIM]), float(x[StateIndex.TRIM + 1])

    @property
    def drag_gain_forward_right(self) -> tuple[float, float]:
        """Measured drag over the airframe file's drag, forward and right."""
        x = self._active_state.x
        return math.exp(float(x[StateIndex.LOG_GAIN])), math.exp(float(x[StateIndex.LOG_GAIN + 1]))

    @property
    def drag_gain_std_forward_right(self) -> tuple[float, float]:
        """Relative standard deviations of the drag gains."""
        variance = np.diag(self._active_state.cov)
        return math.sqrt(variance[StateIndex.LOG_GAIN]), math.sqrt(
            variance[StateIndex.LOG_GAIN + 1]
        )

    @property
    def heading_error_rad(self) -> float:
        """Estimated true heading less the reported heading."""
        return float(self._active_state.x[StateIndex.HEADING])

    @property
    def airspeed_scale(self) -> float:
        """Indicated airspeed over true airspeed."""
        return math.exp(float(self._active_state.x[StateIndex.LOG_SCALE]))

    def update(self, observation: WindObservation) -> tuple[str, ...]:
        """Process one observation (about 10 Hz); returns a message for each rejected measurement.

        Late or repeated times are ignored. Raises ValueError on NaN or infinity.
        """
        observation.raise_if_invalid()
        if any(self._mean_trim_rad):
            observation = observation.with_attitude_corrected_by_trims(*self._mean_trim_rad)
        before_s = self._t_s
        if before_s is not None and observation.t_s <= before_s:
            return ()
        dt_s = 0.0 if before_s is None else observation.t_s - before_s
        self._t_s = observation.t_s
        for state in self._all_filter_states():
            if observation.height_m is not None:
                state.gust_length_m = eddy_length_at_height_m(observation.height_m)
            state.predict_state(dt_s)
        self._inflate_drag_gain_on_mass_change(observation.mass_kg)
        left_out: list[str] = []
        if not observation.airborne:
            self._motion.clear_history()
            self._watch = self._watch if observation.armed else ReportWatch()
        if observation.airborne or observation.armed:
            left_out += self._update_validity_of_reports(observation)
        if any(self._watch.offsets):
            return tuple(left_out)
        if observation.airborne:
            left_out += self._correct_by_tilt_or_report_rejection(observation)
            left_out += self._update_pitot_fault_and_correct_wind(observation)
            left_out += self._correct_by_vector_or_report_rejection(observation, dt_s)
        left_out += self._correct_by_autopilot_or_report_rejection(observation)
        return tuple(left_out)

    def belief(self, t_s: float) -> WindBelief:
        """Return the wind at `t_s` >= the last update; its uncertainty grows with that time."""
        p = self._params
        waited_s = 0.0 if self._t_s is None else max(t_s - self._t_s, 0.0)
        mean, cov = self._active_hypotheses.ten_second_wind_mean_and_cov(waited_s)
        recent = [n for n, at in self._last_used_s.items() if t_s - at <= p.stale_after_s]
        settled = self._tilt_s >= p.settle_s or "autopilot" in recent
        return WindBelief(t_s, mean, cov, tuple(sorted(recent)), settled and bool(recent))

    def snapshot(self) -> dict[str, object]:
        """Return the contents of a checkpoint, mainly for its trims and gains."""
        hypotheses = self._active_hypotheses
        return {
            "format": SNAPSHOT_FORMAT,
            "t_s": self._t_s,
            "usual": hypotheses.turbulent.snapshot(),
            "calm": None if hypotheses.calm is None else hypotheses.calm.snapshot(),
            "chance_calm": hypotheses.chance_calm,
            "heading_off_rad": self._watch.heading.off[0],
            "tilt_off_rad": list(self._watch.tilt.off),
            "velocity_off_mps": list(self._watch.velocity.off),
        }

    def restore(self, snapshot: dict[str, object]) -> None:
        """Restore a checkpoint; raises LeewayError if it is invalid."""
        if snapshot.get("format") != SNAPSHOT_FORMAT:
            raise LeewayError(f"checkpoint: expected a {SNAPSHOT_FORMAT} snapshot")
        try:
            t_s = msgspec.convert(snapshot["t_s"], float | None)
            chance = msgspec.convert(snapshot["chance_calm"], float)
            watch = ReportWatch()
            for detector, key in (
                (watch.tilt, "tilt_off_rad"),
                (watch.velocity, "velocity_off_mps"),
            ):
                detector.off = msgspec.convert(snapshot.get(key, detector.off), type(detector.off))
            watch.heading.off = (msgspec.convert(snapshot.get("heading_off_rad", 0.0), float),)
            turbulent = self._restore_filter_state(snapshot["usual"])
            calm = (
                None if snapshot["calm"] is None else self._restore_filter_state(snapshot["calm"])
            )
        except (KeyError, ValueError, msgspec.ValidationError) as error:
            raise LeewayError(f"checkpoint: {error}") from error
        if not 0.0 <= chance < 1.0:
            raise LeewayError("checkpoint: expected a chance of calm from 0 to under 1")
        self._t_s, self._with_airspeed = t_s, None
        self._without_airspeed = AirHypotheses(turbulent, calm, chance)
        self._watch = watch

    def _restore_filter_state(self, snapshot: object) -> WindState:
        state = WindState(self._airframe, self._params)
        state.restore(msgspec.convert(snapshot, dict[str, object]))
        return state

    # -- measurements ----------------------------------------------------------------------------

    def _hypotheses_without_and_with_airspeed(self) -> list[AirHypotheses]:
        second = self._with_airspeed
        return [self._without_airspeed] if second is None else [self._without_airspeed, second]

    def _all_filter_states(self) -> list[WindState]:
        return [
            state
            for hypotheses in self._hypotheses_without_and_with_airspeed()
            for state in hypotheses.active_filter_states
        ]

    def _inflate_drag_gain_on_mass_change(self, mass_kg: float) -> None:
        """Increase the drag gains' variance after a change of mass: the parcel was released."""
        if self._mass_kg is not None and abs(mass_kg - self._mass_kg) > 0.01 * self._mass_kg:
            for state in self._all_filter_states():
                state.inflate_drag_gain_variance(self._params.gain_parcel_std_frac**2)
        self._mass_kg = mass_kg

    def _update_validity_of_reports(self, observation: WindObservation) -> list[str]:
        """Suspend the measurements while attitude or velocity are unknown."""
        watch = self._watch
        was_off = any(watch.offsets)
        steps = watch.update_and_describe_steps(observation)
        if steps:
            self._last_used_s.clear()
            self._tilt_s = 0.0
        elif was_off:
            self._update_motion_and_accept_right_reports(observation)
        is_known_again = was_off and not any(watch.offsets)
        if steps or is_known_again:
            self._motion.clear_history()
            self._step_free_motion.clear_history()
        if is_known_again:
            trim_rad = min(INFLATED_TRIM_STD_RAD, math.radians(self._airframe.drag.trim_std_deg))
            for state in self._all_filter_states():
                state.inflate_mean_wind_variance(INFLATED_WIND_STD_MPS**2)
                state.inflate_trim_variance(trim_rad**2)
            return [StepMessage("reports known again: variance increased")]
        return [StepMessage(f"{text}: not used") for text in steps]

    def _update_motion_and_accept_right_reports(self, observation: WindObservation) -> None:
        if not (observation.airborne and has_usable_attitude_and_velocity(observation)):
            self._motion.clear_history()
            self._step_free_motion.clear_history()
            return
        misfits: list[float] = []
        interval_s = None
        for reported, tracker in (
            (observation, self._motion),
            (self._watch.without_steps(observation), self._step_free_motion),
        ):
            motion = tracker.update_and_derive_motion(reported, self._params)
            if motion.since_s is None:
                continue
            interval_s = motion.since_s
            at = self._airframe, self._params, reported, motion
            white = compute_tilt_innovation_and_set_airspeed(self._active_state, *at).white
            misfits.append(min(float(white @ white), self._params.gate_sigmas**2))
        if interval_s is not None and len(misfits) == 2:
            self._watch.update_evidence_and_accept_reports(misfits[0], misfits[1], interval_s)

    def _correct_by_tilt_or_report_rejection(self, observation: WindObservation) -> list[str]:
        if not has_usable_attitude_and_velocity(observation):
            self._motion.clear_history()
            return []
        p = self._params
        motion = self._motion.update_and_derive_motion(observation, p)
        if motion.since_s is None:
            return []
        active = self._active_state
        rejected = False
        for hypotheses in self._hypotheses_without_and_with_airspeed():
            states = hypotheses.active_filter_states
            measured = [
                compute_tilt_innovation_and_set_airspeed(
                    state, self._airframe, p, observation, motion
                )
                for state in states
            ]
            if all(state.mean_wind_axis_std_mps < p.scalar_wind_std_mps for state in states):
                hypotheses.update_calm_probability(measured, p.gate_sigmas, motion.since_s)
            for state, one in zip(states, measured, strict=True):
                left_out = _reject_outlier_or_correct_by_tilt(state, one, p, motion.since_s)
                rejected = rejected or (left_out and state is active)
            hypotheses.remove_or_restore_calm_hypothesis()
        if rejected:
            return self._report_tilt_rejection_or_inflate(observation.t_s)
        self._rejected_since_s = None
        self._last_used_s["tilt"] = observation.t_s
        self._tilt_s += motion.since_s
        return []

    def _report_tilt_rejection_or_inflate(self, t_s: float) -> list[str]:
        """Reject an outlier; after a series of them, increase the estimate's variance."""
        if self._rejected_since_s is None:
            self._rejected_since_s = t_s
        if t_s - self._rejected_since_s > self._params.reset_after_s:
            for state in self._all_filter_states():
                state.inflate_mean_wind_variance(4.0)
            self._rejected_since_s = None
            return ["tilt keeps disagreeing with the wind estimate: wind variance increased"]
        return ["tilt disagrees with the wind estimate: rejected"]

    def _update_pitot_fault_and_correct_wind(self, observation: WindObservation) -> list[str]:
        p = self._params
        tilt_state = self._without_airspeed.likelier_filter_state
        if (
            observation.airspeed_mps is None
            or tilt_state.mean_wind_axis_std_mps > p.scalar_wind_std_mps
        ):
            return []
        interval_s, stuck = self._pitot.record_reading_interval_and_stuck(
            observation.t_s, observation.airspeed_mps, p.stuck_after_s
        )
        if stuck:
            self._with_airspeed = None
            return ["pitot stuck at one value: rejected"]
        if interval_s is None:
            return []
        by_tilt = pitot_measurement_or_none(tilt_state, p, observation, interval_s)
        if by_tilt is None:
            return []
        self._pitot.update_fault_state(
            observation.t_s, by_tilt.normalised_innovation(tilt_state), interval_s, p
        )
        if self._pitot.faulty:
            self._with_airspeed = None
            return ["pitot keeps disagreeing with tilt: rejected"]
        if self._with_airspeed is None:
            self._with_airspeed = self._without_airspeed.copy()
        hypotheses = self._with_airspeed
        measured = pitot_measurement_or_none(
            hypotheses.likelier_filter_state, p, observation, interval_s
        )
        if measured is None:
            return []
        if abs(measured.normalised_innovation(hypotheses.likelier_filter_state)) > p.gate_sigmas:
            reads, expected = measured.measured_mps, measured.expected_mps
            return [f"pitot reads {reads:.1f} m/s, expected {expected:.1f}: rejected"]
        for state in hypotheses.active_filter_states:
            if (one := pitot_measurement_or_none(state, p, observation, interval_s)) is not None:
                self._correct_by_airspeed_and_record_use(state, one, observation.t_s)
        return []

    def _correct_by_vector_or_report_rejection(
        self, observation: WindObservation, dt_s: float
    ) -> list[str]:
        p = self._params
        if observation.airspeed_fr_mps is None:
            return []
        if self._with_airspeed is None:
            self._with_airspeed = self._without_airspeed.copy()
        state = self._with_airspeed.likelier_filter_state
        measured = vector_airspeed_measurements(state, p, observation, dt_s)
        if state.is_wind_std_below_known_limit and any(
            abs(t.normalised_innovation(state)) > p.gate_sigmas for t in measured
        ):
            return ["airspeed vector disagrees with the wind estimate: rejected"]
        for each in self._with_airspeed.active_filter_states:
            for axis in range(len(measured)):  # the second uses the state after the first
                self._correct_by_airspeed_and_record_use(
                    each,
                    vector_airspeed_measurements(each, p, observation, dt_s)[axis],
                    observation.t_s,
                )
        return []

    def _correct_by_airspeed_and_record_use(
        self, state: WindState, measured: AirspeedMeasurement, t_s: float
    ) -> None:
        state.correct_by_scalar(
            measured.row, measured.measured_mps - measured.expected_mps, measured.noise_m2ps2
        )
        self._last_used_s["pitot"] = t_s

    def _correct_by_autopilot_or_report_rejection(self, observation: WindObservation) -> list[str]:
        wind, p = observation.autopilot_wind_to_ne_mps, self._params
        last_s = self._last_used_s.get("autopilot")
        if wind is None or (
            last_s is not None and observation.t_s - last_s < p.autopilot_interval_s
        ):
            return []
        # It is filtered over seconds, and its errors are correlated: few samples are independent.
        repeats = p.autopilot_memory_s / p.autopilot_interval_s
        noise = repeats * (_autopilot_wind_covariance_m2ps2(observation, p))
        whitening = np.linalg.inv(np.linalg.cholesky(noise))
        rows = np.zeros((2, STATES))
        rows[:, [StateIndex.LAGGED_MEAN, StateIndex.LAGGED_MEAN + 1]] = whitening
        measured = whitening @ np.array(wind)
        x, cov = self._active_state.x, self._active_state.cov
        for row, value in zip(rows, measured, strict=True):
            if (value - float(row @ x)) ** 2 > p.gate_sigmas**2 * (float(row @ cov @ row) + 1.0):
                return ["autopilot wind disagrees with the wind estimate: rejected"]
        for state in self._all_filter_states():
            for row, value in zip(rows, measured, strict=True):
                state.correct_by_scalar(row, float(value) - float(row @ state.x), 1.0)
        self._last_used_s["autopilot"] = observation.t_s
        return []


def _reject_outlier_or_correct_by_tilt(
    state: WindState, measured: TiltInnovation, params: WindEstimatorParams, dt_s: float
) -> bool:
    """Correct a state by a drag measurement; returns True if it is rejected as an outlier."""
    if measured.is_outlier(params.gate_sigmas):
        return True
    known = state.mean_wind_axis_std_mps < params.scalar_wind_std_mps
    state.correct_by_two_scalars(measured.gain, measured.white)
    if known:
        step, variance = measured.wind_correction_ne_mps, measured.wind_correction_variance_m2ps2
        state.update_turbulence_and_front(step, variance, measured.mean_nis, dt_s)
    return False


def _autopilot_wind_covariance_m2ps2(
    observation: WindObservation, p: WindEstimatorParams
) -> np.ndarray:
    if observation.autopilot_wind_cov_m2ps2 is None:
        return p.autopilot_std_mps**2 * np.eye(2)
    nn, ne, ee = observation.autopilot_wind_cov_m2ps2
    return np.array([[nn, ne], [ne, ee]]) + p.autopilot_least_std_mps**2 * np.eye(2)
