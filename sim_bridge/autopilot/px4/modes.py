"""Flight goals of PX4's modes.

Sources: PX4, src/modules/navigator (takeoff.cpp, loiter.cpp, rtl.cpp), flight_mode_manager.
"""

import math
from dataclasses import dataclass

from sim_bridge.autopilot.base.geodesy import Vec3, horizontal_distance_m
from sim_bridge.autopilot.base.goals import Descend, FollowLine, Goal, HoldPoint, Idle
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance, leg_heading_rad
from sim_bridge.autopilot.flight.piloted import level_descent_goal, stick_flight_goal
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.px4.guided import Px4Guided
from sim_bridge.autopilot.px4.mission import Px4Mission
from sim_bridge.autopilot.state import VehicleState


@dataclass(slots=True)
class Px4Modes:
    """Goals of the modes, and their state between steps."""

    _state: VehicleState
    _commander: Commander
    _guidance: Guidance
    _targets: ModeTargets
    _rc: RcInput
    _mission: Px4Mission
    _guided: Px4Guided
    _leg_start: Vec3 | None = None
    _hold_yaw: float | None = None

    def on_mode_entry(self, mode: Mode) -> None:
        """Initialise a mode on entry."""
        self._targets.clear_except_setpoint()
        self._leg_start = None
        self._hold_yaw = None
        if mode is Mode.TAKEOFF:
            self.store_takeoff_height_as_down_m(math.nan)
        elif mode is Mode.RTL and self._state.is_armed:
            self._guidance.speed_override_mps = None
            self._targets.returning = self._mission.plan_return_to_launch()

    def advance_mode_and_return_goal(self) -> Goal:
        """Return the goal of the current mode (called only while armed)."""
        state, params = self._state, self._state.params
        match state.mode:
            case Mode.AUTO:
                return self._mission.executor.advance_and_return_goal()
            case Mode.TAKEOFF:
                return self._takeoff_goal_or_switch_to_hold()
            case Mode.GUIDED:
                return self._guided.setpoint_goal_or_handle_loss()
            case Mode.RTL:
                return self._rtl_goal()
            case Mode.LAND:
                return self._land_goal()
            case Mode.DESCEND:
                return Idle() if state.is_landed else level_descent_goal(params["MPC_LAND_SPEED"])
            case Mode.HOLD:
                return self._hold_goal()
            case _:
                speed, climb = params["MPC_VEL_MANUAL"], params["MPC_Z_VEL_MAX_UP"]
                return stick_flight_goal(state, self._targets, self._rc, speed, climb)

    def _hold_goal(self) -> Goal:
        state = self._state
        here = state.pos_ned_m
        if state.is_landed:
            return Idle()
        point = self._targets.hold_point_or_store_stopping_point()
        start = self._leg_start
        if start is None:
            return HoldPoint(point, self._hold_yaw)
        if horizontal_distance_m(here, point) < 1.0 and abs(here[2] - point[2]) < 0.5:
            self._leg_start = None
        cruise = self._guidance.cruise_ground_speed_mps(state.rules.default_speed_mps)
        return FollowLine(start, point, cruise, 0.0, self._hold_yaw)

    def start_hold_reposition(self, position_ned_m: Vec3, yaw_rad: float | None) -> None:
        """DO_REPOSITION, in HOLD."""
        here = self._state.pos_ned_m
        self._targets.hold_point = position_ned_m
        self._leg_start = here
        self._hold_yaw = yaw_rad if yaw_rad is not None else leg_heading_rad(here, position_ned_m)

    def store_takeoff_height_as_down_m(self, alt_amsl_m: float) -> float:
        """The altitude to take off to, as down; at least MIS_TAKEOFF_ALT above home."""
        state = self._state
        down = least = state.home_ned_m[2] - state.params["MIS_TAKEOFF_ALT"]
        if math.isfinite(alt_amsl_m):
            down = min(state.frame.alt_amsl_m - alt_amsl_m, least)
        self._targets.takeoff_down_m = down
        return down

    def _takeoff_goal_or_switch_to_hold(self) -> Goal:
        state, targets = self._state, self._targets
        down = targets.takeoff_down_m
        if down is None:
            down = self.store_takeoff_height_as_down_m(math.nan)
        waits = state.is_landed and not state.are_motors_spooled_up
        if targets.hold_point is None or waits:
            targets.hold_point = state.pos_ned_m
        if waits:
            return Idle()
        north, east, start_down = targets.hold_point
        top = (north, east, min(down, start_down))
        if state.pos_ned_m[2] - top[2] > 0.5:
            return FollowLine((north, east, start_down), top, state.rules.takeoff_speed_mps)
        self._commander.set_mode(Mode.HOLD)
        targets.hold_point = top
        return HoldPoint(top)

    def _rtl_goal(self) -> Goal:
        if self._state.is_landed:
            return Idle()
        if self._targets.returning is None:
            self._targets.returning = self._mission.plan_return_to_launch()
        return (
            self._targets.returning.update_phase_and_return_goal(
                self._state, self._mission.landing_descent_speed_mps
            )
            or Idle()
        )

    def _land_goal(self) -> Goal:
        if self._state.is_landed:
            return Idle()
        north, east, _ = self._targets.hold_point_or_store_stopping_point()
        return Descend(
            (north, east), self._mission.landing_descent_speed_mps(self._state.height_above_home_m)
        )
