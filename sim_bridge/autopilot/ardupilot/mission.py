"""How ArduCopter flies and reports missions.

Sources: ArduPilot, libraries/AP_Mission/AP_Mission.cpp; ArduCopter/mode_auto.cpp.
"""

import math
from dataclasses import replace

from sim_bridge.autopilot.ardupilot.guided import ArduPilotGuided
from sim_bridge.autopilot.ardupilot.payload import ArduPilotPayload
from sim_bridge.autopilot.ardupilot.rules import ArduPilotRules
from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import Goal
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance, heading_along
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.returning import Returning
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.enums import AMSL_FRAMES, Cmd, MissionState, Severity
from sim_bridge.autopilot.mission.executor import Leg, MissionExecutor
from sim_bridge.autopilot.mission.items import MissionItem, MissionStore
from sim_bridge.autopilot.mission.plan import Plan
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState

_TAKE_OFF_WITHOUT_THROTTLE = 2
"""Bit of AUTO_OPTIONS."""
_JUMP_FOREVER = -1
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


class ArduPilotMission:
    """The mission in flight; `executor` flies it and asks here for what is ArduCopter's own."""

    def __init__(
        self,
        state: VehicleState,
        store: MissionStore,
        radio: Radio,
        commander: Commander,
        guidance: Guidance,
        targets: ModeTargets,
        rc: RcInput,
        payload: ArduPilotPayload,
        guided: ArduPilotGuided,
        rules: ArduPilotRules,
    ) -> None:
        self._state = state
        self._store = store
        self._radio = radio
        self._commander = commander
        self._guidance = guidance
        self._targets = targets
        self._rc = rc
        self._payload = payload
        self._guided = guided
        self._rules = rules
        self._take_off_allowed = False
        self.executor = MissionExecutor(
            state, guidance, self, Plan(first=1, forever=_JUMP_FOREVER), sequential=False
        )

    # --- the stored mission -------------------------------------------------------------------

    def mission_written(self, *, whole: bool) -> None:
        """Changes go straight into the mission that is flown: they are not atomic."""
        executor = self.executor
        executor.load(self._store.mission, keep_jumps=not whole)
        if not self._state.is_armed and whole:
            executor.restart()
        elif executor.is_active and executor.is_on_a_leg:
            if executor.reload_current():
                text = "Auto mission changed, restarted command"
            else:
                text = "Auto mission changed but failed to restart command"
            self._radio.say(Severity.CRITICAL, text)

    def may_clear_mission(self) -> bool:
        """Not while it is flown."""
        executor = self.executor
        is_flown = executor.is_active and executor.state == MissionState.ACTIVE
        return not (self._state.is_armed and is_flown)

    # --- taking off ---------------------------------------------------------------------------

    def allow_take_off(self) -> None:
        """A take-off was commanded, or it flies: the throttle stick no longer matters."""
        self._take_off_allowed = True

    def forbid_take_off(self) -> None:
        """After arming and disarming the throttle stick matters again."""
        self._take_off_allowed = False

    def may_take_off(self) -> bool:
        """Commanded, by option, or by a raised throttle."""
        options = int(self._state.params["AUTO_OPTIONS"])
        if self._take_off_allowed or options & _TAKE_OFF_WITHOUT_THROTTLE:
            return True
        sticks = self._rc.sticks()
        return sticks is not None and sticks.throttle > 0.1

    # --- what the executor asks ---------------------------------------------------------------

    def item_started(self, item: MissionItem, seq: int) -> None:
        """Each item is announced by its name."""
        name = _NAMES.get(Cmd(item.command), "Do")
        self._radio.say(Severity.INFO, f"Mission: {seq} {name}")

    def item_reached(self, seq: int) -> None:
        """MISSION_ITEM_REACHED to every link."""
        plan = self.executor.plan
        self._radio.send_all("MISSION_ITEM_REACHED", seq=seq)
        if seq < len(plan) and plan.items[seq].command == Cmd.NAV_WAYPOINT:
            self._radio.say(Severity.INFO, f"Reached command #{seq}")

    def mission_ended(self) -> None:
        """On the ground it disarms, in the air it loiters."""
        if self._state.is_landed:
            self._commander.disarm()

    def place_of(self, item: MissionItem) -> Vec3:
        """No latitude and longitude means here, no altitude this altitude."""
        state = self._state
        north, east, down = state.pos_ned_m
        if item.x or item.y:
            north, east = state.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        if item.z == 0.0 and item.command != Cmd.NAV_LAND:
            return north, east, down
        if item.frame in AMSL_FRAMES:
            return north, east, state.frame.alt_amsl_m - item.z
        return north, east, state.home_ned_m[2] - item.z

    def run_item(self, item: MissionItem) -> float:
        """Items that do not navigate; only CONDITION_DELAY makes the next one wait."""
        match item.command:
            case Cmd.DO_CHANGE_SPEED:
                if item.param2 > 0.0:
                    self.change_speed(int(item.param1), item.param2)
            case Cmd.DO_GRIPPER:
                self._payload.grip(int(item.param2))
            case Cmd.DO_SET_SERVO:
                self._payload.set_servo(int(item.param1), int(item.param2))
            case Cmd.CONDITION_YAW:
                self.turn_to(item.param1, item.param3, relative=item.param4 == 1.0)
            case Cmd.DO_GUIDED_LIMITS:
                self._guided.set_limits(item.param1, item.param2, item.param3, item.param4)
            case Cmd.CONDITION_DELAY:
                return max(item.param1, 0.0)
            case Cmd.DO_SET_HOME:
                place = self._state.pos_ned_m if item.param1 == 1.0 else self.place_of(item)
                self._commander.set_home(place, locked=True)
            case Cmd.DO_FENCE_ENABLE:
                self._state.params.set("FENCE_ENABLE", 1.0 if item.param1 == 1.0 else 0.0)
            case _:
                pass
        return 0.0

    def change_speed(self, kind: int, speed_mps: float) -> None:
        """Ground speed for types 0 and 1; 2 and 3 are climb and descent."""
        if kind in (0, 1):
            self._guidance.speed_override_mps = max(speed_mps, 0.2)
            return
        limits = self._rules.limits(self._state.params)
        if kind == 2:
            limits = replace(limits, up_mps=speed_mps)
        elif kind == 3:
            limits = replace(limits, down_mps=speed_mps)
        self._guidance.set_limits(limits)

    def turn_to(self, degrees: float, sign: float, *, relative: bool) -> None:
        """CONDITION_YAW: a heading until the mode ends."""
        angle = math.radians(degrees)
        if relative:
            angle = self._guidance.yaw_sp_rad + (-angle if sign < 0.0 else angle)
        self._guidance.fixed_yaw_rad = angle

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
        """What set-points ask for; None when one of their limits is passed."""
        return self._guided.in_mission(leg)
