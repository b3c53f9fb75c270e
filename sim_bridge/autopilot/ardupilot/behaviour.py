"""ArduCopter (4.7-dev) as the simulated autopilot plays it, put together from its parts."""

import math

from sim_bridge.autopilot.ardupilot.checks import PREARM_OK_AFTER_S, ArduPilotChecks
from sim_bridge.autopilot.ardupilot.commands import ArduPilotCommands
from sim_bridge.autopilot.ardupilot.failsafe import ArduPilotFailsafe
from sim_bridge.autopilot.ardupilot.guided import ArduPilotGuided
from sim_bridge.autopilot.ardupilot.mission import ArduPilotMission
from sim_bridge.autopilot.ardupilot.mission_items import ArduPilotMissionRules
from sim_bridge.autopilot.ardupilot.mode_numbers import MODES, NAMES
from sim_bridge.autopilot.ardupilot.modes import ArduPilotModes
from sim_bridge.autopilot.ardupilot.payload import ArduPilotPayload
from sim_bridge.autopilot.ardupilot.rules import ArduPilotRules
from sim_bridge.autopilot.ardupilot.telemetry import (
    ArduPilotLinkHabits,
    ArduPilotTelemetry,
    data_stream,
)
from sim_bridge.autopilot.base.goals import Goal, Idle, Setpoint
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.behaviour import AutopilotParts
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, MavResult, Severity
from sim_bridge.autopilot.mavlink.router import ArduPilotRouter
from sim_bridge.autopilot.mission.items import MissionItem
from sim_bridge.autopilot.services.commands import CommonCommands, Firmware
from sim_bridge.autopilot.state import RADIO, EstimatorTiming

_SWITCH_EDGES_US = (1230, 1360, 1490, 1620, 1749)
_FIRMWARE = Firmware(
    version=0x04070000,
    git_hash=b"90700977",
    capabilities=(
        1 | 2 | 4 | 8 | 64 | 128 | 256 | 512 | 2048 | 4096 | 8192 | 16384 | 32768 | 131072
    ),
    refused_interval=MavResult.DENIED,
    refused_request=MavResult.FAILED,
)


class ArduPilot:
    """Implements `AutopilotBehaviour` and `CommanderHooks` as ArduCopter does."""

    rules = ArduPilotRules()
    mission_rules = ArduPilotMissionRules()
    habits = ArduPilotLinkHabits()
    router = ArduPilotRouter
    timing = EstimatorTiming(ready_after_s=42.0, gnss_patience_s=10.0)
    landing_lean_limit_rad: float | None = math.radians(7.0)
    answers_ping = False

    def __init__(self, parts: AutopilotParts) -> None:
        state, radio, guidance, rc = parts.state, parts.radio, parts.guidance, parts.rc
        self._state = state
        self._radio = radio
        self._guidance = guidance
        self._rc = rc
        self.commander = Commander(state, parts.landing, self)
        self._targets = ModeTargets(guidance)
        self._payload = ArduPilotPayload(state, radio)
        guided = ArduPilotGuided(state, guidance, self._targets, self.rules)
        self.mission = ArduPilotMission(
            state,
            parts.store,
            radio,
            self.commander,
            guidance,
            self._targets,
            rc,
            self._payload,
            guided,
            self.rules,
        )
        self.executor = self.mission.executor
        self._checks = ArduPilotChecks(
            state, radio, rc, parts.battery, parts.store, self.executor.plan
        )
        self._modes = ArduPilotModes(state, self.commander, self._targets, rc, self.mission, guided)
        self._failsafe = ArduPilotFailsafe(
            state, radio, self.commander, rc, parts.battery, parts.geofence
        )
        self._telemetry = ArduPilotTelemetry(
            state, self.executor, parts.battery, parts.wind, rc, self._targets, self._checks
        )
        self.streams = self._telemetry.streams
        self._commands = ArduPilotCommands(
            state,
            radio,
            self.commander,
            self._checks,
            self.mission,
            self._modes,
            guided,
            self._payload,
            self.streams,
            CommonCommands(state, radio, self.commander, self.streams, self.habits, _FIRMWARE),
            parts.reboot,
        )
        self.commands = self._commands.handlers
        self._switch: int | None = None
        self._switch_candidate: int | None = None
        self._prearm_told_s = 0.0

    @property
    def release(self) -> bool:
        """Whether the gripper is open."""
        return self._payload.release

    # --- flying -------------------------------------------------------------------------------

    def initial_mode(self) -> Mode:
        """INITIAL_MODE: STABILIZE."""
        return MODES.get(int(self._state.params["INITIAL_MODE"]), Mode.STABILIZE)

    def goal(self) -> Goal:
        """What the present mode asks for."""
        return self._modes.goal()

    def remaining_frac(self) -> float | None:
        """Remaining battery charge."""
        return self._telemetry.remaining_frac()

    def boot(self, *, in_flight: bool) -> None:
        """Forget what a reboot loses."""
        self._guidance.speed_override_mps = None
        self._targets.clear()
        self._targets.setpoint = None
        self._failsafe.boot()
        if in_flight:
            return
        self._payload.release = False
        self.executor.stop()
        self.executor.restart()

    def slow_step(self) -> None:
        """What is done at 10 Hz, in ArduCopter's order."""
        state = self._state
        self._follow_rc()
        if state.is_armed:
            self._failsafe.watch()
        if not state.is_landed:
            self.commander.note_flying()
            self.mission.allow_take_off()
        self._payload.step()
        if state.is_armed:
            self._disarm_when_idle()
        else:
            self._complain_before_arming()

    def _disarm_when_idle(self) -> None:
        """DISARM_DELAY after landing or arming, with nothing to do and the throttle down."""
        state = self._state
        delay = state.params["DISARM_DELAY"]
        idle_s = state.t_s - max(state.armed_since_s, state.landed_since_s)
        if not state.is_landed or delay <= 0.0 or idle_s < delay:
            return
        sticks = self._rc.sticks()
        if isinstance(state.goal, Idle) and (sticks is None or sticks.throttle < 0.1):
            self.commander.disarm()

    def _complain_before_arming(self) -> None:
        """What the pre-arm checks find, every half minute."""
        state = self._state
        if state.t_since_boot_s <= PREARM_OK_AFTER_S or state.t_s - self._prearm_told_s <= 30.0:
            return
        self._prearm_told_s = state.t_s
        problem = self._checks.prearm_problem()
        if problem is not None:
            self._radio.say(Severity.CRITICAL, f"PreArm: {problem}")

    # --- commander's hooks --------------------------------------------------------------------

    def leaving(self, mode: Mode) -> None:
        """End what the mode has under way."""
        if mode is Mode.AUTO:
            self.executor.stop()
        self._targets.returning = None
        self._guidance.fixed_yaw_rad = None

    def entered(self, mode: Mode) -> None:
        """Start what the mode is for."""
        self._targets.clear()
        if mode in (Mode.AUTO, Mode.GUIDED, Mode.RTL):
            self._guidance.speed_override_mps = None
            self._guidance.set_limits(self.rules.limits(self._state.params))
        self._modes.entered(mode)
        # mode.cpp, set_mode: sent at once, not with the next second's
        self._radio.send_all("HEARTBEAT", **(self.streams["HEARTBEAT"]() or {}))

    def armed(self) -> None:
        """In AUTO, arming starts the mission."""
        self._targets.hold_point = None
        self.mission.forbid_take_off()
        if self._state.mode is Mode.AUTO:
            self.executor.start()
        self._radio.say(Severity.INFO, "Arming motors")

    def disarmed(self) -> None:
        """Disarming resets the mission."""
        self._targets.setpoint = None
        self.mission.forbid_take_off()
        self.executor.stop()
        self.executor.restart()
        self._targets.takeoff_down_m = None
        self._radio.say(Severity.INFO, "Disarming motors")

    def home_changed(self) -> None:
        """Sent to everybody."""
        for name in ("HOME_POSITION", "GPS_GLOBAL_ORIGIN"):
            fields = self.streams[name]()
            if fields is not None:
                self._radio.send_all(name, **fields)

    # --- radio control ------------------------------------------------------------------------

    def override_channels(self, system: int, channels: list[int]) -> None:
        """Only from the ground station that SYSID_MYGCS names, for RC_OVERRIDE_TIME."""
        if self._failsafe.is_own_gcs(system):
            hold_s = self._state.params["RC_OVERRIDE_TIME"]
            until_s = self._state.t_s + (hold_s if hold_s >= 0.0 else math.inf)
            self._rc.override(channels, until_s)

    def _follow_rc(self) -> None:
        """A mode switch that has moved and is steady changes the mode."""
        params = self._state.params
        position = self._rc.switch(int(params["FLTMODE_CH"]), _SWITCH_EDGES_US)
        if position is None:
            return
        settled = position == self._switch_candidate
        self._switch_candidate = position
        if not settled or position == self._switch:
            return
        self._switch = position
        mode = MODES.get(int(params[f"FLTMODE{position + 1}"]))
        if mode is None:
            return
        problem = self._checks.mode_problem(mode)
        if problem is None:
            self.commander.set_mode(mode, RADIO)
        else:
            self._radio.say(Severity.WARNING, f"Mode change to {NAMES[mode]} failed: {problem}")

    # --- messages -----------------------------------------------------------------------------

    def gcs_heard(self, system: int) -> None:
        """A ground station's HEARTBEAT has arrived."""
        self._failsafe.gcs_heard(system)

    def take_setpoint(self, setpoint: Setpoint) -> None:
        """Only in GUIDED, or where the mission says so."""
        self._modes.take_setpoint(setpoint)

    def set_mode_message(self, link_id: int, message: Message) -> None:
        """SET_MODE: done or not done, and not acknowledged."""
        if message.base_mode & 1:
            sender = message.src_system, message.src_component
            self._commands.request_mode(message.custom_mode, sender)

    def mission_set_current(self, link_id: int, seq: int) -> None:
        """MISSION_SET_CURRENT: the answer repeats the number that was asked."""
        if self.executor.set_current(seq):
            fields = self.streams["MISSION_CURRENT"]() or {}
            self._radio.send(link_id, "MISSION_CURRENT", **{**fields, "seq": seq})

    def guided_item(self, link_id: int, message: Message) -> bool:
        """A mission item with current = 2: fly there, in GUIDED."""
        is_taken = self._state.mode is Mode.GUIDED and self._fly_to_item(message)
        self._radio.send(
            link_id,
            "MISSION_ACK",
            target_system=message.src_system,
            target_component=message.src_component,
            type=0 if is_taken else 1,
            mission_type=0,
        )
        return True

    def _fly_to_item(self, message: Message) -> bool:
        """Take an item's place as a set-point; False if it has none."""
        scale = 1.0 if message.msg_name == "MISSION_ITEM_INT" else 1e7
        x, y = message.x * scale, message.y * scale
        if not all(math.isfinite(number) for number in (x, y, message.z)):
            return False
        taken = self.mission_rules.take(
            MissionItem(Cmd.NAV_WAYPOINT, message.frame, x=round(x), y=round(y), z=message.z), 0
        )
        if not isinstance(taken, MissionItem):
            return False
        place = self.mission.place_of(taken)
        self._modes.take_setpoint(Setpoint(self._state.t_s, place, None, None, 0.0))
        return True

    def data_stream(self, stream_id: int) -> tuple[str, ...]:
        """REQUEST_DATA_STREAM's groups."""
        return data_stream(stream_id)

    def set_parameter(self, link_id: int, message: Message) -> None:
        """Any type is cast; what is not a number is ignored; unknown names get no answer."""
        params, name = self._state.params, message.param_id
        if name in params and params.accept(name, message.param_value, message.param_type):
            for link in self._radio.links:
                self._radio.send_parameter(link, name, 65535)

    def answered_index(self, requested: int) -> int | None:
        """The requested index; 65535 for a name."""
        return requested if requested >= 0 else 65535

    def parameter_unknown(self, link_id: int, message: Message) -> None:
        """No answer."""
