"""Detection of impossible steps of reported quantities: estimator resets and corrupted reports.

After a step the quantity is unknown: the report before or after it may be wrong. It is known again
after a step back, or by evidence that needs neither report. For attitude and velocity that is the
measured drag: with the earlier wind it fits the reports and does not fit them without the steps.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from companion.core.wind.observation import WindObservation

RATE_ERROR_FRAC = 0.3
MAX_REPORT_INTERVAL_S = 1.0
MAX_PLAUSIBLE_RPS = 20.0
COMPARISON_WINDOW_S, COMPARISON_NATS = 2.0, 10.0


@dataclass(frozen=True, slots=True)
class StepLimits:
    """Physical limits of one quantity between two reports; SI units, angles in rad.

    `tolerance`: noise, filters, start of a manoeuvre. `max_rate`: without a reported rate.
    `unreported_rate`: in addition to a reported one. `max_change`: at intervals up to
    `MAX_REPORT_INTERVAL_S`; evidence shows larger changes. `step_back`: a smaller sum of steps.
    """

    quantity: str
    unit: str
    tolerance: float
    max_rate: float
    unreported_rate: float
    max_change: float
    step_back: float
    is_angle: bool = False

    def step_text(self, size: float) -> str:
        """Return a step of this size as text."""
        amount = math.degrees(size) if self.is_angle else size
        return f"{self.quantity} stepped by {amount:.0f} {self.unit}"


def _angular(quantity: str, *limits_deg: float) -> StepLimits:
    return StepLimits(quantity, "deg", *map(math.radians, limits_deg), is_angle=True)


# quantity, unit, tolerance, max_rate, unreported_rate, max_change, step_back
HEADING = _angular("heading", 10.0, 180.0, 60.0, 50.0, 15.0)  # autopilots turn by 45 to 90 deg/s
TILT = _angular("tilt", 6.0, 220.0, 40.0, 45.0, 5.0)  # MC_ROLLRATE_MAX
VELOCITY = StepLimits("velocity", "m/s", 1.5, 12.0, 12.0, 6.0, 2.0)  # 45 degrees of tilt, and drag
POSITION = StepLimits("position", "m", 5.0, 40.0, 8.0, 12.0, 8.0)  # error of the reported velocity
HEIGHT = StepLimits("height", "m", 5.0, 20.0, 5.0, 8.0, 5.0)


class StepDetector:
    """Detects steps of one quantity; `off` is their sum, zeros while the quantity is known."""

    __slots__ = ("_before", "_limits", "_signature", "off")

    def __init__(self, limits: StepLimits, off: Sequence[float]) -> None:
        self._limits = limits
        self.off = tuple(off)
        self._before: tuple[float, Sequence[float], Sequence[float] | None] | None = None
        self._signature: Sequence[float | None] = ()

    def update_and_detect_step(
        self,
        t_s: float,
        values: Sequence[float],
        rates: Sequence[float] | None = None,
        signature: Sequence[float | None] = (),
    ) -> float:
        """Process a report; returns the size of its step, 0 for a possible change. `signature`: of
        the whole message, by which a repeated one is recognised.
        """
        limits = self._limits
        before_s, before, before_rates = self._before = self._before or (t_s, values, rates)
        dt_s = t_s - before_s
        signature = signature or values
        repeated = signature == self._signature and dt_s < MAX_REPORT_INTERVAL_S
        self._signature = signature
        if dt_s <= 0.0 or repeated:  # repeated sample: the vehicle may have moved since
            return 0.0
        self._before = t_s, values, rates
        known = [one for one in (before_rates, rates) if one is not None]
        reported = [dt_s * sum(axis) / len(known) for axis in zip(*known, strict=True)]
        reported = reported or [0.0] * len(values)
        unseen = dt_s * (limits.unreported_rate if known else limits.max_rate)
        if dt_s <= MAX_REPORT_INTERVAL_S:
            unseen = min(unseen, limits.max_change)
        limit = limits.tolerance + unseen + RATE_ERROR_FRAC * math.hypot(*reported)
        changes = zip(values, before, reported, strict=True)
        step = [self._difference(now, old + moved) for now, old, moved in changes]
        if math.hypot(*step) <= limit:
            return 0.0
        off = [self._difference(old, -new) for old, new in zip(self.off, step, strict=True)]
        self.off = tuple(off if math.hypot(*off) >= limits.step_back else [0.0] * len(off))
        return math.hypot(*step)

    def _difference(self, now: float, before: float) -> float:
        return math.remainder(now - before, math.tau) if self._limits.is_angle else now - before

    def accept_reports(self) -> None:
        """The reports are right, the steps included."""
        self.off = (0.0,) * len(self.off)


def _plausible_or_none(rates_rps: Sequence[float | None]) -> list[float] | None:
    known = [rate for rate in rates_rps if rate is not None and abs(rate) < MAX_PLAUSIBLE_RPS]
    return known if len(known) == len(rates_rps) else None


@dataclass(slots=True)
class ReportWatch:
    """Watches the reports from which drag is measured: heading, tilt and velocity."""

    heading: StepDetector = field(default_factory=lambda: StepDetector(HEADING, [0.0]))
    tilt: StepDetector = field(default_factory=lambda: StepDetector(TILT, [0.0, 0.0]))
    velocity: StepDetector = field(default_factory=lambda: StepDetector(VELOCITY, [0.0] * 3))
    _evidence: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def offsets(self) -> tuple[float, ...]:
        """Sums of the steps: heading, roll, pitch (rad), velocity (NED, m/s)."""
        return (*self.heading.off, *self.tilt.off, *self.velocity.off)

    def update_and_describe_steps(self, observation: WindObservation) -> list[str]:
        """Process the reports; return each step as text."""
        o, found = observation, list[tuple[StepLimits, float]]()
        t_s = o.t_s if o.attitude_t_s is None else o.attitude_t_s
        attitude = o.roll_rad, o.pitch_rad, o.yaw_rad
        if o.yaw_rad is not None:
            rates = _plausible_or_none([o.yaw_rate_rps])
            size = self.heading.update_and_detect_step(t_s, [o.yaw_rad], rates, attitude)
            found.append((HEADING, round(math.degrees(size), -1) * math.pi / 180.0))
        if o.roll_rad is not None and o.pitch_rad is not None:
            rates, tilt = _plausible_or_none(o.tilt_rates_rps), (o.roll_rad, o.pitch_rad)
            size = self.tilt.update_and_detect_step(t_s, tilt, rates, attitude)
            found.append((TILT, size))
        if o.vel_ned_mps is not None:
            size = self.velocity.update_and_detect_step(o.t_s, o.vel_ned_mps)
            found.append((VELOCITY, size))
        texts = [limits.step_text(size) for limits, size in found if size]
        if texts:
            self._evidence = (0.0, 0.0, 0.0)
        return texts

    def without_steps(self, observation: WindObservation) -> WindObservation:
        """Return the observation as it would be without the steps."""
        yaw, roll, pitch, *velocity = self.offsets
        vel, o = observation.vel_ned_mps or (0.0, 0.0, 0.0), observation
        return replace(
            o,
            yaw_rad=(o.yaw_rad or 0.0) - yaw,
            roll_rad=(o.roll_rad or 0.0) - roll,
            pitch_rad=(o.pitch_rad or 0.0) - pitch,
            vel_ned_mps=(vel[0] - velocity[0], vel[1] - velocity[1], vel[2] - velocity[2]),
        )

    def update_evidence_and_accept_reports(
        self, reported_misfit: float, step_free_misfit: float, dt_s: float
    ) -> bool:
        """Compare the squared innovations (2 axes) of a drag measurement by the reports and by them
        without the steps; True once the first are right, by windows of `COMPARISON_WINDOW_S`.
        """
        seen_s, own, nats = self._evidence
        seen_s, own = seen_s + dt_s, own + reported_misfit * dt_s
        nats += 0.5 * (step_free_misfit - reported_misfit)
        self._evidence = (seen_s, own, nats)
        if seen_s < COMPARISON_WINDOW_S:
            return False
        self._evidence = (0.0, 0.0, 0.0)
        if is_accepted := own < seen_s and nats > COMPARISON_NATS:
            for detector in (self.heading, self.tilt, self.velocity):
                detector.accept_reports()
        return is_accepted
