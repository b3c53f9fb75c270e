"""Steps of the reported heading that the vehicle cannot have turned: yaw resets, damaged reports.

After a step the heading is not known: the one before or the one after it may be wrong. It is known
again after a step back, or where drag, over ground and in the wind of before, fits the heading that
is reported and does not fit the one without the steps.
"""

import math

from companion.core.wind.observation import WindObservation

TOLERANCE_RAD = math.radians(10.0)  # of one report to the next: noise, filters, turns that begin
MOST_RPS = math.pi  # without a reported rate: faster than autopilots turn a multirotor
RATED_RPS, RATE_ERROR_FRAC = math.radians(60.0), 0.3  # beside a rate: turns unseen, rates in tilt
SLOWEST_S, MOST_TURN_RAD = 1.0, math.radians(50.0)  # at low rates: more is checked by the drag
WILD_RPS = 20.0
BACK_RAD = math.radians(15.0)  # steps that add up to less are a step back
AGREES_S, AGREES_NATS = 2.0, 10.0


class HeadingWatch:
    """Finds steps; `off_rad` is their sum, 0 while the heading is known."""

    __slots__ = ("_before", "_evidence", "_levels", "off_rad")

    def __init__(self, off_rad: float = 0.0) -> None:
        self.off_rad = off_rad
        self._before: tuple[float, float, float | None] | None = None  # t_s, yaw, its rate
        self._evidence = (0.0, 0.0, 0.0)
        self._levels: tuple[float | None, ...] = ()  # roll and pitch of the last report

    def step(self, seen: WindObservation) -> float:
        """Take a report; returns the step since the last one (rad), 0 for what may be a turn."""
        if seen.yaw_rad is None:
            return 0.0
        now_s = seen.t_s if seen.attitude_t_s is None else seen.attitude_t_s
        now = now_s, seen.yaw_rad, seen.yaw_rate_rps
        before_s, yaw_rad, rate_rps = self._before = self._before or now
        dt_s = now_s - before_s
        levels = seen.roll_rad, seen.pitch_rad
        repeated = levels == self._levels and seen.yaw_rad == yaw_rad and dt_s < SLOWEST_S
        self._levels = levels
        if dt_s <= 0.0 or repeated:  # an old sample again: it may have turned meanwhile
            return 0.0
        self._before = now
        rates = [r for r in (rate_rps, now[2]) if r is not None and abs(r) < WILD_RPS]
        turned = dt_s * sum(rates) / len(rates) if rates else 0.0
        unseen = dt_s * (RATED_RPS if rates else MOST_RPS)
        if dt_s <= SLOWEST_S:
            unseen = min(unseen, MOST_TURN_RAD)
        may = TOLERANCE_RAD + unseen + RATE_ERROR_FRAC * abs(turned)
        step = math.remainder(seen.yaw_rad - yaw_rad - turned, math.tau)
        if abs(step) <= may:
            return 0.0
        off = math.remainder(self.off_rad + step, math.tau)
        self.off_rad = 0.0 if abs(off) < BACK_RAD else off
        self._evidence = (0.0, 0.0, 0.0)
        return step

    def weigh(self, misfit: float, other_misfit: float, dt_s: float) -> bool:
        """Take the squared innovation (2 axes) of a drag measurement by the heading reported, and
        by that without the steps; True once the first is right, by windows of `AGREES_S`.
        """
        seen_s, own, nats = self._evidence
        seen_s, own, nats = seen_s + dt_s, own + misfit * dt_s, nats + 0.5 * (other_misfit - misfit)
        self._evidence = (seen_s, own, nats)
        if seen_s < AGREES_S:
            return False
        self._evidence = (0.0, 0.0, 0.0)
        return own < seen_s and nats > AGREES_NATS
