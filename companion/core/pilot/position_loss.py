"""A position that is lost in flight: said at once, with where the vehicle was last.

Nothing is ordered on it. Both autopilots come down by themselves where they are once their
estimator gives up (ArduCopter's EKF failsafe, PX4's descend), and no order of a companion that
knows no position either could do better: it tells the operator where to look.
"""

from dataclasses import dataclass

from companion.core.mission.actions import Severity
from companion.core.mission.events import Mode, Position
from companion.core.pilot.context import FlightContext

LOST_S = 1.5
"""Troubles shorter than this are one late message."""


@dataclass(slots=True)
class PositionLoss:
    """Since when the position is in doubt, since when it is lost, and where it was last good."""

    doubtful_since_s: float | None = None
    lost_since_s: float | None = None
    last_good: Position | None = None

    @property
    def is_lost(self) -> bool:
        """In doubt for longer than one late message."""
        return self.lost_since_s is not None

    def last_seen(self) -> str:
        """Where the position was last beyond doubt."""
        good = self.last_good
        return "never seen" if good is None else f"last at {good.lat_deg:.5f} {good.lon_deg:.5f}"

    def tick(self, context: FlightContext) -> None:
        """Follow the position in flight, whoever flies."""
        t_s = context.t_s
        troubles = context.telemetry.position_troubles()
        if not troubles:
            self._is_good(context)
            return
        if self.doubtful_since_s is None:
            self.doubtful_since_s = t_s
        if self.lost_since_s is None and t_s - self.doubtful_since_s >= LOST_S:
            self.lost_since_s = self.doubtful_since_s
            context.assessment = None  # what was promised from there holds no longer
            context.say(Severity.CRITICAL, f"position lost: {troubles[0]}")
            context.decide("position_lost", f"{'; '.join(troubles)}; {self.last_seen()}")
        state = context.telemetry.state
        if self.lost_since_s is not None and state is not None and state.mode is Mode.LAND:
            context.say_once(Severity.CRITICAL, f"coming down blind, {self.last_seen()}")

    def _is_good(self, context: FlightContext) -> None:
        self.doubtful_since_s, self.last_good = None, context.telemetry.position
        if self.lost_since_s is not None:
            gone_s = context.t_s - self.lost_since_s
            self.lost_since_s = None
            context.say(Severity.NOTICE, f"position back after {gone_s:.0f} s")
            context.decide("position_back", f"after {gone_s:.0f} s")
