"""How PX4 checks, flies and reports missions.

Sources: PX4, src/modules/navigator/MissionFeasibility/FeasibilityChecker.cpp, mission_base.cpp;
src/modules/mavlink/mavlink_mission.cpp.
"""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import Goal
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance, heading_along
from sim_bridge.autopilot.flight.returning import Returning
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.enums import AMSL_FRAMES, Cmd, MissionState, Severity
from sim_bridge.autopilot.mission.executor import Leg, MissionExecutor
from sim_bridge.autopilot.mission.fence import Geofence
from sim_bridge.autopilot.mission.items import (
    NAVIGATING,
    NO_COORDINATE,
    PLACED,
    MissionItem,
    MissionStore,
)
from sim_bridge.autopilot.mission.plan import Plan
from sim_bridge.autopilot.px4.mission_items import JUMP_FOREVER
from sim_bridge.autopilot.px4.payload import Px4Payload
from sim_bridge.autopilot.px4.rules import Px4Rules
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.services.status import mission_current
from sim_bridge.autopilot.state import VehicleState

_NEW_MISSION_AFTER_S = 1.5
"""A mission uploaded in flight takes over after 1 to 2 s (measured)."""
_REACHED_AGAIN = 10


@dataclass(frozen=True, slots=True)
class _Speed:
    """A speed for the next item; None is the default."""

    mps: float | None


def mission_total(count: int) -> int:
    """MISSION_CURRENT.total: all items; none at all is 65535."""
    return count or 65535


def mission_id(items: Sequence[MissionItem]) -> int:
    """MISSION_CURRENT.mission_id: a CRC-32 of the stored items, as PX4 1.15 and later send it.

    Opaque to everybody else: what it is made of differs from PX4's (mavlink_mission.cpp,
    crc32_for_mission_item). 0 without a mission.
    """
    return zlib.crc32(repr(list(items)).encode()) if items else 0


class Px4Mission:
    """The mission in flight; `executor` flies it and asks here for what is PX4's own."""

    def __init__(
        self,
        state: VehicleState,
        store: MissionStore,
        radio: Radio,
        commander: Commander,
        guidance: Guidance,
        targets: ModeTargets,
        payload: Px4Payload,
        geofence: Geofence,
        rules: Px4Rules,
    ) -> None:
        self._state = state
        self._store = store
        self._radio = radio
        self._commander = commander
        self._guidance = guidance
        self._targets = targets
        self._payload = payload
        self._geofence = geofence
        self._rules = rules
        self.executor = MissionExecutor(
            state, guidance, self, Plan(first=0, forever=JUMP_FOREVER), sequential=True
        )
        self._problem: str | None = None
        self._pending_speed: _Speed | None = None
        self._known_seq: int | None = None
        self._reached_seq: int | None = None
        self._reached_left = 0
        self._reached_next_s = 0.0
        self._ended_in_air = False
        self._switch_due_s: float | None = None

    # --- the stored mission -------------------------------------------------------------------

    @property
    def is_valid(self) -> bool:
        """Whether MISSION mode has something to fly."""
        return not self.executor.plan.is_empty and self._problem is None

    def may_clear_mission(self) -> bool:
        """At any time."""
        return True

    def mission_written(self, *, whole: bool) -> None:
        """A new mission takes over as a whole; while one is flown, after a while."""
        state = self._state
        if state.is_armed and state.mode is Mode.AUTO and self._store.mission:
            self._switch_due_s = state.t_s + _NEW_MISSION_AFTER_S
        else:
            self._switch()

    def boot(self) -> None:
        """No new mission is waiting after a reboot."""
        self._switch_due_s = None

    def switch_when_due(self) -> None:
        """Take over a mission that was uploaded in flight."""
        if self._switch_due_s is not None and self._state.t_s >= self._switch_due_s:
            self._switch_due_s = None
            self._switch()

    def _switch(self) -> None:
        """Fly the stored mission from now on: at the same index, or at the item marked current."""
        executor = self.executor
        self._forget_reached()
        executor.load(self._store.mission)
        marked = self._store.marked_current
        if marked is not None and marked < len(executor.plan):
            executor.index = marked
        self._problem = self._find_problem()
        if self._problem is not None and not executor.plan.is_empty:
            self._radio.say(Severity.CRITICAL, self._problem)
        if self._state.mode is not Mode.AUTO or not self._state.is_armed:
            return
        if self.is_valid:
            executor.set_current(executor.index)
        else:
            self._radio.say(Severity.CRITICAL, "No valid mission available, loitering")
            self._commander.set_mode(Mode.HOLD)

    def start(self) -> None:
        """MISSION mode begins, armed."""
        executor = self.executor
        if executor.state == MissionState.COMPLETE and self._state.is_landed:
            executor.restart()
            self._forget_reached()
        self._problem = self._find_problem()
        if not self.is_valid:
            self._radio.say(Severity.CRITICAL, "No valid mission available, refusing takeoff")
            self._commander.set_mode(Mode.HOLD)
            return
        self._radio.say(Severity.INFO, "Executing Mission")
        # Speed commands in front of the item are replayed, in the order of storage.
        self._guidance.speed_override_mps = executor.plan.speed_before(executor.index)
        executor.start()

    def left(self) -> None:
        """MISSION mode ends: cameras and gimbals are told to rest; companions receive it too."""
        self._radio.ask_companions(Cmd.DO_TRIGGER_CONTROL, 0.0, 1.0, -1.0)
        if not self._state.is_landed:
            self._radio.ask_companions(Cmd.DO_GIMBAL_MANAGER_CONFIGURE, -3.0, -3.0, -1.0, -1.0)
            self._radio.ask_companions(
                Cmd.DO_GIMBAL_MANAGER_PITCHYAW, math.nan, 0.0, math.nan, math.nan
            )

    def set_current(self, seq: int) -> None:
        """MISSION_SET_CURRENT: the way to jump. Only the next second's MISSION_CURRENT reports it.

        mavlink_mission.cpp, send: the new number is already known there, so it is no change.
        """
        known, self._known_seq = self._known_seq, seq
        self._forget_reached()
        if not self.executor.set_current(seq):
            self._known_seq = known
            self._radio.say(Severity.CRITICAL, "WPM: WP CURR CMD: Not in list")

    def slow_step(self) -> None:
        """Leave MISSION mode after the end of a mission in the air."""
        if self._ended_in_air:
            self._ended_in_air = False
            if self._state.mode is Mode.AUTO and not self._state.is_landed:
                self._commander.set_mode(Mode.HOLD)

    def repeat_reached(self) -> None:
        """MISSION_ITEM_REACHED is sent ten more times, at 1 Hz."""
        if self._reached_left > 0 and self._state.t_s >= self._reached_next_s:
            self._reached_left -= 1
            self._reached_next_s = self._state.t_s + 1.0
            self._radio.send_all("MISSION_ITEM_REACHED", seq=self._reached_seq)

    # --- what the executor asks ---------------------------------------------------------------

    def may_take_off(self) -> bool:
        """Armed is enough."""
        return True

    def item_started(self, item: MissionItem, seq: int) -> None:
        """MISSION_CURRENT at each change."""
        if self._pending_speed is not None:
            self._guidance.speed_override_mps = self._pending_speed.mps
            self._pending_speed = None
        if seq != self._known_seq:
            self._known_seq = seq
            self._tell_current()

    def item_reached(self, seq: int) -> None:
        """MISSION_ITEM_REACHED, repeated later; the same item again is not reported."""
        if seq == self._reached_seq:
            return
        self._radio.send_all("MISSION_ITEM_REACHED", seq=seq)
        self._reached_seq, self._reached_left = seq, _REACHED_AGAIN
        self._reached_next_s = self._state.t_s + 1.0

    def mission_ended(self) -> None:
        """On the ground it stays in MISSION; in the air it changes to HOLD.

        Commander.cpp: to AUTO_LOITER when the mission is finished, unless landed.
        """
        self._tell_current()
        where = "landed" if self._state.is_landed else "loitering"
        self._radio.say(Severity.INFO, f"Mission finished, {where}")
        self._ended_in_air = not self._state.is_landed

    def place_of(self, item: MissionItem) -> Vec3:
        """INT32_MAX and NaN mean here, and this altitude."""
        state = self._state
        north, east, down = state.pos_ned_m
        if item.command in PLACED and NO_COORDINATE not in (item.x, item.y):
            north, east = state.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        if math.isfinite(item.z):
            if item.frame in AMSL_FRAMES:
                down = state.frame.alt_amsl_m - item.z
            else:
                down = state.home_ned_m[2] - item.z
        return north, east, down

    def run_item(self, item: MissionItem) -> float:
        """Items without a place; a gripper is given MIS_COMMAND_TOUT, whatever it does."""
        match item.command:
            case Cmd.DO_CHANGE_SPEED:
                kind = int(item.param1) if math.isfinite(item.param1) else -1
                self.change_speed(kind, item.param2)
            case Cmd.DO_GRIPPER:
                action = item.param2
                if self._payload.has_gripper and action in (0.0, 1.0):
                    self._payload.grip(int(action))
                return max(self._state.params["MIS_COMMAND_TOUT"], 0.0)
            case Cmd.DO_SET_ACTUATOR:
                self._payload.set_actuator(item.param1)
            case Cmd.NAV_RETURN_TO_LAUNCH:
                self._commander.set_mode(Mode.RTL)
            case _:
                pass
        return 0.0

    def change_speed(self, kind: int, speed_mps: float) -> None:
        """Ground speed (type 1) at once; other types, and the default (0 or less), next item.

        Flown: 2 m/s in a leg, then -1 and 0, went on at 2 m/s on that leg (conform: speed/none).
        """
        guidance = self._guidance
        if not speed_mps > 0.0:
            self._pending_speed = _Speed(None)
            if self._state.mode is not Mode.AUTO:
                guidance.speed_override_mps = None
        elif kind == 1:
            guidance.speed_override_mps = speed_mps
            self._pending_speed = None
        else:
            self._pending_speed = _Speed(speed_mps)

    def sink_mps(self, height_m: float) -> float:
        """Descent speed of a landing at a height above home."""
        return self._rules.sink_mps(self._state.params, height_m)

    def leg_yaw_rad(self, start: Vec3, end: Vec3) -> float | None:
        """Heading to fly a leg with."""
        return heading_along(start, end) if self._rules.faces_legs(self._state.params) else None

    def plan_return(self) -> Returning:
        """A return to launch from here."""
        state = self._state
        return Returning(self._rules.return_plan(state, self._store), state.pos_ned_m)

    def begin_guided(self) -> None:
        """Set-points are followed from now on; earlier ones are void."""
        self._targets.begin_guided()

    def guided_in_mission(self, leg: Leg) -> Goal | None:
        """PX4 refuses such an item at its upload."""
        return None

    # --- parts --------------------------------------------------------------------------------

    def _tell_current(self) -> None:
        total = mission_total(len(self.executor.plan))
        fields = mission_current(self.executor, total, mission_id(self._store.mission))
        self._radio.send_all("MISSION_CURRENT", **fields)

    def _forget_reached(self) -> None:
        self._reached_seq, self._reached_left = None, 0

    def _find_problem(self) -> str | None:
        """The first reason not to fly the loaded mission; a mission is stored in any case."""
        state, plan = self._state, self.executor.plan
        is_first = True
        home = state.home_ned_m
        for number, item in enumerate(plan.items):
            placed = item.command in PLACED and item.command in NAVIGATING
            if not placed or NO_COORDINATE in (item.x, item.y):
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
            if fence.breach((north, east), (home[0], home[1]), height) is not None:
                return f"Geofence violation for waypoint {number + 1}"
        for number, item in enumerate(plan.items):
            if item.command == Cmd.DO_JUMP:
                target = int(item.param1)
                if not 0 <= target < len(plan):
                    return f"Mission rejected: DO JUMP {number} to nowhere"
        return None
