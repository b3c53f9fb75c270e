"""Commands as ArduCopter takes them.

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
from sim_bridge.autopilot.mavlink.commands import FORCE_DISARM, Command, as_int
from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    RELATIVE_FRAMES,
    Cmd,
    MavResult,
    ModeFlag,
    Severity,
)
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
            Cmd.DO_SET_MODE: self._do_set_mode,
            Cmd.COMPONENT_ARM_DISARM: self._arm_disarm,
            Cmd.NAV_TAKEOFF: self._takeoff,
            Cmd.NAV_RETURN_TO_LAUNCH: partial(self._change_mode, Mode.RTL),
            Cmd.NAV_LAND: partial(self._change_mode, Mode.LAND),
            Cmd.NAV_LOITER_UNLIM: partial(self._change_mode, Mode.LOITER),
            Cmd.DO_REPOSITION: self._reposition,
            Cmd.DO_CHANGE_SPEED: self._change_speed,
            Cmd.DO_PAUSE_CONTINUE: self._pause_continue,
            Cmd.DO_SET_MISSION_CURRENT: self._set_mission_current,
            Cmd.MISSION_START: self._mission_start,
            Cmd.PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            Cmd.RUN_PREARM_CHECKS: self._prearm_checks,
            Cmd.DO_GRIPPER: self._gripper,
            Cmd.DO_SET_SERVO: self._servo,
            Cmd.CONDITION_YAW: self._condition_yaw,
            Cmd.DO_FENCE_ENABLE: self._fence_enable,
            Cmd.DO_WINCH: self._failed,  # there is none
            Cmd.DO_SET_ROI: self._accepted,
            Cmd.DO_SET_ROI_LOCATION: self._accepted,
            Cmd.DO_SET_ROI_NONE: self._accepted,
        }

    def _change_mode(self, mode: Mode, command: Command) -> MavResult:
        """A navigation command that is only a change of mode."""
        if self._checks.mode_problem(mode) is not None:
            return MavResult.FAILED
        self._commander.set_mode(mode, command.sender)
        return MavResult.ACCEPTED

    def request_mode(self, number: int, by: tuple[int, int]) -> MavResult:
        """Change the mode by its number, if it exists and can be entered. `by`: who asks."""
        mode = MODES.get(number)
        if mode is None:
            self._radio.say(Severity.WARNING, f"No such mode {number}")
            return MavResult.FAILED
        problem = self._checks.mode_problem(mode)
        if problem is not None:
            self._radio.say(Severity.WARNING, f"Mode change to {NAMES[mode]} failed: {problem}")
            return MavResult.FAILED
        self._commander.set_mode(mode, by)
        return MavResult.ACCEPTED

    def _do_set_mode(self, command: Command) -> MavResult:
        if not as_int(command.param1, 0) & ModeFlag.CUSTOM:
            return MavResult.DENIED
        return self.request_mode(as_int(command.param2), command.sender)

    def _arm_disarm(self, command: Command) -> MavResult:
        state = self._state
        if command.param1 == 1.0:
            if state.is_armed:
                return MavResult.ACCEPTED
            if command.param2 != _FORCE_ARM:
                problem = self._checks.arming_problem()
                if problem is not None:
                    self._radio.say(Severity.CRITICAL, f"Arm: {problem}")
                    return MavResult.FAILED
            self._commander.arm()
            return MavResult.ACCEPTED
        if command.param1 == 0.0:
            if state.is_armed and not state.is_landed and command.param2 != FORCE_DISARM:
                return MavResult.FAILED
            self._commander.disarm()
            return MavResult.ACCEPTED
        return MavResult.UNSUPPORTED

    def _takeoff(self, command: Command) -> MavResult:
        """Relative altitude; armed, in GUIDED (or with a pilot's mode, which is not simulated)."""
        state = self._state
        height = command.param7
        if command.frame is not None and command.frame not in RELATIVE_FRAMES:
            return MavResult.DENIED
        if not state.is_armed or state.mode is not Mode.GUIDED or not state.is_landed:
            return MavResult.FAILED
        if not math.isfinite(height) or height <= 0.0:
            return MavResult.FAILED
        self._guided.take_off(height)
        self._mission.allow_take_off()
        return MavResult.ACCEPTED

    def _place_of(self, command: Command) -> Vec3 | None:
        """Where a COMMAND_INT's place is, in its own frame; None if it says none."""
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

    def _reposition(self, command: Command) -> MavResult:
        """COMMAND_INT only; the frame is obeyed, the speed is not."""
        state = self._state
        if command.frame is None:
            return MavResult.UNSUPPORTED
        may_change_mode = bool(as_int(command.param2, 0) & 1)
        if state.mode is not Mode.GUIDED and not may_change_mode:
            return MavResult.DENIED
        place = self._place_of(command)
        if place is None:
            return MavResult.DENIED
        if state.mode is not Mode.GUIDED:
            if self._checks.mode_problem(Mode.GUIDED) is not None:
                return MavResult.FAILED
            self._commander.set_mode(Mode.GUIDED, command.sender)
        yaw = math.radians(command.param4) if math.isfinite(command.param4) else None
        self._modes.take_setpoint(Setpoint(state.t_s, place, None, yaw, 0.0))
        return MavResult.ACCEPTED

    def _change_speed(self, command: Command) -> MavResult:
        """Airspeed is treated as ground speed; nothing below zero."""
        kind, speed = as_int(command.param1), command.param2
        if kind not in (0, 1, 2, 3):
            return MavResult.FAILED
        if not math.isfinite(speed) or speed <= 0.0:
            return MavResult.DENIED
        self._mission.change_speed(kind, speed)
        return MavResult.ACCEPTED

    def _pause_continue(self, command: Command) -> MavResult:
        if self._state.mode is not Mode.AUTO or command.param1 not in (0.0, 1.0):
            return MavResult.DENIED if self._state.mode is Mode.AUTO else MavResult.FAILED
        if command.param1 == 0.0:
            self._mission.executor.pause()
        else:
            self._mission.executor.resume()
        return MavResult.ACCEPTED

    def _set_mission_current(self, command: Command) -> MavResult:
        if not self._mission.executor.set_current(as_int(command.param1)):
            return MavResult.FAILED
        self._radio.send_all("MISSION_CURRENT", **(self._streams["MISSION_CURRENT"]() or {}))
        return MavResult.ACCEPTED

    def _mission_start(self, command: Command) -> MavResult:
        if not self._state.is_armed or self._checks.mode_problem(Mode.AUTO) is not None:
            return MavResult.FAILED
        self._mission.allow_take_off()
        self._commander.set_mode(Mode.AUTO, command.sender)
        return MavResult.ACCEPTED

    def _reboot(self, command: Command) -> MavResult:
        if command.param1 != 1.0 or (self._state.is_armed and command.param6 != 20190226.0):
            return MavResult.FAILED
        self._radio.acknowledge(command, MavResult.ACCEPTED)
        self._reboot_now()
        return MavResult.ACCEPTED

    def _prearm_checks(self, command: Command) -> MavResult:
        if self._state.is_armed:
            return MavResult.TEMPORARILY_REJECTED
        problem = self._checks.prearm_problem()
        if problem is not None:
            self._radio.say(Severity.CRITICAL, f"PreArm: {problem}")
        return MavResult.ACCEPTED

    def _gripper(self, command: Command) -> MavResult:
        action = as_int(command.param2)
        if action not in (0, 1):
            return MavResult.DENIED
        return MavResult.ACCEPTED if self._payload.grip(action) else MavResult.FAILED

    def _servo(self, command: Command) -> MavResult:
        done = self._payload.set_servo(as_int(command.param1), as_int(command.param2))
        return MavResult.ACCEPTED if done else MavResult.FAILED

    def _condition_yaw(self, command: Command) -> MavResult:
        if not 0.0 <= command.param1 <= 360.0:
            return MavResult.FAILED
        self._mission.turn_to(command.param1, command.param3, relative=command.param4 == 1.0)
        return MavResult.ACCEPTED

    def _fence_enable(self, command: Command) -> MavResult:
        if command.param1 not in (0.0, 1.0):
            return MavResult.FAILED
        self._state.params.set("FENCE_ENABLE", command.param1)
        return MavResult.ACCEPTED

    def _failed(self, command: Command) -> MavResult:
        return MavResult.FAILED

    def _accepted(self, command: Command) -> MavResult:
        return MavResult.ACCEPTED
