"""GUIDED: flight by external set-points (ArduCopter/mode_guided.cpp)."""

from sim_bridge.autopilot.ardupilot.rules import ArduPilotRules
from sim_bridge.autopilot.base.geodesy import Vec3, horizontal_distance_m
from sim_bridge.autopilot.base.goals import FlyVelocity, FollowLine, Goal, HoldPoint, Idle, Setpoint
from sim_bridge.autopilot.flight.guidance import Guidance, leg_heading_rad
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mission.executor import Leg
from sim_bridge.autopilot.state import VehicleState

_NO_LIMITS = (0.0, 0.0, 0.0, 0.0)


class ArduPilotGuided:
    """Target of the latest set-point or take-off command, and the limits on set-points."""

    def __init__(
        self,
        state: VehicleState,
        guidance: Guidance,
        targets: ModeTargets,
        rules: ArduPilotRules,
    ) -> None:
        self._state = state
        self._guidance = guidance
        self._targets = targets
        self._rules = rules
        self._leg_start: Vec3 | None = None
        self._limits = _NO_LIMITS

    def discard_setpoint(self) -> None:
        """Earlier set-points are void in every new mode."""
        self._targets.setpoint = None
        self._leg_start = None

    def start_flight_to_setpoint(self, setpoint: Setpoint) -> None:
        """Fly to a set-point from here."""
        self._targets.setpoint = setpoint
        self._targets.hold_point = None
        self._leg_start = self._state.pos_ned_m

    def start_takeoff_to_height(self, height_above_home_m: float) -> None:
        """Climb to a height above home."""
        self._targets.takeoff_down_m = self._state.home_ned_m[2] - height_above_home_m
        self._targets.hold_point = None
        self._targets.setpoint = None

    def set_guided_limits(
        self, max_duration_s: float, min_height_m: float, max_height_m: float, max_distance_m: float
    ) -> None:
        """DO_GUIDED_LIMITS: seconds, heights above home, metres from the start; 0 is no limit."""
        self._limits = (max_duration_s, min_height_m, max_height_m, max_distance_m)

    def clear_guided_limits(self) -> None:
        """A mission starts without limits."""
        self._limits = _NO_LIMITS

    def update_and_return_guided_goal(self) -> Goal:
        """Return the goal in GUIDED."""
        state, targets = self._state, self._targets
        if targets.takeoff_down_m is not None:
            return self._update_and_return_takeoff_goal(targets.takeoff_down_m)
        if state.is_landed:
            return Idle()
        setpoint = targets.setpoint
        if setpoint is None:
            return HoldPoint(targets.hold_point_or_store_stopping_point())
        if setpoint.vel_ned_mps is not None and setpoint.pos_ned_m is None:
            if state.t_s - setpoint.t_s > max(state.params["GUID_TIMEOUT"], 0.1):
                targets.setpoint = None  # stops, and stays in GUIDED
                return HoldPoint(targets.hold_point_or_store_stopping_point())
            return FlyVelocity(
                setpoint.vel_ned_mps,
                setpoint.yaw_rad,
                setpoint.yaw_rate_rps,
                setpoint.accel_ned_mps2,
            )
        assert setpoint.pos_ned_m is not None
        start = self._leg_start or state.pos_ned_m
        yaw = setpoint.yaw_rad
        if yaw is None and self._rules.is_nose_pointed_along_leg(state.params):
            yaw = leg_heading_rad(start, setpoint.pos_ned_m)
        cruise = self._guidance.cruise_ground_speed_mps(state.rules.default_speed_mps)
        return FollowLine(start, setpoint.pos_ned_m, cruise, 0.0, yaw)

    def _update_and_return_takeoff_goal(self, top_down_m: float) -> Goal:
        state, targets = self._state, self._targets
        waits = state.is_landed and not state.are_motors_spooled_up
        if targets.hold_point is None or waits:
            targets.hold_point = state.pos_ned_m
        north, east, start_down = targets.hold_point
        if waits:
            return Idle()
        top = (north, east, top_down_m)
        if abs(state.pos_ned_m[2] - top_down_m) < 0.5:
            targets.takeoff_down_m = None
            targets.hold_point = top
            return HoldPoint(top)
        return FollowLine((north, east, start_down), top, state.rules.takeoff_speed_mps)

    def guided_goal_within_limits(self, leg: Leg) -> Goal | None:
        """NAV_GUIDED_ENABLE: set-points until a limit is passed (ModeGuided::limit_check)."""
        state = self._state
        if leg.item.param1 <= 0.0:
            return None
        for_s, low_m, high_m, away_m = self._limits
        height_m = state.height_above_home_m
        passed = (
            (for_s > 0.0 and state.t_s - leg.since_s >= for_s)
            or (low_m != 0.0 and height_m < low_m)
            or (high_m != 0.0 and height_m > high_m)
            or (away_m > 0.0 and horizontal_distance_m(state.pos_ned_m, leg.start) > away_m)
        )
        return None if passed else self.update_and_return_guided_goal()
