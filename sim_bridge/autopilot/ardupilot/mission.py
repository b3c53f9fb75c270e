"""Mission checks, flight and reports of ArduCopter.

Sources: ArduPilot, libraries/AP_Mission/AP_Mission.cpp; ArduCopter/mode_auto.cpp.
"""

import math
from dataclasses import dataclass, field, replace

from sim_bridge.autopilot.ardupilot.guided import ArduPilotGuided
from sim_bridge.autopilot.ardupilot.payload import ArduPilotPayload
from sim_bridge.autopilot.ardupilot.rules import ArduPilotRules
from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import Goal
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance, leg_heading_rad
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.returning import ReturnToLaunch
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.enums import AMSL_FRAMES, Cmd, MissionState, Severity
from sim_bridge.autopilot.mission.executor import Leg, MissionExecutor
from sim_bridge.autopilot.mission.items import MissionItem, MissionStore
from sim_bridge.autopilot.mission.plan import Plan
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState

_TAKE_OFF_WITHOUT_THROTTLE = 2
"""Bit of AUTO_OPTIONS."""
_JUMP_UNLIMITED = -1
_NAMES = {
    Cmd.NAV_WAYPOINT: "WP",
    Cmd.NAV_LOITER_UNLIM: "LoitUnlim",
    Cmd.NAV_LOITER_TIME: "LoitTime",
    Cmd.NAV_RETURN_TO_LAUNCH: "RTL",
    Cmd.NAV_LAND: "Land",
    Cmd.NAV_TAKEOFF: "Takeoff",
    Cmd.NAV_DELAY: "Delay",
    Cmd.CONDITION_DELAY: "CondDelay",
    Cmd.CONDITION_YAW: "CondYaw",
    Cmd.DO_CHANGE_SPEED: "ChangeSpeed",
    Cmd.DO_GRIPPER: "Gripper",
    Cmd.DO_SET_SERVO: "SetServo",
    Cmd.NAV_GUIDED_ENABLE: "GuidedEnable",
    Cmd.DO_GUIDED_LIMITS: "GuidedLimits",
}


@dataclass(slots=True)
class ArduPilotMission:
    """The mission in flight; `executor` flies it and calls back for ArduCopter's specifics."""

    _state: VehicleState
    _store: MissionStore
    _radio: Radio
    _commander: Commander
    _guidance: Guidance
    _targets: ModeTargets
    _rc: RcInput
    _payload: ArduPilotPayload
    _guided: ArduPilotGuided
    _rules: ArduPilotRules
    _take_off_allowed: bool = False
    executor: MissionExecutor = field(init=False)

    def __post_init__(self) -> None:
        self.executor = MissionExecutor(
            self._state,
            self._guidance,
            self,
            Plan(first=1, unlimited_repeats=_JUMP_UNLIMITED),
            sequential=False,
        )

    # --- the stored mission -------------------------------------------------------------------

    def on_mission_changed(self, *, is_complete_list: bool) -> None:
        """Apply changes to the flown mission immediately: they are not atomic."""
        executor = self.executor
        executor.load_items(self._store.mission, keep_jump_counters=not is_complete_list)
        if not self._state.is_armed and is_complete_list:
            executor.reset_to_first_item()
        elif executor.is_active and executor.is_moving_or_loitering:
            if executor.restart_current_item_if_active():
                text = "Auto mission changed, restarted command"
            else:
                text = "Auto mission changed but failed to restart command"
            self._radio.send_status_text(Severity.CRITICAL, text)

    def can_clear_mission(self) -> bool:
        """Return False while the mission is flown."""
        executor = self.executor
        is_flown = executor.is_active and executor.state == MissionState.ACTIVE
        return not (self._state.is_armed and is_flown)

    # --- taking off ---------------------------------------------------------------------------

    def allow_takeoff_without_throttle(self) -> None:
        """Ignore the throttle stick after a take-off command or in flight."""
        self._take_off_allowed = True

    def require_throttle_for_takeoff(self) -> None:
        """Require the throttle stick again after arming and disarming."""
        self._take_off_allowed = False

    def can_take_off(self) -> bool:
        """Commanded, by option, or by a raised throttle."""
        options = int(self._state.params["AUTO_OPTIONS"])
        if self._take_off_allowed or options & _TAKE_OFF_WITHOUT_THROTTLE:
            return True
        sticks = self._rc.stick_positions()
        return sticks is not None and sticks.throttle > 0.1

    # --- MissionHooks -------------------------------------------------------------------------

    def on_item_start(self, item: MissionItem, seq: int) -> None:
        """Each item is announced by its name."""
        name = _NAMES.get(Cmd(item.command), "Do")
        self._radio.send_status_text(Severity.INFO, f"Mission: {seq} {name}")

    def on_item_reached(self, seq: int) -> None:
        """MISSION_ITEM_REACHED to every link."""
        plan = self.executor.plan
        self._radio.send_on_all_links("MISSION_ITEM_REACHED", seq=seq)
        if seq < len(plan) and plan.items[seq].command == Cmd.NAV_WAYPOINT:
            self._radio.send_status_text(Severity.INFO, f"Reached command #{seq}")

    def on_mission_end(self) -> None:
        """On the ground it disarms, in the air it loiters."""
        if self._state.is_landed:
            self._commander.disarm()

    def item_position_ned_m(self, item: MissionItem) -> Vec3:
        """Return an item's position; the current one replaces an omitted position or altitude."""
        state = self._state
        north, east, down = state.pos_ned_m
        if item.x or item.y:
            north, east = state.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        if item.z == 0.0 and item.command != Cmd.NAV_LAND:
            return north, east, down
        if item.frame in AMSL_FRAMES:
            return north, east, state.frame.alt_amsl_m - item.z
        return north, east, state.home_ned_m[2] - item.z

    def run_non_navigation_item_and_return_wait_s(self, item: MissionItem) -> float:
        """Items that do not navigate; only CONDITION_DELAY makes the next one wait."""
        match item.command:
            case Cmd.DO_CHANGE_SPEED:
                if item.param2 > 0.0:
                    self.override_speed_by_type(int(item.param1), item.param2)
            case Cmd.DO_GRIPPER:
                self._payload.start_gripper_action_if_fitted(int(item.param2))
            case Cmd.DO_SET_SERVO:
                self._payload.set_servo_and_release_output(int(item.param1), int(item.param2))
            case Cmd.CONDITION_YAW:
                self.set_fixed_yaw(item.param1, item.param3, is_relative=item.param4 == 1.0)
            case Cmd.DO_GUIDED_LIMITS:
                self._guided.set_guided_limits(item.param1, item.param2, item.param3, item.param4)
            case Cmd.CONDITION_DELAY:
                return max(item.param1, 0.0)
            case Cmd.DO_SET_HOME:
                position_ned_m = (
                    self._state.pos_ned_m if item.param1 == 1.0 else self.item_position_ned_m(item)
                )
                self._commander.set_home(position_ned_m, keep_when_arming=True)
            case Cmd.DO_FENCE_ENABLE:
                self._state.params.set("FENCE_ENABLE", 1.0 if item.param1 == 1.0 else 0.0)
            case _:
                pass
        return 0.0

    def override_speed_by_type(self, speed_type: int, speed_mps: float) -> None:
        """Ground speed for types 0 and 1; 2 and 3 are climb and descent."""
        if speed_type in (0, 1):
            self._guidance.speed_override_mps = max(speed_mps, 0.2)
            return
        limits = self._rules.controller_limits(self._state.params)
        if speed_type == 2:
            limits = replace(limits, up_mps=speed_mps)
        elif speed_type == 3:
            limits = replace(limits, down_mps=speed_mps)
        self._guidance.set_limits(limits)

    def set_fixed_yaw(self, angle_deg: float, direction_sign: float, *, is_relative: bool) -> None:
        """CONDITION_YAW: a heading until the mode ends."""
        angle = math.radians(angle_deg)
        if is_relative:
            angle = self._guidance.yaw_sp_rad + (-angle if direction_sign < 0.0 else angle)
        self._guidance.fixed_yaw_rad = angle

    def landing_descent_speed_mps(self, height_above_home_m: float) -> float:
        """Descent speed of a landing at a height above home."""
        return self._rules.landing_descent_speed_mps(self._state.params, height_above_home_m)

    def leg_yaw_rad(self, start: Vec3, end: Vec3) -> float | None:
        """Heading to fly a leg with."""
        return (
            leg_heading_rad(start, end)
            if self._rules.is_nose_pointed_along_leg(self._state.params)
            else None
        )

    def plan_return_to_launch(self) -> ReturnToLaunch:
        """A return to launch from here."""
        state = self._state
        return ReturnToLaunch(
            self._rules.return_to_launch_plan(state, self._store), state.pos_ned_m
        )

    def start_following_setpoints(self) -> None:
        """Set-points are followed from now on; earlier ones are void."""
        self._targets.reset_targets_for_guided_item()

    def guided_item_goal(self, leg: Leg) -> Goal | None:
        """Return the goal of set-points; None when one of their limits is exceeded."""
        return self._guided.guided_goal_within_limits(leg)
