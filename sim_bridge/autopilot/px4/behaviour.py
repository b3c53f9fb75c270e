"""Simulated PX4 (1.18), constructed from its components."""

from sim_bridge.autopilot.base.goals import Goal, Idle, Setpoint
from sim_bridge.autopilot.base.modes import PILOTED, Mode
from sim_bridge.autopilot.behaviour import AutopilotParts
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.rc_input import Sticks
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, MavResult, MissionState, Severity
from sim_bridge.autopilot.mavlink.router import Px4Router
from sim_bridge.autopilot.px4.checks import NON_ARMABLE_MODES, Px4Checks
from sim_bridge.autopilot.px4.commands import Px4Commands
from sim_bridge.autopilot.px4.failsafe import Px4Failsafe
from sim_bridge.autopilot.px4.guided import Px4Guided
from sim_bridge.autopilot.px4.mission import Px4Mission
from sim_bridge.autopilot.px4.mission_items import PX4_MISSION
from sim_bridge.autopilot.px4.mode_numbers import SWITCH_MODES, mode_from_custom_mode
from sim_bridge.autopilot.px4.modes import Px4Modes
from sim_bridge.autopilot.px4.payload import Px4Payload
from sim_bridge.autopilot.px4.rules import Px4Rules
from sim_bridge.autopilot.px4.telemetry import Px4LinkPolicy, Px4Telemetry
from sim_bridge.autopilot.services.commands import CommonCommands, Firmware
from sim_bridge.autopilot.state import RADIO, EstimatorTiming

_SWITCH_EDGES_US = (1160, 1320, 1480, 1640, 1800)
_RC_SAMPLE_PERIOD_S = 0.1
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
    mission_rules = PX4_MISSION
    habits = Px4LinkPolicy()
    router = Px4Router
    timing = EstimatorTiming(ready_after_s=12.0, gnss_timeout_s=5.0)
    landing_lean_limit_rad: float | None = None
    responds_to_ping = True

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
    def is_gripper_open(self) -> bool:
        """Return True if the gripper is open."""
        return self._payload.release

    # --- flying -------------------------------------------------------------------------------

    def initial_mode(self) -> Mode:
        """Without radio control it boots into HOLD."""
        return Mode.HOLD

    def advance_mode_and_return_goal(self) -> Goal:
        """Return the goal of the current mode."""
        return self._modes.advance_mode_and_return_goal()

    def update_remaining_battery_frac(self) -> float | None:
        """Remaining battery charge."""
        return self._telemetry.update_remaining_battery_frac()

    def reset_at_reboot(self, *, in_flight: bool) -> None:
        """Reset the volatile state at a reboot."""
        self._guidance.speed_override_mps = None
        self._targets.clear_except_setpoint()
        self._targets.setpoint = None
        self._failsafe.reset_failure_latches()
        self.mission.discard_pending_mission()
        if in_flight:
            return
        self._payload.release = False
        self.executor.deactivate_keeping_item()
        self.executor.reset_to_first_item()

    def run_10hz_tasks(self) -> None:
        """Run the 10 Hz tasks, in PX4's order."""
        self.mission.activate_pending_mission_if_due()
        self._apply_mode_switch_and_stick_override()
        if self._state.is_armed:
            self._failsafe.check_failures_and_trigger_failsafes()
        if not self._state.is_landed:
            self.commander.record_takeoff()
        self.mission.hold_after_mission_end_in_air()
        self._disarm_after_ground_delay()
        self._failsafe.run_due_delayed_action()
        self._payload.send_due_acks()
        self._send_changed_parameters_on_all_links()
        self.mission.resend_item_reached_if_due()

    def _disarm_after_ground_delay(self) -> None:
        """Disarm after a delay on the ground, but never while a mission is in progress.

        As in Commander.cpp (handleAutoDisarm), the clock does not advance meanwhile: it keeps its
        value from before the take-off. So the end of a mission flown from arming to landing disarms
        at once (0.02 to 0.04 s after landed, measured), not after COM_DISARM_LAND.
        """
        state, params = self._state, self._state.params
        if not state.is_armed:
            self._idle_since_s = None
            self.commander.move_home_after_displacement()
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

    def on_mode_exit(self, mode: Mode) -> None:
        """End the activity of the mode that is left."""
        if mode is Mode.AUTO:
            self.executor.deactivate_keeping_item()
            self.mission.command_companions_at_mode_exit()
        self._targets.returning = None
        self._guidance.fixed_yaw_rad = None

    def on_mode_entry(self, mode: Mode) -> None:
        """Start the activity of the new mode."""
        if mode not in NON_ARMABLE_MODES and self._state.failsafe_reason is None:
            self._mode_after_disarming = mode
        self._modes.on_mode_entry(mode)
        if mode is Mode.AUTO and self._state.is_armed:
            self.mission.start_mission_or_hold()

    def on_armed(self) -> None:
        """Start the mode's activity at arming."""
        self._targets.hold_point = None
        if self._state.mode is Mode.AUTO:
            self.mission.start_mission_or_hold()
        self._radio.send_status_text(Severity.INFO, "Armed by external command")

    def on_disarmed(self) -> None:
        """Keep the mission's index; a finished mission restarts at the next arming.

        A mode that prevents arming reverts to the previous mode (UserModeIntention.cpp, onDisarm;
        flown).
        """
        self._targets.setpoint = None
        if self._state.mode is Mode.AUTO:
            self.mission.command_companions_at_mode_exit()
        self._failsafe.on_disarmed()
        self.executor.deactivate_keeping_item()
        self._radio.send_status_text(Severity.INFO, "Disarmed")
        if self._state.mode in NON_ARMABLE_MODES and self._mode_after_disarming is not None:
            self.commander.set_mode(self._mode_after_disarming)

    def on_home_changed(self) -> None:
        """Move the current leg with home (flown); send HOME_POSITION on links that stream it."""
        self.mission.executor.update_leg_after_home_change()
        fields = self.streams["HOME_POSITION"]()
        if fields is None:
            return
        for link in self._radio.links.values():
            if link.message_interval_s("HOME_POSITION") is not None:
                self._radio.send(link.id, "HOME_POSITION", **fields)

    # --- radio control ------------------------------------------------------------------------

    def on_rc_override(self, sender_system_id: int, channel_pulses_us: list[int]) -> None:
        """Accept RC override from any sender, valid for the radio control timeout."""
        hold_s = max(self._state.params["COM_RC_LOSS_T"], 0.5)
        self._rc.store_channel_overrides(channel_pulses_us, self._state.t_s + hold_s)

    def _apply_mode_switch_and_stick_override(self) -> None:
        """The mode switch, if one is mapped, and sticks moved in an automatic mode."""
        state = self._state
        params = state.params
        slot = self._rc.switch_position(int(params["RC_MAP_FLTMODE"]), _SWITCH_EDGES_US)
        if slot is not None and slot != self._switch:
            self._switch = slot
            mode = SWITCH_MODES.get(int(params[f"COM_FLTMODE{slot + 1}"]))
            if mode is not None:
                self._commands.set_mode_if_allowed(mode, RADIO)
        if state.is_armed and not state.is_landed:
            self._switch_mode_on_pilot_override()
        else:
            self._sticks = self._rc.stick_positions()

    def _switch_mode_on_pilot_override(self) -> None:
        """Detect pilot override: sticks faster than MAN_OVERRIDE_SPD (full travels a second).

        Source: PX4 1.18, manual_control/ManualControl.cpp, without COM_RC_OVERRIDE. A receiver that
        starts is assumed centred before, with its current throttle.
        """
        state = self._state
        sticks = self._rc.stick_positions()
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
        if least_per_s >= 0.0 and moved > least_per_s * _RC_SAMPLE_PERIOD_S:
            self._failsafe.cancel_failsafe_actions()
            self.commander.set_mode(Mode.LOITER if state.has_position else Mode.ALT_HOLD, RADIO)
            self._radio.send_status_text(Severity.INFO, "Pilot took over using sticks")

    # --- messages -----------------------------------------------------------------------------

    def on_gcs_heartbeat(self, gcs_system_id: int) -> None:
        """A ground station's HEARTBEAT has arrived."""
        self._failsafe.record_gcs_heartbeat(gcs_system_id)

    def on_setpoint(self, setpoint: Setpoint) -> None:
        """Accept set-points in any mode: a stream must exist before OFFBOARD."""
        self._targets.setpoint = setpoint

    def handle_set_mode_message(self, link_id: int, message: Message) -> None:
        """SET_MODE becomes DO_SET_MODE, and is acknowledged as such."""
        result = MavResult.DENIED
        if message.base_mode & 1:
            sender = message.src_system, message.src_component
            result = self._commands.set_mode_if_allowed(
                mode_from_custom_mode(message.custom_mode), sender
            )
        self._radio.send(
            link_id,
            "COMMAND_ACK",
            command=int(Cmd.DO_SET_MODE),
            result=int(result),
            target_system=message.src_system,
            target_component=message.src_component,
        )

    def on_mission_set_current(self, link_id: int, seq: int) -> None:
        """MISSION_SET_CURRENT."""
        self.mission.jump_to_item(seq)

    def try_fly_to_guided_mission_item(self, link_id: int, message: Message) -> bool:
        """current = 2 has no meaning here."""
        return False

    def message_names_of_stream_group(self, stream_group_id: int) -> tuple[str, ...]:
        """REQUEST_DATA_STREAM is not known."""
        return ()

    def handle_param_set_and_respond(self, link_id: int, message: Message) -> None:
        """The type has to be right; the stored value is sent back, or an error.

        A value that has changed is sent again, on every link, before it is saved
        (mavlink_parameters.cpp, send_untransmitted).
        """
        params, name = self._state.params, message.param_id
        if name not in params:
            self._radio.send_status_text(Severity.INFO, f"[pm] unknown param: {name}")
            self.handle_unknown_parameter_request(link_id, message)
            return
        before = params[name]
        if not params.store_wire_value_if_accepted(name, message.param_value, message.param_type):
            self._radio.send_status_text(Severity.ERROR, f"[pm] param types mismatch param: {name}")
            self._send_param_error(link_id, message, _TYPE_MISMATCH)
            return
        self._radio.send_parameter(link_id, name)
        if params[name] != before and name not in self._changed:
            self._changed.append(name)

    def _send_changed_parameters_on_all_links(self) -> None:
        for name in self._changed:
            for link_id in self._radio.links:
                self._radio.send_parameter(link_id, name)
        self._changed.clear()

    def param_value_response_index(self, requested_index: int) -> int | None:
        """The parameter's own."""
        return None

    def handle_unknown_parameter_request(self, link_id: int, message: Message) -> None:
        """PARAM_ERROR (mavlink_parameters.cpp, send_error)."""
        self._send_param_error(link_id, message, _DOES_NOT_EXIST)

    def _send_param_error(self, link_id: int, message: Message, error_code: int) -> None:
        self._radio.send(
            link_id,
            "PARAM_ERROR",
            target_system=message.src_system,
            target_component=message.src_component,
            param_id=message.param_id,
            param_index=message.__dict__.get("param_index", -1),
            error=error_code,
        )
