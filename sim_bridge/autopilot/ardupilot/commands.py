"""Command handling of ArduCopter.

Sources: ArduPilot, ArduCopter/GCS_MAVLink_Copter.cpp, libraries/GCS_MAVLink/GCS_Common.cpp.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial

from sim_bridge.autopilot.ardupilot.checks import ArduPilotChecks
from sim_bridge.autopilot.ardupilot.guided import ArduPilotGuided
from sim_bridge.autopilot.ardupilot.mission import ArduPilotMission
from sim_bridge.autopilot.ardupilot.mode_numbers import MODES, NAMES
from sim_bridge.autopilot.ardupilot.modes import ArduPilotModes
from sim_bridge.autopilot.ardupilot.payload import ArduPilotPayload
from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import Setpoint
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.commander import Commander
from sim_bridge.autopilot.mavlink.commands import FORCE_DISARM, Command, int_or_default
from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    RELATIVE_FRAMES,
    Cmd,
    MavResult,
    MissionState,
    ModeFlag,
    Severity,
)
from sim_bridge.autopilot.mission.executor import Phase
from sim_bridge.autopilot.services.commands import CommonCommands, Handler
from sim_bridge.autopilot.services.radio import Builder, Radio
from sim_bridge.autopilot.state import VehicleState

_FORCE_ARM = 2989.0


class ArduPilotCommands:
    """Handlers of ArduCopter's commands by number, in `handlers`."""

    def __init__(
        self,
        state: VehicleState,
        radio: Radio,
        commander: Commander,
        checks: ArduPilotChecks,
        mission: ArduPilotMission,
        modes: ArduPilotModes,
        guided: ArduPilotGuided,
        payload: ArduPilotPayload,
        streams: Mapping[str, Builder],
        common: CommonCommands,
        reboot: Callable[[], None],
    ) -> None:
        self._state = state
        self._radio = radio
        self._commander = commander
        self._checks = checks
        self._mission = mission
        self._modes = modes
        self._guided = guided
        self._payload = payload
        self._streams = streams
        self._reboot_now = reboot
        self.handlers: dict[int, Handler] = {
            **common.handlers,
            Cmd.DO_SET_MODE: self._handle_do_set_mode,
            Cmd.COMPONENT_ARM_DISARM: self._arm_or_disarm_if_allowed,
            Cmd.NAV_TAKEOFF: self._start_guided_takeoff,
            Cmd.NAV_RETURN_TO_LAUNCH: partial(self._change_mode_if_allowed, Mode.RTL),
            Cmd.NAV_LAND: partial(self._change_mode_if_allowed, Mode.LAND),
            Cmd.NAV_LOITER_UNLIM: partial(self._change_mode_if_allowed, Mode.LOITER),
            Cmd.DO_REPOSITION: self._fly_to_position_in_guided,
            Cmd.DO_CHANGE_SPEED: self._handle_change_speed,
            Cmd.DO_PAUSE_CONTINUE: self._pause_or_resume_mission,
            Cmd.DO_SET_MISSION_CURRENT: self._set_current_item_and_broadcast,
            Cmd.MISSION_START: self._enter_auto_to_start_mission,
            Cmd.PREFLIGHT_REBOOT_SHUTDOWN: self._acknowledge_and_reboot,
            Cmd.RUN_PREARM_CHECKS: self._report_prearm_problem,
            Cmd.DO_GRIPPER: self._operate_gripper,
            Cmd.DO_SET_SERVO: self._set_servo,
            Cmd.CONDITION_YAW: self._set_commanded_heading,
            Cmd.DO_FENCE_ENABLE: self._enable_or_disable_fence,
            Cmd.DO_WINCH: self._reply_failed,  # no winch is fitted
            Cmd.DO_SET_ROI: self._reply_accepted,
            Cmd.DO_SET_ROI_LOCATION: self._reply_accepted,
            Cmd.DO_SET_ROI_NONE: self._reply_accepted,
        }

    def _change_mode_if_allowed(self, mode: Mode, command: Command) -> MavResult:
        """A navigation command that is only a change of mode."""
        if self._checks.mode_entry_problem(mode) is not None:
            return MavResult.FAILED
        self._commander.set_mode(mode, command.sender_system_and_component)
        return MavResult.ACCEPTED

    def change_mode_by_number_if_allowed(
        self, mode_number: int, sender_ids: tuple[int, int]
    ) -> MavResult:
        """Change to a mode by number, if it exists and can be entered. `sender_ids`: the sender."""
        mode = MODES.get(mode_number)
        if mode is None:
            self._radio.send_status_text(Severity.WARNING, f"No such mode {mode_number}")
            return MavResult.FAILED
        problem = self._checks.mode_entry_problem(mode)
        if problem is not None:
            self._radio.send_status_text(
                Severity.WARNING, f"Mode change to {NAMES[mode]} failed: {problem}"
            )
            return MavResult.FAILED
        self._commander.set_mode(mode, sender_ids)
        return MavResult.ACCEPTED

    def _handle_do_set_mode(self, command: Command) -> MavResult:
        if not int_or_default(command.param1, 0) & ModeFlag.CUSTOM:
            return MavResult.DENIED
        return self.change_mode_by_number_if_allowed(
            int_or_default(command.param2), command.sender_system_and_component
        )

    def _arm_or_disarm_if_allowed(self, command: Command) -> MavResult:
        state = self._state
        if command.param1 == 1.0:
            if state.is_armed:
                return MavResult.ACCEPTED
            if command.param2 != _FORCE_ARM:
                problem = self._checks.arming_denial_reason()
                if problem is not None:
                    self._radio.send_status_text(Severity.CRITICAL, f"Arm: {problem}")
                    return MavResult.FAILED
            self._commander.arm_and_set_home_if_unlocked()
            return MavResult.ACCEPTED
        if command.param1 == 0.0:
            if state.is_armed and not state.is_landed and command.param2 != FORCE_DISARM:
                return MavResult.FAILED
            self._commander.disarm()
            return MavResult.ACCEPTED
        return MavResult.UNSUPPORTED

    def _start_guided_takeoff(self, command: Command) -> MavResult:
        """Relative altitude; armed, in GUIDED (or with a pilot's mode, which is not simulated)."""
        state = self._state
        height = command.param7
        if command.frame is not None and command.frame not in RELATIVE_FRAMES:
            return MavResult.DENIED
        if not state.is_armed or state.mode is not Mode.GUIDED or not state.is_landed:
            return MavResult.FAILED
        if not math.isfinite(height) or height <= 0.0:
            return MavResult.FAILED
        self._guided.start_takeoff_to_height(height)
        self._mission.allow_takeoff_without_throttle()
        return MavResult.ACCEPTED

    def _command_position_ned_m(self, command: Command) -> Vec3 | None:
        """Return the position in a COMMAND_INT, in its own frame; None without a position."""
        state = self._state
        lat, lon, alt = command.lat_deg, command.lon_deg, command.param7
        if not all(math.isfinite(number) for number in (lat, lon, alt)):
            return None
        if abs(lat) > 90.0 or abs(lon) > 180.0:
            return None
        if command.frame in AMSL_FRAMES:
            down = state.frame.alt_amsl_m - alt
        elif command.frame in RELATIVE_FRAMES:
            down = state.home_ned_m[2] - alt
        else:
            return None
        north, east = state.frame.to_ne_m(lat, lon)
        return north, east, down

    def _fly_to_position_in_guided(self, command: Command) -> MavResult:
        """COMMAND_INT only; the frame is used, the speed is ignored."""
        state = self._state
        if command.frame is None:
            return MavResult.UNSUPPORTED
        allows_mode_change = bool(int_or_default(command.param2, 0) & 1)
        if state.mode is not Mode.GUIDED and not allows_mode_change:
            return MavResult.DENIED
        position_ned_m = self._command_position_ned_m(command)
        if position_ned_m is None:
            return MavResult.DENIED
        if state.mode is not Mode.GUIDED:
            if self._checks.mode_entry_problem(Mode.GUIDED) is not None:
                return MavResult.FAILED
            self._commander.set_mode(Mode.GUIDED, command.sender_system_and_component)
        yaw = math.radians(command.param4) if math.isfinite(command.param4) else None
        self._modes.accept_setpoint_if_guided(Setpoint(state.t_s, position_ned_m, None, yaw, 0.0))
        return MavResult.ACCEPTED

    def _handle_change_speed(self, command: Command) -> MavResult:
        """Airspeed is treated as ground speed; nothing below zero."""
        kind, speed = int_or_default(command.param1), command.param2
        if kind not in (0, 1, 2, 3):
            return MavResult.FAILED
        if not math.isfinite(speed) or speed <= 0.0:
            return MavResult.DENIED
        self._mission.override_speed_by_type(kind, speed)
        return MavResult.ACCEPTED

    def _pause_or_resume_mission(self, command: Command) -> MavResult:
        if self._state.mode is not Mode.AUTO or command.param1 not in (0.0, 1.0):
            return MavResult.DENIED if self._state.mode is Mode.AUTO else MavResult.FAILED
        if command.param1 == 0.0:  # ModeAuto::pause: only on the way to a waypoint
            leg = self._mission.executor.leg
            if leg is None or leg.phase is not Phase.MOVE:
                return MavResult.FAILED
            self._mission.executor.pause()
        else:
            self._mission.executor.resume()
        return MavResult.ACCEPTED

    def _set_current_item_and_broadcast(self, command: Command) -> MavResult:
        executor = self._mission.executor
        is_reset = command.param2 == 1.0
        if is_reset and executor.is_active and executor.state != MissionState.ACTIVE:
            executor.state = MissionState.ACTIVE  # without a reset a completed mission is stopped
        if not executor.jump_to_item(int_or_default(command.param1)):
            return MavResult.FAILED
        self._radio.send_on_all_links(
            "MISSION_CURRENT", **(self._streams["MISSION_CURRENT"]() or {})
        )
        return MavResult.ACCEPTED

    def _enter_auto_to_start_mission(self, command: Command) -> MavResult:
        if not self._state.is_armed or self._checks.mode_entry_problem(Mode.AUTO) is not None:
            return MavResult.FAILED
        self._mission.allow_takeoff_without_throttle()
        self._commander.set_mode(Mode.AUTO, command.sender_system_and_component)
        return MavResult.ACCEPTED

    def _acknowledge_and_reboot(self, command: Command) -> MavResult:
        if command.param1 != 1.0 or (self._state.is_armed and command.param6 != 20190226.0):
            return MavResult.FAILED
        self._radio.send_command_ack(command, MavResult.ACCEPTED)
        self._reboot_now()
        return MavResult.ACCEPTED

    def _report_prearm_problem(self, command: Command) -> MavResult:
        if self._state.is_armed:
            return MavResult.TEMPORARILY_REJECTED
        problem = self._checks.prearm_problem()
        if problem is not None:
            self._radio.send_status_text(Severity.CRITICAL, f"PreArm: {problem}")
        return MavResult.ACCEPTED

    def _operate_gripper(self, command: Command) -> MavResult:
        action = int_or_default(command.param2)
        if action not in (0, 1):
            return MavResult.DENIED
        return (
            MavResult.ACCEPTED
            if self._payload.start_gripper_action_if_fitted(action)
            else MavResult.FAILED
        )

    def _set_servo(self, command: Command) -> MavResult:
        done = self._payload.set_servo_and_release_output(
            int_or_default(command.param1), int_or_default(command.param2)
        )
        return MavResult.ACCEPTED if done else MavResult.FAILED

    def _set_commanded_heading(self, command: Command) -> MavResult:
        if not 0.0 <= command.param1 <= 360.0:
            return MavResult.FAILED
        self._mission.set_fixed_yaw(
            command.param1, command.param3, is_relative=command.param4 == 1.0
        )
        return MavResult.ACCEPTED

    def _enable_or_disable_fence(self, command: Command) -> MavResult:
        if command.param1 not in (0.0, 1.0):
            return MavResult.FAILED
        self._state.params.set("FENCE_ENABLE", command.param1)
        return MavResult.ACCEPTED

    def _reply_failed(self, command: Command) -> MavResult:
        return MavResult.FAILED

    def _reply_accepted(self, command: Command) -> MavResult:
        return MavResult.ACCEPTED
