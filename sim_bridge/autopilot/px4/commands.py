"""Command handling of PX4.

Sources: PX4, src/modules/commander/Commander.cpp (handle_command),
src/modules/navigator/navigator_main.cpp.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance
from sim_bridge.autopilot.mavlink.commands import FORCE_DISARM, Command, int_or_default
from sim_bridge.autopilot.mavlink.enums import Cmd, MavResult, ModeFlag, Severity
from sim_bridge.autopilot.mavlink.message_table import SPECS_BY_ID
from sim_bridge.autopilot.px4.checks import Px4Checks
from sim_bridge.autopilot.px4.failsafe import Px4Failsafe
from sim_bridge.autopilot.px4.mission import Px4Mission
from sim_bridge.autopilot.px4.mode_numbers import MODES, NAMES
from sim_bridge.autopilot.px4.modes import Px4Modes
from sim_bridge.autopilot.px4.payload import Px4Payload
from sim_bridge.autopilot.px4.telemetry import NOT_ON_REQUEST
from sim_bridge.autopilot.services.commands import CommonCommands, Handler
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.state import VehicleState

_UNHANDLED_COMMANDS = Cmd.GET_HOME_POSITION
"""UNSUPPORTED in PX4 1.18: REQUEST_MESSAGE replaces it."""


@dataclass(slots=True)
class Px4Commands:
    """Handlers of PX4's commands by number, in `handlers`."""

    _state: VehicleState
    _radio: Radio
    _commander: Commander
    _guidance: Guidance
    _checks: Px4Checks
    _mission: Px4Mission
    _modes: Px4Modes
    _payload: Px4Payload
    _failsafe: Px4Failsafe
    _common: CommonCommands
    _reboot_now: Callable[[], None]
    handlers: dict[int, Handler] = field(init=False)

    def __post_init__(self) -> None:
        self.handlers = {
            **{
                n: handler
                for n, handler in self._common.handlers.items()
                if n != _UNHANDLED_COMMANDS
            },
            Cmd.SET_MESSAGE_INTERVAL: self._set_message_interval,
            Cmd.DO_SET_MODE: self._do_set_mode,
            Cmd.COMPONENT_ARM_DISARM: self._arm_disarm,
            Cmd.NAV_TAKEOFF: self._start_takeoff_mode,
            Cmd.NAV_RETURN_TO_LAUNCH: partial(self._change_mode, Mode.RTL),
            Cmd.NAV_LAND: partial(self._change_mode, Mode.LAND),
            Cmd.DO_REPOSITION: self._start_hold_reposition,
            Cmd.DO_CHANGE_SPEED: self._change_speed,
            Cmd.MISSION_START: self._start_mission_mode_and_arm,
            Cmd.PREFLIGHT_REBOOT_SHUTDOWN: self._reboot_if_disarmed,
            Cmd.RUN_PREARM_CHECKS: self._reply_accepted,
            Cmd.DO_GRIPPER: self._operate_gripper,
            Cmd.DO_SET_ACTUATOR: self._set_actuator,
            Cmd.DO_WINCH: self._ignore_without_reply,
            Cmd.DO_SET_ROI: self._reply_accepted,
            Cmd.DO_SET_ROI_LOCATION: self._reply_accepted,
            Cmd.DO_SET_ROI_NONE: self._reply_accepted,
        }

    def _change_mode(self, mode: Mode, command: Command) -> MavResult:
        """A navigation command that is only a change of mode."""
        return self.set_mode_if_allowed(mode, command.sender_system_and_component)

    def set_mode_if_allowed(self, mode: Mode | None, requester_ids: tuple[int, int]) -> MavResult:
        """Accept any mode when disarmed; when armed, only one that can run. `requester_ids`: the
        requesting sender."""
        if mode is None:
            return MavResult.TEMPORARILY_REJECTED
        if self._state.is_armed and not self._checks.can_mode_run(mode):
            self._radio.send_status_text(
                Severity.CRITICAL, f"Switching to mode '{NAMES[mode]}' is currently not possible"
            )
            return MavResult.TEMPORARILY_REJECTED
        self._failsafe.cancel_failsafe_actions()
        self._commander.set_mode(mode, requester_ids)
        return MavResult.ACCEPTED

    def arm_if_checks_pass(self, *, force: bool) -> MavResult:
        """Arm; a refusal is temporary."""
        if self._state.is_armed:
            return MavResult.ACCEPTED
        problem = None if force else self._checks.arming_denial_reason()
        if problem is not None:
            self._radio.send_status_text(Severity.CRITICAL, f"Arming denied: {problem}")
            return MavResult.TEMPORARILY_REJECTED
        self._commander.arm_and_set_home_if_unlocked()
        return MavResult.ACCEPTED

    def _arm_disarm(self, command: Command) -> MavResult:
        force = command.param2 == FORCE_DISARM
        if command.param1 == 1.0:
            return self.arm_if_checks_pass(force=force)
        if command.param1 != 0.0:
            return MavResult.UNSUPPORTED
        if self._state.is_armed and not self._state.is_landed and not force:
            self._radio.send_status_text(Severity.CRITICAL, "Disarming denied: not landed")
            return MavResult.TEMPORARILY_REJECTED
        self._commander.disarm()
        return MavResult.ACCEPTED

    def _do_set_mode(self, command: Command) -> MavResult:
        if not int_or_default(command.param1, 0) & ModeFlag.CUSTOM:
            return MavResult.TEMPORARILY_REJECTED
        pair = (int_or_default(command.param2), int_or_default(command.param3, 0))
        mode = MODES.get(pair if pair[0] == 4 else (pair[0], 0))
        return self.set_mode_if_allowed(mode, command.sender_system_and_component)

    def _start_takeoff_mode(self, command: Command) -> MavResult:
        """Altitude AMSL in any frame; accepted when disarmed too, then arming starts it."""
        result = self.set_mode_if_allowed(Mode.TAKEOFF, command.sender_system_and_component)
        if result is MavResult.ACCEPTED:
            self._modes.store_takeoff_height_as_down_m(command.param7)
        return result

    def _start_hold_reposition(self, command: Command) -> MavResult:
        """LONG or INT; the altitude is AMSL, in any frame; NaN keeps the current value."""
        state = self._state
        if (
            not int_or_default(command.param2, 0) & 1
        ):  # flag to change the mode is not set: Commander.cpp
            return MavResult.DENIED
        if (
            self.set_mode_if_allowed(Mode.HOLD, command.sender_system_and_component)
            is not MavResult.ACCEPTED
        ):
            return MavResult.DENIED
        if not state.is_armed:
            self._radio.send_status_text(Severity.WARNING, "Reposition is ignored while disarmed")
            return MavResult.ACCEPTED
        north, east, down = state.pos_ned_m
        if math.isfinite(command.lat_deg) and math.isfinite(command.lon_deg):
            if abs(command.lat_deg) > 90.0 or abs(command.lon_deg) > 180.0:
                return MavResult.DENIED
            north, east = state.frame.to_ne_m(command.lat_deg, command.lon_deg)
        if math.isfinite(command.param7):
            down = state.frame.alt_amsl_m - command.param7
        if math.isfinite(command.param1) and command.param1 > 0.0:
            self._guidance.speed_override_mps = command.param1
        yaw = math.radians(command.param4) if math.isfinite(command.param4) else None
        self._modes.start_hold_reposition((north, east, down), yaw)
        return MavResult.ACCEPTED

    def _change_speed(self, command: Command) -> MavResult:
        """Acknowledge any type and value, even without an effect."""
        self._mission.set_speed_now_or_at_next_item(int_or_default(command.param1), command.param2)
        return MavResult.ACCEPTED

    def _start_mission_mode_and_arm(self, command: Command) -> MavResult:
        """Switches to the mission and arms."""
        if not self._mission.has_flyable_mission:
            return MavResult.DENIED
        result = self.set_mode_if_allowed(Mode.AUTO, command.sender_system_and_component)
        return self.arm_if_checks_pass(force=False) if result is MavResult.ACCEPTED else result

    def _reboot_if_disarmed(self, command: Command) -> MavResult:
        if command.param1 not in (1.0, 3.0):
            return MavResult.DENIED if command.param1 != 0.0 else MavResult.ACCEPTED
        if self._state.is_armed:
            return MavResult.DENIED
        self._radio.send_command_ack(command, MavResult.ACCEPTED)
        self._reboot_now()
        return MavResult.ACCEPTED

    def _operate_gripper(self, command: Command) -> MavResult:
        """Source: PX4 1.18, src/modules/payload_deliverer/payload_deliverer.cpp.

        ACCEPTED if it is so already, else IN_PROGRESS and ACCEPTED when PD_GRIPPER_TO is over; in
        the meantime the same again is rejected for now.
        """
        if not self._payload.has_gripper:
            return MavResult.FAILED
        action = int_or_default(command.param2)
        if action not in (0, 1):
            return MavResult.DENIED
        if self._payload.release is (action == 0):
            is_pending = self._payload.is_command_ack_pending(Cmd.DO_GRIPPER)
            return MavResult.TEMPORARILY_REJECTED if is_pending else MavResult.ACCEPTED
        self._payload.set_gripper(action)
        self._payload.schedule_ack(command, self._state.params["PD_GRIPPER_TO"])
        return MavResult.IN_PROGRESS

    def _set_actuator(self, command: Command) -> MavResult:
        self._payload.set_release_by_actuator_value(command.param1)
        return MavResult.ACCEPTED

    def _set_message_interval(self, command: Command) -> MavResult:
        spec = SPECS_BY_ID.get(int_or_default(command.param1))
        if spec is not None and spec.name in NOT_ON_REQUEST:
            return MavResult.FAILED
        return self._common.set_message_interval(command)

    def _reply_accepted(self, command: Command) -> MavResult:
        return MavResult.ACCEPTED

    def _ignore_without_reply(self, command: Command) -> None:
        """Send no response: no module handles it."""
