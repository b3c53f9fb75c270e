"""Detection of impossible steps of the reported heading: yaw resets and corrupted reports.

After a step the heading is unknown: the report before or after it may be wrong. It is known again
after a step back, or when the measured drag, with the earlier wind, fits the reported heading and
does not fit the heading without the steps.
"""

import math

from companion.core.wind.observation import WindObservation

TOLERANCE_RAD = math.radians(10.0)  # between reports: noise, filters, start of a turn
MAX_TURN_RPS = math.pi  # without a reported rate: faster than autopilots turn a multirotor
RATED_RPS, RATE_ERROR_FRAC = math.radians(60.0), 0.3  # with a rate: unreported turns, rates in tilt
MAX_REPORT_INTERVAL_S, MAX_TURN_RAD = (
    1.0,
    math.radians(50.0),
)  # at low report rates; the drag checks larger turns
MAX_PLAUSIBLE_RPS = 20.0
STEP_BACK_RAD = math.radians(15.0)  # a smaller sum of steps is a step back
COMPARISON_WINDOW_S, COMPARISON_NATS = 2.0, 10.0


class HeadingStepDetector:
    """Detects heading steps; `off_rad` is their sum, 0 while the heading is known."""

    __slots__ = ("_before", "_evidence", "_levels", "off_rad")

    def __init__(self, off_rad: float = 0.0) -> None:
        self.off_rad = off_rad
        self._before: tuple[float, float, float | None] | None = None  # t_s, yaw, its rate
        self._evidence = (0.0, 0.0, 0.0)
        self._levels: tuple[float | None, ...] = ()  # roll and pitch of the last report

    def update_and_detect_step_rad(self, observation: WindObservation) -> float:
        """Process a report; returns the step since the last one (rad), 0 for a possible turn."""
        if observation.yaw_rad is None:
            return 0.0
        now_s = observation.t_s if observation.attitude_t_s is None else observation.attitude_t_s
        now = now_s, observation.yaw_rad, observation.yaw_rate_rps
        before_s, yaw_rad, rate_rps = self._before = self._before or now
        dt_s = now_s - before_s
        levels = observation.roll_rad, observation.pitch_rad
        repeated = (
            levels == self._levels
            and observation.yaw_rad == yaw_rad
            and dt_s < MAX_REPORT_INTERVAL_S
        )
        self._levels = levels
        if dt_s <= 0.0 or repeated:  # repeated sample: the vehicle may have turned since
            return 0.0
        self._before = now
        rates = [r for r in (rate_rps, now[2]) if r is not None and abs(r) < MAX_PLAUSIBLE_RPS]
        reported_turn_rad = dt_s * sum(rates) / len(rates) if rates else 0.0
        unseen = dt_s * (RATED_RPS if rates else MAX_TURN_RPS)
        if dt_s <= MAX_REPORT_INTERVAL_S:
            unseen = min(unseen, MAX_TURN_RAD)
        limit_rad = TOLERANCE_RAD + unseen + RATE_ERROR_FRAC * abs(reported_turn_rad)
        step = math.remainder(observation.yaw_rad - yaw_rad - reported_turn_rad, math.tau)
        if abs(step) <= limit_rad:
            return 0.0
        off = math.remainder(self.off_rad + step, math.tau)
        self.off_rad = 0.0 if abs(off) < STEP_BACK_RAD else off
        self._evidence = (0.0, 0.0, 0.0)
        return step

    def update_evidence_and_confirm_heading(
        self, reported_heading_misfit: float, step_free_heading_misfit: float, dt_s: float
    ) -> bool:
        """Compare the squared innovations (2 axes) of a drag measurement by the reported heading
        and by that without the steps; True once the first is right, by windows of
        `COMPARISON_WINDOW_S`.
        """
        seen_s, own, nats = self._evidence
        seen_s, own, nats = (
            seen_s + dt_s,
            own + reported_heading_misfit * dt_s,
            nats + 0.5 * (step_free_heading_misfit - reported_heading_misfit),
        )
        self._evidence = (seen_s, own, nats)
        if seen_s < COMPARISON_WINDOW_S:
            return False
        self._evidence = (0.0, 0.0, 0.0)
        return own < seen_s and nats > COMPARISON_NATS
