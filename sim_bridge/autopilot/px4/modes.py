"""What each of PX4's modes makes the vehicle fly.

Sources: PX4, src/modules/navigator (takeoff.cpp, loiter.cpp, rtl.cpp), flight_mode_manager.
"""

import math

from sim_bridge.autopilot.base.geodesy import Vec3, distance_ne_m
from sim_bridge.autopilot.base.goals import Descend, FollowLine, Goal, HoldPoint, Idle
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance, heading_along
from sim_bridge.autopilot.flight.piloted import level_descent, piloted_goal
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.px4.guided import Px4Guided
from sim_bridge.autopilot.px4.mission import Px4Mission
from sim_bridge.autopilot.state import VehicleState


class Px4Modes:
    """The modes' goals, and what they keep from step to step."""

    def __init__(
        self,
        state: VehicleState,
        commander: Commander,
        guidance: Guidance,
        targets: ModeTargets,
        rc: RcInput,
        mission: Px4Mission,
        guided: Px4Guided,
    ) -> None:
        self._state = state
        self._commander = commander
        self._guidance = guidance
        self._targets = targets
        self._rc = rc
        self._mission = mission
        self._guided = guided
        self._leg_start: Vec3 | None = None
        self._hold_yaw: float | None = None

    def entered(self, mode: Mode) -> None:
        """Start a mode afresh."""
        self._targets.clear()
        self._leg_start = None
        self._hold_yaw = None
        if mode is Mode.TAKEOFF:
            self.take_off_to(math.nan)
        elif mode is Mode.RTL and self._state.is_armed:
            self._guidance.speed_override_mps = None
            self._targets.returning = self._mission.plan_return()

    def goal(self) -> Goal:
        """What the mode asks for now (only called while armed)."""
        state, params = self._state, self._state.params
        match state.mode:
            case Mode.AUTO:
                return self._mission.executor.step()
            case Mode.TAKEOFF:
                return self._takeoff()
            case Mode.GUIDED:
                return self._guided.goal()
            case Mode.RTL:
                return self._rtl()
            case Mode.LAND:
                return self._land()
            case Mode.DESCEND:
                return Idle() if state.is_landed else level_descent(params["MPC_LAND_SPEED"])
            case Mode.HOLD:
                return self._hold()
            case _:
                speed, climb = params["MPC_VEL_MANUAL"], params["MPC_Z_VEL_MAX_UP"]
                return piloted_goal(state, self._targets, self._rc, speed, climb)

    def _hold(self) -> Goal:
        state = self._state
        here = state.pos_ned_m
        if state.is_landed:
            return Idle()
        point = self._targets.hold_here()
        start = self._leg_start
        if start is None:
            return HoldPoint(point, self._hold_yaw)
        if distance_ne_m(here, point) < 1.0 and abs(here[2] - point[2]) < 0.5:
            self._leg_start = None
        cruise = self._guidance.cruise_mps(state.rules.default_speed_mps)
        return FollowLine(start, point, cruise, 0.0, self._hold_yaw)

    def go_to(self, place: Vec3, yaw_rad: float | None) -> None:
        """DO_REPOSITION, in HOLD."""
        here = self._state.pos_ned_m
        self._targets.hold_point = place
        self._leg_start = here
        self._hold_yaw = yaw_rad if yaw_rad is not None else heading_along(here, place)

    def take_off_to(self, alt_amsl_m: float) -> float:
        """The altitude to take off to, as down; at least MIS_TAKEOFF_ALT above home."""
        state = self._state
        down = least = state.home_ned_m[2] - state.params["MIS_TAKEOFF_ALT"]
        if math.isfinite(alt_amsl_m):
            down = min(state.frame.alt_amsl_m - alt_amsl_m, least)
        self._targets.takeoff_down_m = down
        return down

    def _takeoff(self) -> Goal:
        state, targets = self._state, self._targets
        down = targets.takeoff_down_m
        if down is None:
            down = self.take_off_to(math.nan)
        waits = state.is_landed and not state.is_spooled
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

    def _rtl(self) -> Goal:
        if self._state.is_landed:
            return Idle()
        if self._targets.returning is None:
            self._targets.returning = self._mission.plan_return()
        return self._targets.returning.step(self._state, self._mission.sink_mps) or Idle()

    def _land(self) -> Goal:
        if self._state.is_landed:
            return Idle()
        north, east, _ = self._targets.hold_here()
        return Descend((north, east), self._mission.sink_mps(self._state.height_above_home_m))
