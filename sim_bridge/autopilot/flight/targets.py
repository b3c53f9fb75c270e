"""What the present flight mode has set out to do; each autopilot's modes own one of these."""

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import Setpoint
from sim_bridge.autopilot.flight.guidance import Guidance
from sim_bridge.autopilot.flight.returning import Returning


class ModeTargets:
    """The point to hold, the height to take off to, the set-point, the return under way."""

    def __init__(self, guidance: Guidance) -> None:
        self._guidance = guidance
        self.setpoint: Setpoint | None = None
        self.clear()

    def clear(self) -> None:
        """A mode is entered: nothing of the mode before remains but the set-point."""
        self.hold_point: Vec3 | None = None
        self.takeoff_down_m: float | None = None
        self.returning: Returning | None = None

    def begin_guided(self) -> None:
        """Set-points are followed from now on, as a mission item says; earlier ones are void."""
        self.setpoint = None
        self.hold_point = None
        self.takeoff_down_m = None

    def hold_here(self) -> Vec3:
        """The point that a holding mode keeps: where the vehicle came to rest on its entry."""
        if self.hold_point is None:
            self.hold_point = self._guidance.stopping_point()
        return self.hold_point
