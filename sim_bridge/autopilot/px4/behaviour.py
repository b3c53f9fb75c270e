"""PX4 where it differs from ArduCopter, row by row as measured (PX4 1.18 base)."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.failsafe import Failsafes
from sim_bridge.autopilot.flight.goals import (
    Descend,
    Idle,
    Vec3,
)
from sim_bridge.autopilot.flight.modes import (
    PILOTED,
    PX4_SWITCH_MODES,
    Mode,
    px4_base_mode,
    px4_custom_mode,
    px4_custom_mode_high_latency,
    px4_mode_of,
)
from sim_bridge.autopilot.flight.pilot import Sticks
from sim_bridge.autopilot.kinds import BatterySensing, LinkKind
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.commands import Command
from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    Cmd,
    LandedState,
    MissionState,
    Result,
    Severity,
)
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mission.executor import Phase
from sim_bridge.autopilot.mission.mission import (
    NO_COORDINATE,
    PLACED,
    PX4_JUMP_FOREVER,
    Item,
    Px4MissionRules,
)
from sim_bridge.autopilot.px4 import telemetry
from sim_bridge.autopilot.px4.commands import COMMANDS, can_run, has_gripper, request_mode
from sim_bridge.autopilot.px4.failsafe import watch
from sim_bridge.autopilot.px4.mission import mission_problem
from sim_bridge.autopilot.px4.modes import Px4Modes
from sim_bridge.autopilot.px4.rules import Px4Rules

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_SWITCH_EDGES_US = (1160, 1320, 1480, 1640, 1800)
_NEW_MISSION_AFTER_S = 1.5
"""A mission uploaded in flight takes over after 1 to 2 s (measured)."""
_STICK_PERIOD_S = 0.1
_REACHED_AGAIN = 10
_DOES_NOT_EXIST, _TYPE_MISMATCH = 1, 7
"""MAV_PARAM_ERROR, as the MAVLink development set has it."""


@dataclass(frozen=True, slots=True)
class _Later:
    """An acknowledgement that is due when an action has taken its time."""

    command: Command
    due_s: float


@dataclass(frozen=True, slots=True)
class _Speed:
    """A speed for the next item; None is the default."""

    mps: float | None


class Px4:
    """What `Autopilot` asks its flavour, answered as PX4 does."""

    autopilot_id = 12
    firmware_version = 0x01120000
    firmware_hash = bytes(3) + bytes.fromhex("83c4f4e580")[::-1]  # backwards, as PX4 sends it
    capabilities = 1 | 4 | 8 | 16 | 64 | 128 | 256 | 2048 | 8192 | 16384 | 32768
    commands = COMMANDS
    streams = telemetry.STREAMS
    refused_interval = Result.FAILED
    refused_request = Result.DENIED
    jump_forever = PX4_JUMP_FOREVER
    landing_lean_limit_rad: float | None = None
    ekf_ready_after_s = 12.0
    gnss_patience_s = 5.0

    def __init__(self) -> None:
        self.mission_rules = Px4MissionRules()
        self.rules = Px4Rules()
        self.modes = Px4Modes()
        self._mission_problem: str | None = None
        self._pending_speed: _Speed | None = None
        self._switch: int | None = None
        self._sticks: Sticks | None = None
        self._acts_at_s = math.inf
        self._acts_with: Mode | None = None
        self._interrupted: Mode | None = None
        self._later: list[_Later] = []
        self._reached_seq = -1
        self._reached_left = 0
        self._reached_next_s = 0.0
        self._idle_since_s: float | None = None
        self._known_seq = -1
        self._changed: list[str] = []
        self._ended_in_air = False

    # --- what it says -------------------------------------------------------------------------

    def base_mode(self, mode: Mode, armed: bool) -> int:
        """HEARTBEAT.base_mode."""
        return px4_base_mode(mode, armed)

    def custom_mode(self, mode: Mode) -> int:
        """HEARTBEAT.custom_mode."""
        return px4_custom_mode(mode)

    def high_latency_mode(self, mode: Mode) -> int:
        """HIGH_LATENCY2.custom_mode: packed otherwise."""
        return px4_custom_mode_high_latency(mode)

    def intended_mode(self, ap: "Autopilot") -> Mode:
        """The mode that a failsafe has interrupted, or the present one."""
        return self._interrupted or ap.mode

    def default_streams(self, kind: LinkKind) -> dict[str, float]:
        """The link's profile."""
        return {name: 1.0 / rate for name, rate in telemetry.DEFAULT_RATES_HZ[kind].items()}

    def data_stream(self, stream_id: int) -> tuple[str, ...]:
        """REQUEST_DATA_STREAM is not known."""
        return ()

    def status_text(self, ap: "Autopilot", text: str) -> tuple[str, list[int]]:
        """Only where a ground station's HEARTBEAT was heard; texts end with a tab."""
        links = ap.radio.links.values()
        return text + "\t", [link.id for link in links if ap.t_s <= link.gcs_until_s]

    def hud_airspeed_mps(self, ap: "Autopilot") -> float:
        """VFR_HUD.airspeed: NaN on a multirotor without a sensor."""
        readings = ap.readings
        if readings is None or readings.airspeed_mps is None:
            return math.nan
        return readings.airspeed_mps

    def high_latency_airspeed(self, ap: "Autopilot") -> int:
        """HIGH_LATENCY2.airspeed: always 0."""
        return 0

    def high_latency_wind(self, ap: "Autopilot") -> tuple[float, int]:
        """Speed, and where it blows TO in units of 2 degrees."""
        wind = ap.wind
        if wind is None:
            return 0.0, 0
        heading = math.degrees(math.atan2(wind.east_mps, wind.north_mps)) % 360.0
        return math.hypot(wind.north_mps, wind.east_mps), round(heading / 2.0) % 180

    def cell_voltages_mv(self, ap: "Autopilot", voltage_v: float | None) -> tuple[int, ...]:
        """Each cell's mean where their number is known, else the total in the first place."""
        count = min(int(ap.params["BAT1_N_CELLS"]), 10)
        if voltage_v is None:
            return (65535,) * 10
        if count <= 0:
            return (min(round(voltage_v * 1000.0), 65534), *(65535,) * 9)
        cells = int(ap.params["BAT1_N_CELLS"])
        return (round(voltage_v * 1000.0 / cells),) * count + (65535,) * (10 - count)

    def remaining_frac(self, ap: "Autopilot") -> float | None:
        """By voltage and counted charge; SIH's is a timer."""
        if ap.battery_sensing is BatterySensing.SIH_TIMER:
            least = ap.params["SIM_BAT_MIN_PCT"] / 100.0
            return ap.battery.sih_remaining_frac(ap.params["SIM_BAT_DRAIN"], least)
        return ap.battery.px4_remaining_frac(telemetry.cells(ap.params))

    def airborne_state(self, ap: "Autopilot") -> LandedState:
        """Taking off, landing, or in the air."""
        if isinstance(ap.goal, Descend):
            return LandedState.LANDING
        leg = ap.executor.leg
        climbing = ap.mode is Mode.AUTO and leg is not None and leg.phase is Phase.CLIMB
        if ap.mode is Mode.TAKEOFF or climbing:
            return LandedState.TAKEOFF
        return LandedState.IN_AIR

    def prearm_ok(self, ap: "Autopilot") -> bool:
        """SYS_STATUS's pre-arm bit: everything that does not depend on the mode."""
        return ap.is_armed or ap.ekf_is_ready

    # --- parameters ---------------------------------------------------------------------------

    def parameter_names(self, params: ParameterStore) -> list[str]:
        """A list begins with the checksum."""
        names = [name for i in range(len(params)) if (name := params.name_at(i)) is not None]
        return ["_HASH_CHECK", *names]

    def hash_check(self, params: ParameterStore) -> float:
        """The checksum's bytes, as a float's."""
        return params.digest_as_float()

    def set_parameter(self, ap: "Autopilot", link_id: int, message: Message) -> None:
        """The type has to be right; the stored value is sent back, or what is wrong.

        A value that has changed is sent again, on every link, before it is saved
        (mavlink_parameters.cpp, send_untransmitted).
        """
        name = message.param_id
        if name not in ap.params:
            ap.say(Severity.INFO, f"[pm] unknown param: {name}")
            self.parameter_unknown(ap, link_id, message)
            return
        before = ap.params[name]
        if not ap.params.accept(name, message.param_value, message.param_type):
            ap.say(Severity.ERROR, f"[pm] param types mismatch param: {name}")
            self._refuse_parameter(ap, link_id, message, _TYPE_MISMATCH)
            return
        ap.radio.send_parameter(link_id, name)
        if ap.params[name] != before and name not in self._changed:
            self._changed.append(name)

    answers_ping = True

    def index_told(self, asked: int) -> int | None:
        """The parameter's own."""
        return None

    def parameter_unknown(self, ap: "Autopilot", link_id: int, message: Message) -> None:
        """PARAM_ERROR (mavlink_parameters.cpp, send_error)."""
        self._refuse_parameter(ap, link_id, message, _DOES_NOT_EXIST)

    def _refuse_parameter(
        self, ap: "Autopilot", link_id: int, message: Message, error: int
    ) -> None:
        ap.radio.send(
            link_id,
            "PARAM_ERROR",
            target_system=message.src_system,
            target_component=message.src_component,
            param_id=message.param_id,
            param_index=message.__dict__.get("param_index", -1),
            error=error,
        )

    # --- modes and arming ---------------------------------------------------------------------

    def initial_mode(self, params: ParameterStore) -> Mode:
        """Without radio control it comes up in HOLD."""
        return Mode.HOLD

    def enter(self, ap: "Autopilot", mode: Mode) -> None:
        """What entering a mode starts."""
        ap.enter(mode)
        self.modes.entered(ap, mode)
        if mode is Mode.AUTO and ap.is_armed:
            self._start_mission(ap)

    def armed(self, ap: "Autopilot") -> None:
        """Arming starts what the mode is for."""
        if ap.mode is Mode.AUTO:
            self._start_mission(ap)
        ap.say(Severity.INFO, "Armed by external command")

    def disarmed(self, ap: "Autopilot") -> None:
        """The mission keeps its place; a finished one will start again."""
        if ap.mode is Mode.AUTO:
            self.mission_left(ap)
        self._interrupted = None
        self._acts_with = None
        ap.executor.stop()
        ap.say(Severity.INFO, "Disarmed")

    def allow_take_off(self) -> None:
        """Nothing to allow."""

    def may_take_off(self, ap: "Autopilot") -> bool:
        """Armed is enough."""
        return True

    # --- missions -----------------------------------------------------------------------------

    def mission_total(self, count: int) -> int:
        """All items; none at all is 65535."""
        return count or 65535

    def mission_is_valid(self, ap: "Autopilot") -> bool:
        """Whether MISSION mode has something to fly."""
        return not ap.executor.plan.is_empty and self._mission_problem is None

    def mission_written(self, ap: "Autopilot", *, whole: bool) -> None:
        """Taken over as a whole; while a mission is flown, after a while."""
        if ap.is_armed and ap.mode is Mode.AUTO and ap.store.mission:
            ap.switch_mission_in(_NEW_MISSION_AFTER_S)
        else:
            self.switch_mission(ap)

    def switch_mission(self, ap: "Autopilot") -> None:
        """Fly the stored mission from now on: at the same index, or at the item marked current."""
        executor = ap.executor
        self._forget_reached()
        executor.load(ap.store.mission)
        marked = ap.protocol.flagged_current
        if marked is not None and marked < len(executor.plan):
            executor.index = marked
        self._mission_problem = mission_problem(ap)
        if self._mission_problem is not None and not executor.plan.is_empty:
            ap.say(Severity.CRITICAL, self._mission_problem)
        if ap.mode is not Mode.AUTO or not ap.is_armed:
            return
        if self.mission_is_valid(ap):
            executor.set_current(executor.index)
        else:
            ap.say(Severity.CRITICAL, "No valid mission available, loitering")
            ap.set_mode(Mode.HOLD)

    def _start_mission(self, ap: "Autopilot") -> None:
        executor = ap.executor
        if executor.state == MissionState.COMPLETE and ap.is_landed:
            executor.restart()
            self._forget_reached()
        self._mission_problem = mission_problem(ap)
        if not self.mission_is_valid(ap):
            ap.say(Severity.CRITICAL, "No valid mission available, refusing takeoff")
            ap.set_mode(Mode.HOLD)
            return
        ap.say(Severity.INFO, "Executing Mission")
        # Speed commands in front of the item are replayed, in the order of storage.
        ap.speed_override_mps = executor.plan.speed_before(executor.index)
        executor.start()

    def may_clear_mission(self, ap: "Autopilot") -> bool:
        """At any time."""
        return True

    def mission_set_current(self, ap: "Autopilot", link_id: int, seq: int) -> None:
        """MISSION_SET_CURRENT: the way to jump; only the MISSION_CURRENT of each second tells.

        mavlink_mission.cpp, send: the new number is known there already, so it is no change.
        """
        known, self._known_seq = self._known_seq, seq
        self._forget_reached()
        if not ap.executor.set_current(seq):
            self._known_seq = known
            ap.say(Severity.CRITICAL, "WPM: WP CURR CMD: Not in list")

    def announce_current(self, ap: "Autopilot") -> None:
        """The new current item, to everybody."""
        self._tell_current(ap)

    def _tell_current(self, ap: "Autopilot") -> None:
        fields = self.streams["MISSION_CURRENT"](ap) or {}
        ap.radio.send_all("MISSION_CURRENT", **fields)

    def mission_left(self, ap: "Autopilot") -> None:
        """It tells cameras and gimbals to rest; a companion hears it too."""
        ap.radio.ask_companions(Cmd.DO_TRIGGER_CONTROL, 0.0, 1.0, -1.0)
        if not ap.is_landed:
            ap.radio.ask_companions(Cmd.DO_GIMBAL_MANAGER_CONFIGURE, -3.0, -3.0, -1.0, -1.0)
            ap.radio.ask_companions(
                Cmd.DO_GIMBAL_MANAGER_PITCHYAW, math.nan, 0.0, math.nan, math.nan
            )

    def item_started(self, ap: "Autopilot", item: Item, seq: int) -> None:
        """MISSION_CURRENT at each change that is news."""
        if self._pending_speed is not None:
            ap.speed_override_mps = self._pending_speed.mps
            self._pending_speed = None
        if seq != self._known_seq:
            self._known_seq = seq
            self._tell_current(ap)

    def _forget_reached(self) -> None:
        self._reached_seq, self._reached_left = -1, 0

    def item_reached(self, ap: "Autopilot", seq: int) -> None:
        """MISSION_ITEM_REACHED, and another ten times at 1 Hz; the same again is no news."""
        if seq == self._reached_seq:
            return
        ap.radio.send_all("MISSION_ITEM_REACHED", seq=seq)
        self._reached_seq, self._reached_left = seq, _REACHED_AGAIN
        self._reached_next_s = ap.t_s + 1.0

    def mission_ended(self, ap: "Autopilot") -> None:
        """On the ground it stays in MISSION; in the air it goes over to HOLD.

        Commander.cpp: to AUTO_LOITER when the mission is finished, unless landed.
        """
        self._tell_current(ap)
        where = "landed" if ap.is_landed else "loitering"
        ap.say(Severity.INFO, f"Mission finished, {where}")
        self._ended_in_air = not ap.is_landed

    def place_of(self, ap: "Autopilot", item: Item) -> Vec3:
        """INT32_MAX and NaN mean here, and this altitude."""
        here = ap.pos_ned_m
        north, east, down = here
        if item.command in PLACED and NO_COORDINATE not in (item.x, item.y):
            north, east = ap.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        if math.isfinite(item.z):
            if item.frame in AMSL_FRAMES:
                down = ap.frame.alt_amsl_m - item.z
            else:
                down = ap.home_ned_m[2] - item.z
        return north, east, down

    def run_item(self, ap: "Autopilot", item: Item) -> float:
        """Items without a place; a gripper is given MIS_COMMAND_TOUT, whatever it does."""
        match item.command:
            case Cmd.DO_CHANGE_SPEED:
                kind = int(item.param1) if math.isfinite(item.param1) else -1
                self.change_speed(ap, kind, item.param2)
            case Cmd.DO_GRIPPER:
                action = item.param2
                if has_gripper(ap) and action in (0.0, 1.0):
                    self.grip(ap, int(action))
                return max(ap.params["MIS_COMMAND_TOUT"], 0.0)
            case Cmd.DO_SET_ACTUATOR:
                if math.isfinite(item.param1):
                    ap.release = item.param1 > 0.0
            case Cmd.NAV_RETURN_TO_LAUNCH:
                ap.set_mode(Mode.RTL)
            case _:
                pass
        return 0.0

    def change_speed(self, ap: "Autopilot", kind: int, speed_mps: float) -> None:
        """Ground speed at once, other types with the next item; so the default, not above 0.

        Flown: 2 m/s in a leg, then -1 and 0, went on at 2 m/s on that leg (conform: speed/none).
        """
        if not speed_mps > 0.0:
            self._pending_speed = _Speed(None)
            if ap.mode is not Mode.AUTO:
                ap.speed_override_mps = None
        elif kind == 1:
            ap.speed_override_mps = speed_mps
            self._pending_speed = None
        else:
            self._pending_speed = _Speed(speed_mps)

    def grip(self, ap: "Autopilot", action: int) -> None:
        """DO_GRIPPER: open loop."""
        ap.release = action == 0

    def finish_later(self, ap: "Autopilot", command: Command, wait_s: float) -> None:
        """Acknowledge a command as done after a while."""
        self._later.append(_Later(command, ap.t_s + wait_s))

    def is_busy_with(self, number: int) -> bool:
        """Whether such a command is not yet done."""
        return any(later.command.number == number for later in self._later)

    def guided_item(self, ap: "Autopilot", link_id: int, message: Message) -> bool:
        """current = 2 means nothing here."""
        return False

    # --- people -------------------------------------------------------------------------------

    def set_mode_message(self, ap: "Autopilot", link_id: int, message: Message) -> None:
        """SET_MODE becomes DO_SET_MODE, and is acknowledged as such."""
        result = Result.DENIED
        if message.base_mode & 1:
            result = request_mode(ap, px4_mode_of(message.custom_mode))
        ap.radio.send(
            link_id,
            "COMMAND_ACK",
            command=int(Cmd.DO_SET_MODE),
            result=int(result),
            target_system=message.src_system,
            target_component=message.src_component,
        )

    def override_channels(self, ap: "Autopilot", system: int, channels: list[int]) -> None:
        """From anybody, for as long as radio control may be silent."""
        ap.pilot.override(channels, ap.t_s + max(ap.params["COM_RC_LOSS_T"], 0.5))

    def minds_gcs(self, params: ParameterStore, system: int) -> bool:
        """Any ground station will do."""
        return True

    def heed_pilot(self, ap: "Autopilot") -> None:
        """The mode switch, if one is mapped, and sticks moved in an automatic mode."""
        slot = ap.pilot.switch(int(ap.params["RC_MAP_FLTMODE"]), _SWITCH_EDGES_US)
        if slot is not None and slot != self._switch:
            self._switch = slot
            mode = PX4_SWITCH_MODES.get(int(ap.params[f"COM_FLTMODE{slot + 1}"]))
            if mode is not None:
                request_mode(ap, mode)
        if ap.is_armed and not ap.is_landed:
            self._heed_sticks(ap)
        else:
            self._sticks = ap.pilot.sticks()

    def _heed_sticks(self, ap: "Autopilot") -> None:
        """Sticks that move faster than MAN_OVERRIDE_SPD (full travels a second) take over.

        Source: PX4 1.18, manual_control/ManualControl.cpp; COM_RC_OVERRIDE is gone. A receiver
        that comes up is taken to have been centred, with the throttle where it is.
        """
        sticks = ap.pilot.sticks()
        before, self._sticks = self._sticks, sticks
        if sticks is None or ap.mode in PILOTED:
            return
        before = before or Sticks(0.0, 0.0, sticks.throttle, 0.0)
        moved = max(
            abs(sticks.roll - before.roll),
            abs(sticks.pitch - before.pitch),
            abs(sticks.yaw - before.yaw),
            2.0 * abs(sticks.throttle - before.throttle),
        )
        least_per_s = ap.params["MAN_OVERRIDE_SPD"]
        if least_per_s >= 0.0 and moved > least_per_s * _STICK_PERIOD_S:
            self.user_took_over(ap)
            ap.set_mode(Mode.LOITER if ap.has_position else Mode.ALT_HOLD)
            ap.say(Severity.INFO, "Pilot took over using sticks")

    def user_took_over(self, ap: "Autopilot") -> None:
        """Whatever a failsafe was about to do, somebody has decided otherwise."""
        self._acts_with = None
        self._interrupted = None
        ap.failsafe_reason = None

    def watch(self, ap: "Autopilot", failsafes: Failsafes) -> None:
        """Failsafes, ten times a second while armed."""
        watch(ap, failsafes)

    def hold_then(self, ap: "Autopilot", mode: Mode, delay_s: float) -> None:
        """Hold now, act later, unless somebody takes over."""
        ap.set_mode(Mode.HOLD)
        self._acts_with = mode
        self._acts_at_s = ap.t_s + delay_s

    def fall_back(self, ap: "Autopilot", mode: Mode) -> None:
        """To a lesser mode while the present one cannot run."""
        self._interrupted = ap.mode
        ap.set_mode(mode)

    def recover(self, ap: "Autopilot") -> None:
        """Back to the mode that could not run."""
        wanted, self._interrupted = self._interrupted, None
        if wanted is not None and can_run(ap, wanted):
            ap.set_mode(wanted)

    def home_changed(self, ap: "Autopilot") -> None:
        """HOME_POSITION where it is streamed."""
        fields = self.streams["HOME_POSITION"](ap)
        if fields is None:
            return
        for link in ap.radio.links.values():
            if link.interval_of("HOME_POSITION") is not None:
                ap.radio.send(link.id, "HOME_POSITION", **fields)

    def slow_step(self, ap: "Autopilot") -> None:
        """Automatic disarming, delayed actions, repeated messages."""
        if not ap.is_landed:
            ap.has_flown = True
            ap.landed_since_s = ap.t_s
        if self._ended_in_air:
            self._ended_in_air = False
            if ap.mode is Mode.AUTO and not ap.is_landed:
                ap.set_mode(Mode.HOLD)
        self._disarm_on_ground(ap)
        if self._acts_with is not None and ap.t_s >= self._acts_at_s:
            mode, self._acts_with = self._acts_with, None
            if ap.mode is Mode.HOLD and mode is not Mode.HOLD:
                ap.set_mode(mode)
        for later in [entry for entry in self._later if entry.due_s <= ap.t_s]:
            self._later.remove(later)
            ap.radio.acknowledge(later.command, Result.ACCEPTED)
        for name in self._changed:
            for link_id in ap.radio.links:
                ap.radio.send_parameter(link_id, name)
        self._changed.clear()
        if self._reached_left > 0 and ap.t_s >= self._reached_next_s:
            self._reached_left -= 1
            self._reached_next_s = ap.t_s + 1.0
            ap.radio.send_all("MISSION_ITEM_REACHED", seq=self._reached_seq)

    def _disarm_on_ground(self, ap: "Autopilot") -> None:
        """Disarm after a while on the ground, but never while a mission is in progress.

        As Commander.cpp (handleAutoDisarm) has it, the clock stands still meanwhile: it keeps what
        it showed before the take-off, so the end of a mission that was flown from arming to
        landing disarms at once (0.02 to 0.04 s after landed, measured), not after COM_DISARM_LAND.
        """
        if not ap.is_armed:
            self._idle_since_s = None
            return
        if ap.has_flown:
            if ap.mode is Mode.AUTO and ap.executor.state != MissionState.COMPLETE:
                return
            delay, idle = ap.params["COM_DISARM_LAND"], ap.is_landed
        else:
            delay, idle = ap.params["COM_DISARM_PRFLT"], True
            if delay > 0.0:
                delay += max(ap.params["COM_SPOOLUP_TIME"], 0.0)
        if not idle:
            self._idle_since_s = None
        elif self._idle_since_s is None:
            self._idle_since_s = ap.t_s
        elif 0.0 < delay <= ap.t_s - self._idle_since_s and isinstance(ap.goal, Idle):
            ap.disarm()
