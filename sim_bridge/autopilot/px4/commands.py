"""Commands as PX4 takes them.

Sources: PX4, src/modules/commander/Commander.cpp (handle_command),
src/modules/navigator/navigator_main.cpp.
"""

import math
from collections.abc import Callable
from functools import partial

from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.flight.guidance import Guidance
from sim_bridge.autopilot.mavlink.commands import FORCE_DISARM, Command, as_int
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

_NOT_ANSWERED = Cmd.GET_HOME_POSITION
"""UNSUPPORTED in PX4 1.18: REQUEST_MESSAGE has taken its place."""


class Px4Commands:
    """Handlers of PX4's commands by number, in `handlers`."""

    def __init__(
        self,
        state: VehicleState,
        radio: Radio,
        commander: Commander,
        guidance: Guidance,
        checks: Px4Checks,
        mission: Px4Mission,
        modes: Px4Modes,
        payload: Px4Payload,
        failsafe: Px4Failsafe,
        common: CommonCommands,
        reboot: Callable[[], None],
    ) -> None:
        self._state = state
        self._radio = radio
        self._commander = commander
        self._guidance = guidance
        self._checks = checks
        self._mission = mission
        self._modes = modes
        self._payload = payload
        self._failsafe = failsafe
        self._common = common
        self._reboot_now = reboot
        self.handlers: dict[int, Handler] = {
            **{n: handler for n, handler in common.handlers.items() if n != _NOT_ANSWERED},
            Cmd.SET_MESSAGE_INTERVAL: self._set_interval,
            Cmd.DO_SET_MODE: self._do_set_mode,
            Cmd.COMPONENT_ARM_DISARM: self._arm_disarm,
            Cmd.NAV_TAKEOFF: self._takeoff,
            Cmd.NAV_RETURN_TO_LAUNCH: partial(self._change_mode, Mode.RTL),
            Cmd.NAV_LAND: partial(self._change_mode, Mode.LAND),
            Cmd.DO_REPOSITION: self._reposition,
            Cmd.DO_CHANGE_SPEED: self._change_speed,
            Cmd.MISSION_START: self._mission_start,
            Cmd.PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            Cmd.RUN_PREARM_CHECKS: self._accepted,
            Cmd.DO_GRIPPER: self._gripper,
            Cmd.DO_SET_ACTUATOR: self._actuator,
            Cmd.DO_WINCH: self._unanswered,
            Cmd.DO_SET_ROI: self._accepted,
            Cmd.DO_SET_ROI_LOCATION: self._accepted,
            Cmd.DO_SET_ROI_NONE: self._accepted,
        }

    def _change_mode(self, mode: Mode, command: Command) -> MavResult:
        """A navigation command that is only a change of mode."""
        return self.request_mode(mode, command.sender)

    def request_mode(self, mode: Mode | None, by: tuple[int, int]) -> MavResult:
        """Disarmed, any mode is accepted; armed, only one that can run. `by`: who asks."""
        if mode is None:
            return MavResult.TEMPORARILY_REJECTED
        if self._state.is_armed and not self._checks.can_run(mode):
            self._radio.say(
                Severity.CRITICAL, f"Switching to mode '{NAMES[mode]}' is currently not possible"
            )
            return MavResult.TEMPORARILY_REJECTED
        self._failsafe.user_took_over()
        self._commander.set_mode(mode, by)
        return MavResult.ACCEPTED

    def try_to_arm(self, *, force: bool) -> MavResult:
        """Arm; a refusal is temporary."""
        if self._state.is_armed:
            return MavResult.ACCEPTED
        problem = None if force else self._checks.arming_problem()
        if problem is not None:
            self._radio.say(Severity.CRITICAL, f"Arming denied: {problem}")
            return MavResult.TEMPORARILY_REJECTED
        self._commander.arm()
        return MavResult.ACCEPTED

    def _arm_disarm(self, command: Command) -> MavResult:
        force = command.param2 == FORCE_DISARM
        if command.param1 == 1.0:
            return self.try_to_arm(force=force)
        if command.param1 != 0.0:
            return MavResult.UNSUPPORTED
        if self._state.is_armed and not self._state.is_landed and not force:
            self._radio.say(Severity.CRITICAL, "Disarming denied: not landed")
            return MavResult.TEMPORARILY_REJECTED
        self._commander.disarm()
        return MavResult.ACCEPTED

    def _do_set_mode(self, command: Command) -> MavResult:
        if not as_int(command.param1, 0) & ModeFlag.CUSTOM:
            return MavResult.TEMPORARILY_REJECTED
        pair = (as_int(command.param2), as_int(command.param3, 0))
        mode = MODES.get(pair if pair[0] == 4 else (pair[0], 0))
        return self.request_mode(mode, command.sender)

    def _takeoff(self, command: Command) -> MavResult:
        """Altitude AMSL, whatever the frame; disarmed it is accepted too, and arming starts it."""
        result = self.request_mode(Mode.TAKEOFF, command.sender)
        if result is MavResult.ACCEPTED:
            self._modes.take_off_to(command.param7)
        return result

    def _reposition(self, command: Command) -> MavResult:
        """LONG or INT; the altitude is AMSL, whatever the frame; NaN keeps what is."""
        state = self._state
        if not as_int(command.param2, 0) & 1:  # not told to change the mode: Commander.cpp
            return MavResult.DENIED
        if self.request_mode(Mode.HOLD, command.sender) is not MavResult.ACCEPTED:
            return MavResult.DENIED
        if not state.is_armed:
            self._radio.say(Severity.WARNING, "Reposition is ignored while disarmed")
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
        self._modes.go_to((north, east, down), yaw)
        return MavResult.ACCEPTED

    def _change_speed(self, command: Command) -> MavResult:
        """Any type and any value is accepted; what follows is another matter."""
        self._mission.change_speed(as_int(command.param1), command.param2)
        return MavResult.ACCEPTED

    def _mission_start(self, command: Command) -> MavResult:
        """Switches to the mission and arms."""
        if not self._mission.is_valid:
            return MavResult.DENIED
        result = self.request_mode(Mode.AUTO, command.sender)
        return self.try_to_arm(force=False) if result is MavResult.ACCEPTED else result

    def _reboot(self, command: Command) -> MavResult:
        if command.param1 not in (1.0, 3.0):
            return MavResult.DENIED if command.param1 != 0.0 else MavResult.ACCEPTED
        if self._state.is_armed:
            return MavResult.DENIED
        self._radio.acknowledge(command, MavResult.ACCEPTED)
        self._reboot_now()
        return MavResult.ACCEPTED

    def _gripper(self, command: Command) -> MavResult:
        """Source: PX4 1.18, src/modules/payload_deliverer/payload_deliverer.cpp.

        ACCEPTED if it is so already, else IN_PROGRESS and ACCEPTED when PD_GRIPPER_TO is over; in
        the meantime the same again is rejected for now.
        """
        if not self._payload.has_gripper:
            return MavResult.FAILED
        action = as_int(command.param2)
        if action not in (0, 1):
            return MavResult.DENIED
        if self._payload.release is (action == 0):
            busy = self._payload.is_busy_with(Cmd.DO_GRIPPER)
            return MavResult.TEMPORARILY_REJECTED if busy else MavResult.ACCEPTED
        self._payload.grip(action)
        self._payload.finish_later(command, self._state.params["PD_GRIPPER_TO"])
        return MavResult.IN_PROGRESS

    def _actuator(self, command: Command) -> MavResult:
        self._payload.set_actuator(command.param1)
        return MavResult.ACCEPTED

    def _set_interval(self, command: Command) -> MavResult:
        spec = SPECS_BY_ID.get(as_int(command.param1))
        if spec is not None and spec.name in NOT_ON_REQUEST:
            return MavResult.FAILED
        return self._common.set_message_interval(command)

    def _accepted(self, command: Command) -> MavResult:
        return MavResult.ACCEPTED

    def _unanswered(self, command: Command) -> None:
        """No module answers it."""
