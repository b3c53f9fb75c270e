"""ArduCopter where it differs from PX4, row by row as measured (ArduCopter 4.7-dev)."""

import math
from typing import TYPE_CHECKING, Any

from sim_bridge.autopilot.ardupilot import telemetry
from sim_bridge.autopilot.ardupilot.commands import (
    COMMANDS,
    PREARM_OK_AFTER_S,
    mode_problem,
    prearm_problem,
    request_mode,
)
from sim_bridge.autopilot.ardupilot.failsafe import watch
from sim_bridge.autopilot.ardupilot.modes import ArduPilotModes
from sim_bridge.autopilot.ardupilot.rules import ArduPilotRules
from sim_bridge.autopilot.flight.failsafe import Failsafes
from sim_bridge.autopilot.flight.goals import Descend, Idle, Vec3
from sim_bridge.autopilot.flight.guidance import Limits
from sim_bridge.autopilot.flight.modes import (
    ARDUPILOT_NAMES,
    ARDUPILOT_NUMBERS,
    Mode,
    ardupilot_base_mode,
    ardupilot_custom_mode,
)
from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    Cmd,
    LandedState,
    MissionState,
    Result,
    Severity,
)
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mavlink.setpoints import Setpoint
from sim_bridge.autopilot.mission.executor import Phase
from sim_bridge.autopilot.mission.mission import ArduPilotMissionRules, Item

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_SWITCH_EDGES_US = (1230, 1360, 1490, 1620, 1749)
_TAKE_OFF_WITHOUT_THROTTLE = 2
_GRIP_S = 2.0
_RELEASE_SERVO = 9
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


class ArduPilot:
    """What `Autopilot` asks its flavour, answered as ArduCopter does."""

    autopilot_id = 3
    firmware_version = 0x04070000
    firmware_hash = b"90700977"
    capabilities = (
        1 | 2 | 4 | 8 | 64 | 128 | 256 | 512 | 2048 | 4096 | 8192 | 16384 | 32768 | 131072
    )
    commands = COMMANDS
    streams = telemetry.STREAMS
    refused_interval = Result.DENIED
    refused_request = Result.FAILED
    jump_forever = -1
    landing_lean_limit_rad: float | None = math.radians(7.0)
    ekf_ready_after_s = 42.0
    gnss_patience_s = 10.0

    def __init__(self) -> None:
        self.mission_rules = ArduPilotMissionRules()
        self.rules = ArduPilotRules()
        self.modes = ArduPilotModes()
        self._auto_armed = False
        self._switch: int | None = None
        self._switch_candidate: int | None = None
        self._grip_told_s: float | None = None
        self._grip_text = ""
        self._prearm_told_s = 0.0

    # --- what it says -------------------------------------------------------------------------

    def base_mode(self, mode: Mode, armed: bool) -> int:
        """HEARTBEAT.base_mode."""
        return ardupilot_base_mode(mode, armed)

    def custom_mode(self, mode: Mode) -> int:
        """HEARTBEAT.custom_mode."""
        return ardupilot_custom_mode(mode)

    def high_latency_mode(self, mode: Mode) -> int:
        """HIGH_LATENCY2.custom_mode: the same number."""
        return ardupilot_custom_mode(mode)

    def default_streams(self, kind: LinkKind) -> dict[str, float]:
        """HEARTBEAT at 1 Hz and nothing else until asked."""
        return {"HEARTBEAT": 1.0}

    def data_stream(self, stream_id: int) -> tuple[str, ...]:
        """REQUEST_DATA_STREAM's groups."""
        return telemetry.data_stream(stream_id)

    def status_text(self, ap: "Autopilot", text: str) -> tuple[str, list[int]]:
        """STATUSTEXT goes to every link."""
        return text, list(ap.radio.links)

    def hud_airspeed_mps(self, ap: "Autopilot") -> float:
        """VFR_HUD.airspeed."""
        return telemetry.hud_airspeed_mps(ap)

    def high_latency_airspeed(self, ap: "Autopilot") -> int:
        """HIGH_LATENCY2.airspeed, in 0.2 m/s."""
        return min(255, round(5.0 * telemetry.hud_airspeed_mps(ap)))

    def high_latency_wind(self, ap: "Autopilot") -> tuple[float, int]:
        """Speed, and where it blows FROM in units of 2 degrees."""
        wind = telemetry.wind(ap)
        return wind["speed"], round(wind["direction"] % 360.0 / 2.0) % 180

    def cell_voltages_mv(self, ap: "Autopilot", voltage_v: float | None) -> tuple[int, ...]:
        """The total, in the first cell's place (split where 16 bits are too few)."""
        rest = [65535] * 9
        if voltage_v is None:
            return (65535, *rest)
        total = round(voltage_v * 1000.0)
        first = min(total, 65534)
        if total > first:
            rest[0] = total - first
        return (first, *rest)

    def remaining_frac(self, ap: "Autopilot") -> float | None:
        """BATT_CAPACITY less what was drawn since boot."""
        return ap.battery.ardupilot_remaining_frac(ap.params["BATT_CAPACITY"])

    def airborne_state(self, ap: "Autopilot") -> LandedState:
        """Landing only in LAND and at the end of RTL."""
        if isinstance(ap.goal, Descend):
            return LandedState.LANDING
        taking_off = ap.takeoff_down_m is not None
        leg = ap.executor.leg
        if ap.mode is Mode.AUTO and leg is not None:
            taking_off = leg.phase is Phase.CLIMB
        return LandedState.TAKEOFF if taking_off else LandedState.IN_AIR

    def prearm_ok(self, ap: "Autopilot") -> bool:
        """SYS_STATUS's pre-arm bit: it knows nothing of what the mode will want."""
        return ap.is_armed or prearm_problem(ap) is None

    # --- parameters ---------------------------------------------------------------------------

    def parameter_names(self, params: ParameterStore) -> list[str]:
        """Names in the order of a parameter list."""
        return [name for i in range(len(params)) if (name := params.name_at(i)) is not None]

    def hash_check(self, params: ParameterStore) -> float:
        """There is none."""
        return 0.0

    answers_ping = False

    def index_told(self, asked: int) -> int | None:
        """The index that was asked for; 65535 for a name."""
        return asked if asked >= 0 else 65535

    def parameter_unknown(self, ap: "Autopilot", link_id: int, message: Message) -> None:
        """Silence."""

    def set_parameter(self, ap: "Autopilot", link_id: int, message: Message) -> None:
        """Any type is cast; what is not a number is ignored; unknown names get no answer."""
        name = message.param_id
        if name in ap.params and ap.params.accept(name, message.param_value, message.param_type):
            for link in ap.radio.links:
                ap.radio.send_parameter(link, name, 65535)

    # --- modes and arming ---------------------------------------------------------------------

    def initial_mode(self, params: ParameterStore) -> Mode:
        """INITIAL_MODE: STABILIZE."""
        return ARDUPILOT_NUMBERS.get(int(params["INITIAL_MODE"]), Mode.STABILIZE)

    def enter(self, ap: "Autopilot", mode: Mode) -> None:
        """What entering a mode starts."""
        ap.enter(mode)
        if mode in (Mode.AUTO, Mode.GUIDED, Mode.RTL):
            ap.speed_override_mps = None
            ap.guidance.set_limits(self.rules.limits(ap.params))
        self.modes.entered(ap, mode)
        # mode.cpp, set_mode: told at once, not with the next second's
        ap.radio.send_all("HEARTBEAT", **(self.streams["HEARTBEAT"](ap) or {}))

    def armed(self, ap: "Autopilot") -> None:
        """In AUTO, arming starts the mission."""
        self._auto_armed = False
        if ap.mode is Mode.AUTO:
            ap.executor.start()
        ap.say(Severity.INFO, "Arming motors")

    def disarmed(self, ap: "Autopilot") -> None:
        """Disarming resets the mission."""
        self._auto_armed = False
        ap.executor.stop()
        ap.executor.restart()
        ap.takeoff_down_m = None
        ap.say(Severity.INFO, "Disarming motors")

    def allow_take_off(self) -> None:
        """A take-off was commanded: the throttle stick is not asked any more."""
        self._auto_armed = True

    def may_take_off(self, ap: "Autopilot") -> bool:
        """Commanded, by option, or by a raised throttle."""
        if self._auto_armed or int(ap.params["AUTO_OPTIONS"]) & _TAKE_OFF_WITHOUT_THROTTLE:
            return True
        sticks = ap.pilot.sticks()
        return sticks is not None and sticks.throttle > 0.1

    # --- missions -----------------------------------------------------------------------------

    def mission_total(self, count: int) -> int:
        """Without home; an empty mission has 0."""
        return max(count - 1, 0)

    def mission_written(self, ap: "Autopilot", *, whole: bool) -> None:
        """Straight into the mission that is flown: not atomic."""
        executor = ap.executor
        executor.load(ap.store.mission, keep_jumps=not whole)
        if not ap.is_armed and whole:
            executor.restart()
        elif executor.is_active and executor.is_on_a_leg:
            if executor.reload_current():
                ap.say(Severity.CRITICAL, "Auto mission changed, restarted command")
            else:
                ap.say(Severity.CRITICAL, "Auto mission changed but failed to restart command")

    def switch_mission(self, ap: "Autopilot") -> None:
        """Nothing is ever pending."""

    def may_clear_mission(self, ap: "Autopilot") -> bool:
        """Not while it is flown."""
        executor = ap.executor
        return not (ap.is_armed and executor.is_active and executor.state == MissionState.ACTIVE)

    def mission_set_current(self, ap: "Autopilot", link_id: int, seq: int) -> None:
        """MISSION_SET_CURRENT: works; the answer repeats the number that was asked."""
        if ap.executor.set_current(seq):
            fields: dict[str, Any] = self.streams["MISSION_CURRENT"](ap) or {}
            ap.radio.send(link_id, "MISSION_CURRENT", **{**fields, "seq": seq})

    def announce_current(self, ap: "Autopilot") -> None:
        """The new current item, to everybody."""
        fields: dict[str, Any] = self.streams["MISSION_CURRENT"](ap) or {}
        ap.radio.send_all("MISSION_CURRENT", **fields)

    def mission_left(self, ap: "Autopilot") -> None:
        """Nothing is sent when AUTO ends."""

    def item_started(self, ap: "Autopilot", item: Item, seq: int) -> None:
        """Each is announced by its name."""
        name = _NAMES.get(Cmd(item.command), "Do")
        ap.say(Severity.INFO, f"Mission: {seq} {name}")

    def item_reached(self, ap: "Autopilot", seq: int) -> None:
        """MISSION_ITEM_REACHED to every link."""
        ap.radio.send_all("MISSION_ITEM_REACHED", seq=seq)
        if seq < len(ap.executor.plan) and ap.executor.plan.items[seq].command == Cmd.NAV_WAYPOINT:
            ap.say(Severity.INFO, f"Reached command #{seq}")

    def mission_ended(self, ap: "Autopilot") -> None:
        """On the ground it disarms, in the air it loiters."""
        if ap.is_landed:
            ap.disarm()

    def place_of(self, ap: "Autopilot", item: Item) -> Vec3:
        """No latitude and longitude means here, no altitude this altitude."""
        here = ap.pos_ned_m
        north, east = here[0], here[1]
        if item.x or item.y:
            north, east = ap.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        if item.z == 0.0 and item.command != Cmd.NAV_LAND:
            return north, east, here[2]
        if item.frame in AMSL_FRAMES:
            return north, east, ap.frame.alt_amsl_m - item.z
        return north, east, ap.home_ned_m[2] - item.z

    def run_item(self, ap: "Autopilot", item: Item) -> float:
        """Do items; only CONDITION_DELAY makes the next one wait."""
        match item.command:
            case Cmd.DO_CHANGE_SPEED:
                if item.param2 > 0.0:
                    self.change_speed(ap, int(item.param1), item.param2)
            case Cmd.DO_GRIPPER:
                self.grip(ap, int(item.param2))
            case Cmd.DO_SET_SERVO:
                self.servo(ap, int(item.param1), int(item.param2))
            case Cmd.CONDITION_YAW:
                self.turn_to(ap, item.param1, item.param3, relative=item.param4 == 1.0)
            case Cmd.DO_GUIDED_LIMITS:
                self.modes.limit_guided(item.param1, item.param2, item.param3, item.param4)
            case Cmd.CONDITION_DELAY:
                return max(item.param1, 0.0)
            case Cmd.DO_SET_HOME:
                place = ap.pos_ned_m if item.param1 == 1.0 else self.place_of(ap, item)
                ap.set_home(place, locked=True)
            case Cmd.DO_FENCE_ENABLE:
                ap.params.set("FENCE_ENABLE", 1.0 if item.param1 == 1.0 else 0.0)
            case _:
                pass
        return 0.0

    def change_speed(self, ap: "Autopilot", kind: int, speed_mps: float) -> None:
        """Ground speed, whatever type was asked; 2 and 3 are climb and descent."""
        if kind in (0, 1):
            ap.speed_override_mps = max(speed_mps, 0.2)
            return
        limits = self.rules.limits(ap.params)
        up = speed_mps if kind == 2 else limits.up_mps
        down = speed_mps if kind == 3 else limits.down_mps
        ap.guidance.set_limits(
            Limits(
                limits.horizontal_mps,
                up,
                down,
                limits.accel_mps2,
                limits.jerk_mps3,
                limits.tilt_rad,
            )
        )

    def grip(self, ap: "Autopilot", action: int) -> bool:
        """DO_GRIPPER: open loop, it believes what it commanded."""
        if ap.params["GRIP_ENABLE"] == 0.0:
            return False
        ap.release = action == 0
        ap.say(Severity.INFO, "Gripper load releasing" if action == 0 else "Gripper load grabbing")
        self._grip_text = "Gripper load released" if action == 0 else "Gripper load grabbed"
        self._grip_told_s = ap.t_s + _GRIP_S
        return True

    def servo(self, ap: "Autopilot", channel: int, pulse_us: int) -> bool:
        """DO_SET_SERVO: channel 9 is wired to the release."""
        if not 1 <= channel <= 16 or not 500 <= pulse_us <= 2500:
            return False
        if channel == _RELEASE_SERVO:
            if ap.params["SERVO9_FUNCTION"] != 0.0:
                return False
            ap.release = pulse_us > 1500
        return channel > 4  # 1 to 4 are the motors'

    def turn_to(self, ap: "Autopilot", degrees: float, sign: float, *, relative: bool) -> None:
        """CONDITION_YAW: a heading until the mode ends."""
        angle = math.radians(degrees)
        if relative:
            angle = ap.guidance.yaw_sp_rad + (-angle if sign < 0.0 else angle)
        ap.guidance.fixed_yaw_rad = angle

    def guided_item(self, ap: "Autopilot", link_id: int, message: Message) -> bool:
        """A mission item with current = 2: fly there, in GUIDED."""
        if ap.mode is Mode.GUIDED:
            scale = 1.0 if message.msg_name == "MISSION_ITEM_INT" else 1e7
            x, y = message.x * scale, message.y * scale
            if all(math.isfinite(number) for number in (x, y, message.z)):
                taken = self.mission_rules.take(
                    Item(Cmd.NAV_WAYPOINT, message.frame, x=round(x), y=round(y), z=message.z), 0
                )
                if isinstance(taken, Item):
                    place = self.place_of(ap, taken)
                    self.modes.take_setpoint(ap, Setpoint(ap.t_s, place, None, None, 0.0))
                    self._answer_guided(ap, link_id, message, 0)
                    return True
        self._answer_guided(ap, link_id, message, 1)
        return True

    def _answer_guided(self, ap: "Autopilot", link_id: int, message: Message, result: int) -> None:
        ap.radio.send(
            link_id,
            "MISSION_ACK",
            target_system=message.src_system,
            target_component=message.src_component,
            type=result,
            mission_type=0,
        )

    # --- people -------------------------------------------------------------------------------

    def set_mode_message(self, ap: "Autopilot", link_id: int, message: Message) -> None:
        """SET_MODE: done or not done, and not acknowledged."""
        if message.base_mode & 1:
            request_mode(ap, message.custom_mode)

    def override_channels(self, ap: "Autopilot", system: int, channels: list[int]) -> None:
        """Only from the ground station that SYSID_MYGCS names, for RC_OVERRIDE_TIME."""
        if self.minds_gcs(ap.params, system):
            hold_s = ap.params["RC_OVERRIDE_TIME"]
            ap.pilot.override(channels, ap.t_s + (hold_s if hold_s >= 0.0 else math.inf))

    def minds_gcs(self, params: ParameterStore, system: int) -> bool:
        """Whether a system is the ground station."""
        return system == params.value("SYSID_MYGCS", "MAV_GCS_SYSID")

    def heed_pilot(self, ap: "Autopilot") -> None:
        """A mode switch that has moved, and lies still, changes the mode."""
        position = ap.pilot.switch(int(ap.params["FLTMODE_CH"]), _SWITCH_EDGES_US)
        if position is None:
            return
        settled = position == self._switch_candidate
        self._switch_candidate = position
        if not settled or position == self._switch:
            return
        self._switch = position
        mode = ARDUPILOT_NUMBERS.get(int(ap.params[f"FLTMODE{position + 1}"]))
        if mode is None:
            return
        problem = mode_problem(ap, mode)
        if problem is None:
            ap.set_mode(mode)
        else:
            name = ARDUPILOT_NAMES[mode]
            ap.say(Severity.WARNING, f"Mode change to {name} failed: {problem}")

    def watch(self, ap: "Autopilot", failsafes: Failsafes) -> None:
        """Failsafes, ten times a second while armed."""
        watch(ap, failsafes)

    def home_changed(self, ap: "Autopilot") -> None:
        """Told to everybody."""
        for name in ("HOME_POSITION", "GPS_GLOBAL_ORIGIN"):
            fields = self.streams[name](ap)
            if fields is not None:
                ap.radio.send_all(name, **fields)

    def slow_step(self, ap: "Autopilot") -> None:
        """Idle disarming, the gripper's word, and the pre-arm complaint every half minute."""
        if not ap.is_landed:
            ap.has_flown = True
            self._auto_armed = True
            ap.landed_since_s = ap.t_s
        if self._grip_told_s is not None and ap.t_s >= self._grip_told_s:
            self._grip_told_s = None
            ap.say(Severity.INFO, self._grip_text)
        if ap.is_armed:
            delay = ap.params["DISARM_DELAY"]
            idle_s = ap.t_s - max(ap.armed_since_s, ap.landed_since_s)
            if ap.is_landed and delay > 0.0 and idle_s >= delay and self._is_idle(ap):
                ap.disarm()
        elif ap.t_since_boot_s > PREARM_OK_AFTER_S and ap.t_s - self._prearm_told_s > 30.0:
            self._prearm_told_s = ap.t_s
            problem = prearm_problem(ap)
            if problem is not None:
                ap.say(Severity.CRITICAL, f"PreArm: {problem}")

    def _is_idle(self, ap: "Autopilot") -> bool:
        sticks = ap.pilot.sticks()
        return isinstance(ap.goal, Idle) and (sticks is None or sticks.throttle < 0.1)
