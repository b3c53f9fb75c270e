"""Mission checks, flight and reports of PX4.

Sources: PX4, src/modules/navigator/MissionFeasibility/FeasibilityChecker.cpp, mission_base.cpp;
src/modules/mavlink/mavlink_mission.cpp.
"""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import Goal
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance, leg_heading_rad
from sim_bridge.autopilot.flight.returning import ReturnToLaunch
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.enums import AMSL_FRAMES, Cmd, MissionState, Severity
from sim_bridge.autopilot.mission.executor import Leg, MissionExecutor
from sim_bridge.autopilot.mission.fence import Geofence
from sim_bridge.autopilot.mission.items import (
    NAVIGATION_COMMANDS,
    NO_COORDINATE,
    POSITIONED_COMMANDS,
    MissionItem,
    MissionStore,
)
from sim_bridge.autopilot.mission.plan import Plan
from sim_bridge.autopilot.px4.mission_items import JUMP_UNLIMITED
from sim_bridge.autopilot.px4.payload import Px4Payload
from sim_bridge.autopilot.px4.rules import Px4Rules
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.services.status import mission_current_fields
from sim_bridge.autopilot.state import VehicleState

_NEW_MISSION_AFTER_S = 1.5
"""A mission uploaded in flight takes over after 1 to 2 s (measured)."""
_REACHED_REPEATS = 10


@dataclass(frozen=True, slots=True)
class _PendingSpeed:
    """A speed for the next item; None is the default."""

    mps: float | None


def mission_current_total(item_count: int) -> int:
    """MISSION_CURRENT.total: all items; none at all is 65535."""
    return item_count or 65535


def mission_items_crc32(items: Sequence[MissionItem]) -> int:
    """Compute MISSION_CURRENT.mission_id: a CRC-32 of the stored items, as in PX4 1.15 and later.

    Opaque to receivers: its input differs from PX4's (mavlink_mission.cpp, crc32_for_mission_item).
    0 without a mission.
    """
    return zlib.crc32(repr(list(items)).encode()) if items else 0


@dataclass(slots=True)
class Px4Mission:
    """The mission in flight; `executor` flies it and calls back for PX4's specifics."""

    _state: VehicleState
    _store: MissionStore
    _radio: Radio
    _commander: Commander
    _guidance: Guidance
    _targets: ModeTargets
    _payload: Px4Payload
    _geofence: Geofence
    _rules: Px4Rules
    executor: MissionExecutor = field(init=False)
    _feasibility_problem: str | None = None
    _pending_speed: _PendingSpeed | None = None
    _known_seq: int | None = None
    _reached_seq: int | None = None
    _reached_left: int = 0
    _reached_next_s: float = 0.0
    _ended_in_air: bool = False
    _switch_due_s: float | None = None

    def __post_init__(self) -> None:
        self.executor = MissionExecutor(
            self._state,
            self._guidance,
            self,
            Plan(first=0, unlimited_repeats=JUMP_UNLIMITED),
            sequential=True,
        )

    # --- the stored mission -------------------------------------------------------------------

    @property
    def has_flyable_mission(self) -> bool:
        """Return True if MISSION mode has something to fly."""
        return not self.executor.plan.is_empty and self._feasibility_problem is None

    def can_clear_mission(self) -> bool:
        """Return True: PX4 accepts it at any time."""
        return True

    def on_mission_changed(self, *, is_complete_list: bool) -> None:
        """A new mission takes over as a whole; while one is flown, after a while."""
        state = self._state
        if state.is_armed and state.mode is Mode.AUTO and self._store.mission:
            self._switch_due_s = state.t_s + _NEW_MISSION_AFTER_S
        else:
            self._load_stored_mission()

    def discard_pending_mission(self) -> None:
        """Discard the pending new mission after a reboot."""
        self._switch_due_s = None

    def activate_pending_mission_if_due(self) -> None:
        """Take over a mission that was uploaded in flight."""
        if self._switch_due_s is not None and self._state.t_s >= self._switch_due_s:
            self._switch_due_s = None
            self._load_stored_mission()

    def _load_stored_mission(self) -> None:
        """Fly the stored mission from now on: at the same index, or at the item marked current."""
        executor = self.executor
        self._clear_reached_report()
        executor.load_items(self._store.mission)
        marked = self._store.marked_current
        if marked is not None and marked < len(executor.plan):
            executor.index = marked
        self._feasibility_problem = self._infeasibility_reason()
        if self._feasibility_problem is not None and not executor.plan.is_empty:
            self._radio.send_status_text(Severity.CRITICAL, self._feasibility_problem)
        if self._state.mode is not Mode.AUTO or not self._state.is_armed:
            return
        if self.has_flyable_mission:
            executor.jump_to_item(executor.index)
        else:
            self._radio.send_status_text(Severity.CRITICAL, "No valid mission available, loitering")
            self._commander.set_mode(Mode.HOLD)

    def start_mission_or_hold(self) -> None:
        """MISSION mode begins, armed."""
        executor = self.executor
        if executor.state == MissionState.COMPLETE and self._state.is_landed:
            executor.reset_to_first_item()
            self._clear_reached_report()
        self._feasibility_problem = self._infeasibility_reason()
        if not self.has_flyable_mission:
            self._radio.send_status_text(
                Severity.CRITICAL, "No valid mission available, refusing takeoff"
            )
            self._commander.set_mode(Mode.HOLD)
            return
        self._radio.send_status_text(Severity.INFO, "Executing Mission")
        # Speed commands in front of the item are replayed, in the order of storage.
        self._guidance.speed_override_mps = executor.plan.last_speed_command_before_mps(
            executor.index
        )
        executor.activate_at_current_item()

    def command_companions_at_mode_exit(self) -> None:
        """End MISSION mode: command cameras and gimbals to stop; companions receive it too."""
        self._radio.send_command_to_companions(Cmd.DO_TRIGGER_CONTROL, 0.0, 1.0, -1.0)
        if not self._state.is_landed:
            self._radio.send_command_to_companions(
                Cmd.DO_GIMBAL_MANAGER_CONFIGURE, -3.0, -3.0, -1.0, -1.0
            )
            self._radio.send_command_to_companions(
                Cmd.DO_GIMBAL_MANAGER_PITCHYAW, math.nan, 0.0, math.nan, math.nan
            )

    def jump_to_item(self, seq: int) -> None:
        """Handle MISSION_SET_CURRENT as a jump; the next 1 Hz MISSION_CURRENT reports it.

        mavlink_mission.cpp, send: the new number is already known there, so it is no change.
        """
        known, self._known_seq = self._known_seq, seq
        self._clear_reached_report()
        if not self.executor.jump_to_item(seq):
            self._known_seq = known
            self._radio.send_status_text(Severity.CRITICAL, "WPM: WP CURR CMD: Not in list")

    def hold_after_mission_end_in_air(self) -> None:
        """Leave MISSION mode after the end of a mission in the air."""
        if self._ended_in_air:
            self._ended_in_air = False
            if self._state.mode is Mode.AUTO and not self._state.is_landed:
                self._commander.set_mode(Mode.HOLD)

    def resend_item_reached_if_due(self) -> None:
        """MISSION_ITEM_REACHED is sent ten more times, at 1 Hz."""
        if self._reached_left > 0 and self._state.t_s >= self._reached_next_s:
            self._reached_left -= 1
            self._reached_next_s = self._state.t_s + 1.0
            self._radio.send_on_all_links("MISSION_ITEM_REACHED", seq=self._reached_seq)

    # --- MissionHooks -------------------------------------------------------------------------

    def can_take_off(self) -> bool:
        """Armed is enough."""
        return True

    def on_item_start(self, item: MissionItem, seq: int) -> None:
        """MISSION_CURRENT at each change."""
        if self._pending_speed is not None:
            self._guidance.speed_override_mps = self._pending_speed.mps
            self._pending_speed = None
        if seq != self._known_seq:
            self._known_seq = seq
            self._send_mission_current()

    def on_item_reached(self, seq: int) -> None:
        """MISSION_ITEM_REACHED, repeated later; the same item again is not reported."""
        if seq == self._reached_seq:
            return
        self._radio.send_on_all_links("MISSION_ITEM_REACHED", seq=seq)
        self._reached_seq, self._reached_left = seq, _REACHED_REPEATS
        self._reached_next_s = self._state.t_s + 1.0

    def on_mission_end(self) -> None:
        """On the ground it stays in MISSION; in the air it changes to HOLD.

        Commander.cpp: to AUTO_LOITER when the mission is finished, unless landed.
        """
        self._send_mission_current()
        where = "landed" if self._state.is_landed else "loitering"
        self._radio.send_status_text(Severity.INFO, f"Mission finished, {where}")
        self._ended_in_air = not self._state.is_landed

    def item_position_ned_m(self, item: MissionItem) -> Vec3:
        """INT32_MAX and NaN mean here, and this altitude."""
        state = self._state
        north, east, down = state.pos_ned_m
        if item.command in POSITIONED_COMMANDS and NO_COORDINATE not in (item.x, item.y):
            north, east = state.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        if math.isfinite(item.z):
            if item.frame in AMSL_FRAMES:
                down = state.frame.alt_amsl_m - item.z
            else:
                down = state.home_ned_m[2] - item.z
        return north, east, down

    def run_non_navigation_item_and_return_wait_s(self, item: MissionItem) -> float:
        """Run items without a position; a gripper item always lasts MIS_COMMAND_TOUT."""
        match item.command:
            case Cmd.DO_CHANGE_SPEED:
                kind = int(item.param1) if math.isfinite(item.param1) else -1
                self.set_speed_now_or_at_next_item(kind, item.param2)
            case Cmd.DO_GRIPPER:
                action = item.param2
                if self._payload.has_gripper and action in (0.0, 1.0):
                    self._payload.set_gripper(int(action))
                return max(self._state.params["MIS_COMMAND_TOUT"], 0.0)
            case Cmd.DO_SET_ACTUATOR:
                self._payload.set_release_by_actuator_value(item.param1)
            case Cmd.NAV_RETURN_TO_LAUNCH:
                self._commander.set_mode(Mode.RTL)
            case _:
                pass
        return 0.0

    def set_speed_now_or_at_next_item(self, speed_type: int, speed_mps: float) -> None:
        """Ground speed (type 1) at once; other types, and the default (0 or less), next item.

        Flown: 2 m/s in a leg, then -1 and 0, went on at 2 m/s on that leg (conform: speed/none).
        """
        guidance = self._guidance
        if not speed_mps > 0.0:
            self._pending_speed = _PendingSpeed(None)
            if self._state.mode is not Mode.AUTO:
                guidance.speed_override_mps = None
        elif speed_type == 1:
            guidance.speed_override_mps = speed_mps
            self._pending_speed = None
        else:
            self._pending_speed = _PendingSpeed(speed_mps)

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
        """PX4 refuses such an item at its upload."""
        return None

    # --- parts --------------------------------------------------------------------------------

    def _send_mission_current(self) -> None:
        total = mission_current_total(len(self.executor.plan))
        fields = mission_current_fields(
            self.executor, total, mission_items_crc32(self._store.mission)
        )
        self._radio.send_on_all_links("MISSION_CURRENT", **fields)

    def _clear_reached_report(self) -> None:
        self._reached_seq, self._reached_left = None, 0

    def _infeasibility_reason(self) -> str | None:
        """The first reason not to fly the loaded mission; a mission is stored in any case."""
        state, plan = self._state, self.executor.plan
        is_first = True
        home = state.home_ned_m
        for number, item in enumerate(plan.items):
            has_position = (
                item.command in POSITIONED_COMMANDS and item.command in NAVIGATION_COMMANDS
            )
            if not has_position or NO_COORDINATE in (item.x, item.y):
                continue
            north, east = state.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
            down = home[2] - item.z
            if item.frame in AMSL_FRAMES:
                down = state.frame.alt_amsl_m - item.z
            height = home[2] - down
            if is_first and state.home_is_set:
                is_first = False
                far = math.dist((north, east), home[:2])
                if 0.0 < state.params["MIS_DIST_1WP"] < far:
                    return f"First waypoint far away from home: {far:.0f} m"
            if item.command == Cmd.NAV_TAKEOFF and height < state.params["NAV_MC_ALT_RAD"]:
                return "Mission rejected: Takeoff altitude too low!"
            height = height if math.isfinite(height) else 0.0
            fence = self._geofence.fence
            if fence.breach_at((north, east), (home[0], home[1]), height) is not None:
                return f"Geofence violation for waypoint {number + 1}"
        for number, item in enumerate(plan.items):
            if item.command == Cmd.DO_JUMP:
                target = int(item.param1)
                if not 0 <= target < len(plan):
                    return f"Mission rejected: DO JUMP {number} to nowhere"
        return None
