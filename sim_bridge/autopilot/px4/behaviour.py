"""PX4 (1.18) as the simulated autopilot plays it, put together from its parts."""

from sim_bridge.autopilot.base.goals import Goal, Idle, Setpoint
from sim_bridge.autopilot.base.modes import PILOTED, Mode
from sim_bridge.autopilot.behaviour import AutopilotParts
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.rc_input import Sticks
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, MavResult, MissionState, Severity
from sim_bridge.autopilot.mavlink.router import Px4Router
from sim_bridge.autopilot.px4.checks import PREVENT_ARMING, Px4Checks
from sim_bridge.autopilot.px4.commands import Px4Commands
from sim_bridge.autopilot.px4.failsafe import Px4Failsafe
from sim_bridge.autopilot.px4.guided import Px4Guided
from sim_bridge.autopilot.px4.mission import Px4Mission
from sim_bridge.autopilot.px4.mission_items import Px4MissionRules
from sim_bridge.autopilot.px4.mode_numbers import SWITCH_MODES, mode_of
from sim_bridge.autopilot.px4.modes import Px4Modes
from sim_bridge.autopilot.px4.payload import Px4Payload
from sim_bridge.autopilot.px4.rules import Px4Rules
from sim_bridge.autopilot.px4.telemetry import Px4LinkHabits, Px4Telemetry
from sim_bridge.autopilot.services.commands import CommonCommands, Firmware
from sim_bridge.autopilot.state import RADIO, EstimatorTiming

_SWITCH_EDGES_US = (1160, 1320, 1480, 1640, 1800)
_STICK_PERIOD_S = 0.1
_DOES_NOT_EXIST, _TYPE_MISMATCH = 1, 7
"""MAV_PARAM_ERROR, as the MAVLink development set has it."""
_FIRMWARE = Firmware(
    version=0x01120000,
    git_hash=bytes(3) + bytes.fromhex("83c4f4e580")[::-1],  # backwards, as PX4 sends it
    capabilities=1 | 4 | 8 | 16 | 64 | 128 | 256 | 2048 | 8192 | 16384 | 32768,
    refused_interval=MavResult.FAILED,
    refused_request=MavResult.DENIED,
)


class Px4:
    """Implements `AutopilotBehaviour` and `CommanderHooks` as PX4 does."""

    rules = Px4Rules()
    mission_rules = Px4MissionRules()
    habits = Px4LinkHabits()
    router = Px4Router
    timing = EstimatorTiming(ready_after_s=12.0, gnss_patience_s=5.0)
    landing_lean_limit_rad: float | None = None
    answers_ping = True

    def __init__(self, parts: AutopilotParts) -> None:
        state, radio, guidance, rc = parts.state, parts.radio, parts.guidance, parts.rc
        self._state = state
        self._radio = radio
        self._guidance = guidance
        self._rc = rc
        self.commander = Commander(state, parts.landing, self)
        self._targets = ModeTargets(guidance)
        self._payload = Px4Payload(state, radio)
        self.mission = Px4Mission(
            state,
            parts.store,
            radio,
            self.commander,
            guidance,
            self._targets,
            self._payload,
            parts.geofence,
            self.rules,
        )
        self.executor = self.mission.executor
        self._checks = Px4Checks(state, rc, self._targets, self.mission)
        guided = Px4Guided(state, radio, self.commander, self._targets, self._checks)
        self._modes = Px4Modes(
            state, self.commander, guidance, self._targets, rc, self.mission, guided
        )
        self._failsafe = Px4Failsafe(
            state, radio, self.commander, rc, parts.battery, parts.geofence, self._checks
        )
        self._telemetry = Px4Telemetry(
            state, self.executor, parts.battery, parts.wind, rc, self._failsafe, parts.store
        )
        self.streams = self._telemetry.streams
        self._commands = Px4Commands(
            state,
            radio,
            self.commander,
            guidance,
            self._checks,
            self.mission,
            self._modes,
            self._payload,
            self._failsafe,
            CommonCommands(state, radio, self.commander, self.streams, self.habits, _FIRMWARE),
            parts.reboot,
        )
        self.commands = self._commands.handlers
        self._switch: int | None = None
        self._sticks: Sticks | None = None
        self._idle_since_s: float | None = None
        self._mode_after_disarming: Mode | None = None
        self._changed: list[str] = []

    @property
    def release(self) -> bool:
        """Whether the gripper is open."""
        return self._payload.release

    # --- flying -------------------------------------------------------------------------------

    def initial_mode(self) -> Mode:
        """Without radio control it boots into HOLD."""
        return Mode.HOLD

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
        self.mission.boot()
        if in_flight:
            return
        self._payload.release = False
        self.executor.stop()
        self.executor.restart()

    def slow_step(self) -> None:
        """What is done at 10 Hz, in PX4's order."""
        self.mission.switch_when_due()
        self._follow_rc()
        if self._state.is_armed:
            self._failsafe.watch()
        if not self._state.is_landed:
            self.commander.note_flying()
        self.mission.slow_step()
        self._disarm_on_ground()
        self._failsafe.act_when_due()
        self._payload.step()
        self._announce_changed_parameters()
        self.mission.repeat_reached()

    def _disarm_on_ground(self) -> None:
        """Disarm after a while on the ground, but never while a mission is in progress.

        As Commander.cpp (handleAutoDisarm) has it, the clock stands still meanwhile: it keeps what
        it showed before the take-off. So the end of a mission that was flown from arming to
        landing disarms at once (0.02 to 0.04 s after landed, measured), not after COM_DISARM_LAND.
        """
        state, params = self._state, self._state.params
        if not state.is_armed:
            self._idle_since_s = None
            return
        if state.has_flown:
            if state.mode is Mode.AUTO and self.executor.state != MissionState.COMPLETE:
                return
            delay, idle = params["COM_DISARM_LAND"], state.is_landed
        else:
            delay, idle = params["COM_DISARM_PRFLT"], True
            if delay > 0.0:
                delay += max(params["COM_SPOOLUP_TIME"], 0.0)
        if not idle:
            self._idle_since_s = None
        elif self._idle_since_s is None:
            self._idle_since_s = state.t_s
        elif 0.0 < delay <= state.t_s - self._idle_since_s and isinstance(state.goal, Idle):
            self.commander.disarm()

    # --- commander's hooks --------------------------------------------------------------------

    def leaving(self, mode: Mode) -> None:
        """End what the mode has under way."""
        if mode is Mode.AUTO:
            self.executor.stop()
            self.mission.left()
        self._targets.returning = None
        self._guidance.fixed_yaw_rad = None

    def entered(self, mode: Mode) -> None:
        """Start what the mode is for."""
        if mode not in PREVENT_ARMING and self._state.failsafe_reason is None:
            self._mode_after_disarming = mode
        self._modes.entered(mode)
        if mode is Mode.AUTO and self._state.is_armed:
            self.mission.start()

    def armed(self) -> None:
        """Arming starts what the mode is for."""
        self._targets.hold_point = None
        if self._state.mode is Mode.AUTO:
            self.mission.start()
        self._radio.say(Severity.INFO, "Armed by external command")

    def disarmed(self) -> None:
        """The mission keeps its place; a finished one will start again.

        What prevents arming is left for the mode before (UserModeIntention.cpp, onDisarm; flown).
        """
        self._targets.setpoint = None
        if self._state.mode is Mode.AUTO:
            self.mission.left()
        self._failsafe.disarmed()
        self.executor.stop()
        self._radio.say(Severity.INFO, "Disarmed")
        if self._state.mode in PREVENT_ARMING and self._mode_after_disarming is not None:
            self.commander.set_mode(self._mode_after_disarming)

    def home_changed(self) -> None:
        """The leg under way moves with it (flown); HOME_POSITION where it is streamed."""
        self.mission.executor.follow_home()
        fields = self.streams["HOME_POSITION"]()
        if fields is None:
            return
        for link in self._radio.links.values():
            if link.interval_of("HOME_POSITION") is not None:
                self._radio.send(link.id, "HOME_POSITION", **fields)

    # --- radio control ------------------------------------------------------------------------

    def override_channels(self, system: int, channels: list[int]) -> None:
        """From anybody, for as long as radio control may be silent."""
        hold_s = max(self._state.params["COM_RC_LOSS_T"], 0.5)
        self._rc.override(channels, self._state.t_s + hold_s)

    def _follow_rc(self) -> None:
        """The mode switch, if one is mapped, and sticks moved in an automatic mode."""
        state = self._state
        params = state.params
        slot = self._rc.switch(int(params["RC_MAP_FLTMODE"]), _SWITCH_EDGES_US)
        if slot is not None and slot != self._switch:
            self._switch = slot
            mode = SWITCH_MODES.get(int(params[f"COM_FLTMODE{slot + 1}"]))
            if mode is not None:
                self._commands.request_mode(mode, RADIO)
        if state.is_armed and not state.is_landed:
            self._follow_sticks()
        else:
            self._sticks = self._rc.sticks()

    def _follow_sticks(self) -> None:
        """Sticks that move faster than MAN_OVERRIDE_SPD (full travels a second) take over.

        Source: PX4 1.18, manual_control/ManualControl.cpp; COM_RC_OVERRIDE is gone. A receiver
        that comes up is taken to have been centred, with the throttle where it is.
        """
        state = self._state
        sticks = self._rc.sticks()
        before, self._sticks = self._sticks, sticks
        if sticks is None or state.mode in PILOTED:
            return
        before = before or Sticks(0.0, 0.0, sticks.throttle, 0.0)
        moved = max(
            abs(sticks.roll - before.roll),
            abs(sticks.pitch - before.pitch),
            abs(sticks.yaw - before.yaw),
            2.0 * abs(sticks.throttle - before.throttle),
        )
        least_per_s = state.params["MAN_OVERRIDE_SPD"]
        if least_per_s >= 0.0 and moved > least_per_s * _STICK_PERIOD_S:
            self._failsafe.user_took_over()
            self.commander.set_mode(Mode.LOITER if state.has_position else Mode.ALT_HOLD, RADIO)
            self._radio.say(Severity.INFO, "Pilot took over using sticks")

    # --- messages -----------------------------------------------------------------------------

    def gcs_heard(self, system: int) -> None:
        """A ground station's HEARTBEAT has arrived."""
        self._failsafe.gcs_heard(system)

    def take_setpoint(self, setpoint: Setpoint) -> None:
        """Taken in any mode: a stream has to exist before OFFBOARD."""
        self._targets.setpoint = setpoint

    def set_mode_message(self, link_id: int, message: Message) -> None:
        """SET_MODE becomes DO_SET_MODE, and is acknowledged as such."""
        result = MavResult.DENIED
        if message.base_mode & 1:
            sender = message.src_system, message.src_component
            result = self._commands.request_mode(mode_of(message.custom_mode), sender)
        self._radio.send(
            link_id,
            "COMMAND_ACK",
            command=int(Cmd.DO_SET_MODE),
            result=int(result),
            target_system=message.src_system,
            target_component=message.src_component,
        )

    def mission_set_current(self, link_id: int, seq: int) -> None:
        """MISSION_SET_CURRENT."""
        self.mission.set_current(seq)

    def guided_item(self, link_id: int, message: Message) -> bool:
        """current = 2 has no meaning here."""
        return False

    def data_stream(self, stream_id: int) -> tuple[str, ...]:
        """REQUEST_DATA_STREAM is not known."""
        return ()

    def set_parameter(self, link_id: int, message: Message) -> None:
        """The type has to be right; the stored value is sent back, or an error.

        A value that has changed is sent again, on every link, before it is saved
        (mavlink_parameters.cpp, send_untransmitted).
        """
        params, name = self._state.params, message.param_id
        if name not in params:
            self._radio.say(Severity.INFO, f"[pm] unknown param: {name}")
            self.parameter_unknown(link_id, message)
            return
        before = params[name]
        if not params.accept(name, message.param_value, message.param_type):
            self._radio.say(Severity.ERROR, f"[pm] param types mismatch param: {name}")
            self._refuse_parameter(link_id, message, _TYPE_MISMATCH)
            return
        self._radio.send_parameter(link_id, name)
        if params[name] != before and name not in self._changed:
            self._changed.append(name)

    def _announce_changed_parameters(self) -> None:
        for name in self._changed:
            for link_id in self._radio.links:
                self._radio.send_parameter(link_id, name)
        self._changed.clear()

    def answered_index(self, requested: int) -> int | None:
        """The parameter's own."""
        return None

    def parameter_unknown(self, link_id: int, message: Message) -> None:
        """PARAM_ERROR (mavlink_parameters.cpp, send_error)."""
        self._refuse_parameter(link_id, message, _DOES_NOT_EXIST)

    def _refuse_parameter(self, link_id: int, message: Message, error: int) -> None:
        self._radio.send(
            link_id,
            "PARAM_ERROR",
            target_system=message.src_system,
            target_component=message.src_component,
            param_id=message.param_id,
            param_index=message.__dict__.get("param_index", -1),
            error=error,
        )
