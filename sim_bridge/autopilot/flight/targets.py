"""Targets of the current flight mode; the modes of each autopilot own one instance."""

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import Setpoint
from sim_bridge.autopilot.flight.guidance import Guidance
from sim_bridge.autopilot.flight.returning import ReturnToLaunch


class ModeTargets:
    """Hold point, take-off height, set-point, and the return in progress."""

    def __init__(self, guidance: Guidance) -> None:
        self._guidance = guidance
        self.setpoint: Setpoint | None = None
        self.clear_except_setpoint()

    def clear_except_setpoint(self) -> None:
        """Clear the targets of the previous mode, except the set-point."""
        self.hold_point: Vec3 | None = None
        self.takeoff_down_m: float | None = None
        self.returning: ReturnToLaunch | None = None

    def reset_targets_for_guided_item(self) -> None:
        """Start to follow set-points for a mission item; earlier set-points are void."""
        self.setpoint = None
        self.hold_point = None
        self.takeoff_down_m = None

    def hold_point_or_store_stopping_point(self) -> Vec3:
        """The point that a holding mode keeps: where the vehicle came to rest on its entry."""
        if self.hold_point is None:
            self.hold_point = self._guidance.predicted_stopping_point_ned_m()
        return self.hold_point
