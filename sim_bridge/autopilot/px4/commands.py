"""Commands as PX4 takes them, and its conditions for modes and arming.

Sources: the measured facts; PX4, src/modules/commander/Commander.cpp (handle_command),
ModeUtil/mode_requirements.cpp, src/modules/navigator/navigator_main.cpp.
"""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.modes import NEED_POSITION, PX4_MODES, PX4_NAMES, Mode
from sim_bridge.autopilot.mavlink.commands import (
    COMMON_COMMANDS,
    FORCE_DISARM,
    Command,
    Handler,
    as_int,
    set_message_interval,
)
from sim_bridge.autopilot.mavlink.enums import Cmd, ModeFlag, Result, Severity
from sim_bridge.autopilot.mavlink.message_table import SPECS_BY_ID
from sim_bridge.autopilot.px4.telemetry import NOT_ON_REQUEST

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_GET_HOME = Cmd.GET_HOME_POSITION
"""UNSUPPORTED in PX4 1.18: REQUEST_MESSAGE has taken its place."""
_PREVENT_ARMING = frozenset({Mode.RTL, Mode.LAND, Mode.DESCEND})


def can_run(ap: "Autopilot", mode: Mode) -> bool:
    """Whether a mode's requirements are met now."""
    if mode in NEED_POSITION | {Mode.LAND} and not ap.has_position:
        return False
    if mode is Mode.AUTO:
        return ap.px4.mission_is_valid(ap)
    if mode is Mode.GUIDED:
        return ap.px4.modes.has_setpoints(ap)
    if mode in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER):
        return ap.pilot.sticks() is not None
    return True


def request_mode(ap: "Autopilot", mode: Mode | None) -> Result:
    """Disarmed, any mode is accepted; armed, only one that can run."""
    if mode is None:
        return Result.TEMPORARILY_REJECTED
    if ap.is_armed and not can_run(ap, mode):
        ap.say(
            Severity.CRITICAL, f"Switching to mode '{PX4_NAMES[mode]}' is currently not possible"
        )
        return Result.TEMPORARILY_REJECTED
    ap.px4.user_took_over(ap)
    ap.set_mode(mode)
    return Result.ACCEPTED


def arming_problem(ap: "Autopilot") -> str | None:
    """Why arming is refused now."""
    if not ap.ekf_is_ready or ap.readings is None:
        return "Resolve system health failures first"
    if ap.mode in _PREVENT_ARMING or not can_run(ap, ap.mode):
        return "Mode not suitable for takeoff" if ap.mode in _PREVENT_ARMING else "Mode not ready"
    return None


def try_to_arm(ap: "Autopilot", *, force: bool) -> Result:
    """Arm; a refusal is temporary."""
    if ap.is_armed:
        return Result.ACCEPTED
    problem = None if force else arming_problem(ap)
    if problem is not None:
        ap.say(Severity.CRITICAL, f"Arming denied: {problem}")
        return Result.TEMPORARILY_REJECTED
    ap.arm()
    return Result.ACCEPTED


def _arm_disarm(ap: "Autopilot", command: Command) -> Result:
    force = command.param2 == FORCE_DISARM
    if command.param1 == 1.0:
        return try_to_arm(ap, force=force)
    if command.param1 != 0.0:
        return Result.UNSUPPORTED
    if ap.is_armed and not ap.is_landed and not force:
        ap.say(Severity.CRITICAL, "Disarming denied: not landed")
        return Result.TEMPORARILY_REJECTED
    ap.disarm()
    return Result.ACCEPTED


def _do_set_mode(ap: "Autopilot", command: Command) -> Result:
    if not as_int(command.param1, 0) & ModeFlag.CUSTOM:
        return Result.TEMPORARILY_REJECTED
    pair = (as_int(command.param2), as_int(command.param3, 0))
    mode = PX4_MODES.get(pair if pair[0] == 4 else (pair[0], 0))
    return request_mode(ap, mode)


def mode_command(mode: Mode) -> Handler:
    """A navigation command that is only a change of mode."""

    def handle(ap: "Autopilot", command: Command) -> Result:
        return request_mode(ap, mode)

    return handle


def _takeoff(ap: "Autopilot", command: Command) -> Result:
    """Altitude AMSL, whatever the frame; disarmed it is accepted too, and arming starts it."""
    result = request_mode(ap, Mode.TAKEOFF)
    if result is Result.ACCEPTED:
        ap.px4.modes.take_off_to(ap, command.param7)
    return result


def _reposition(ap: "Autopilot", command: Command) -> Result:
    """LONG or INT; the altitude is AMSL, whatever the frame; NaN keeps what is."""
    if not as_int(command.param2, 0) & 1:  # not told to change the mode: Commander.cpp
        return Result.DENIED
    if request_mode(ap, Mode.HOLD) is not Result.ACCEPTED:
        return Result.DENIED
    if not ap.is_armed:
        ap.say(Severity.WARNING, "Reposition is ignored while disarmed")
        return Result.ACCEPTED
    north, east, down = ap.pos_ned_m
    if math.isfinite(command.lat_deg) and math.isfinite(command.lon_deg):
        if abs(command.lat_deg) > 90.0 or abs(command.lon_deg) > 180.0:
            return Result.DENIED
        north, east = ap.frame.to_ne_m(command.lat_deg, command.lon_deg)
    if math.isfinite(command.param7):
        down = ap.frame.alt_amsl_m - command.param7
    if math.isfinite(command.param1) and command.param1 > 0.0:
        ap.speed_override_mps = command.param1
    yaw = math.radians(command.param4) if math.isfinite(command.param4) else None
    ap.px4.modes.go_to(ap, (north, east, down), yaw)
    return Result.ACCEPTED


def _change_speed(ap: "Autopilot", command: Command) -> Result:
    """Any type and any value is accepted; what follows is another matter."""
    ap.px4.change_speed(ap, as_int(command.param1), command.param2)
    return Result.ACCEPTED


def _mission_start(ap: "Autopilot", command: Command) -> Result:
    """Switches to the mission and arms."""
    if not ap.px4.mission_is_valid(ap):
        return Result.DENIED
    result = request_mode(ap, Mode.AUTO)
    return try_to_arm(ap, force=False) if result is Result.ACCEPTED else result


def _reboot(ap: "Autopilot", command: Command) -> Result:
    if command.param1 not in (1.0, 3.0):
        return Result.DENIED if command.param1 != 0.0 else Result.ACCEPTED
    if ap.is_armed:
        return Result.DENIED
    ap.radio.acknowledge(command, Result.ACCEPTED)
    ap.reboot()
    return Result.ACCEPTED


def has_gripper(ap: "Autopilot") -> bool:
    """PD_GRIPPER_TYPE: -1 none, 0 servo (the default); there is no PD_GRIPPER_EN any more."""
    return ap.params["PD_GRIPPER_TYPE"] >= 0.0


def _gripper(ap: "Autopilot", command: Command) -> Result:
    """Source: PX4 1.18, src/modules/payload_deliverer/payload_deliverer.cpp.

    ACCEPTED if it is so already, else IN_PROGRESS and ACCEPTED when PD_GRIPPER_TO is over; in
    the meantime the same again is rejected for now.
    """
    if not has_gripper(ap):
        return Result.FAILED
    action = as_int(command.param2)
    if action not in (0, 1):
        return Result.DENIED
    if ap.release is (action == 0):
        busy = ap.px4.is_busy_with(Cmd.DO_GRIPPER)
        return Result.TEMPORARILY_REJECTED if busy else Result.ACCEPTED
    ap.px4.grip(ap, action)
    ap.px4.finish_later(ap, command, ap.params["PD_GRIPPER_TO"])
    return Result.IN_PROGRESS


def _actuator(ap: "Autopilot", command: Command) -> Result:
    if math.isfinite(command.param1):
        ap.release = command.param1 > 0.0
    return Result.ACCEPTED


def _set_interval(ap: "Autopilot", command: Command) -> Result:
    spec = SPECS_BY_ID.get(as_int(command.param1))
    if spec is not None and spec.name in NOT_ON_REQUEST:
        return Result.FAILED
    return set_message_interval(ap, command)


def _accepted(ap: "Autopilot", command: Command) -> Result:
    return Result.ACCEPTED


def _unanswered(ap: "Autopilot", command: Command) -> None:
    """Left to a module that is not running."""


COMMANDS: dict[int, Handler] = {
    **{number: handler for number, handler in COMMON_COMMANDS.items() if number != _GET_HOME},
    Cmd.SET_MESSAGE_INTERVAL: _set_interval,
    Cmd.DO_SET_MODE: _do_set_mode,
    Cmd.COMPONENT_ARM_DISARM: _arm_disarm,
    Cmd.NAV_TAKEOFF: _takeoff,
    Cmd.NAV_RETURN_TO_LAUNCH: mode_command(Mode.RTL),
    Cmd.NAV_LAND: mode_command(Mode.LAND),
    Cmd.DO_REPOSITION: _reposition,
    Cmd.DO_CHANGE_SPEED: _change_speed,
    Cmd.MISSION_START: _mission_start,
    Cmd.PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    Cmd.RUN_PREARM_CHECKS: _accepted,
    Cmd.DO_GRIPPER: _gripper,
    Cmd.DO_SET_ACTUATOR: _actuator,
    Cmd.DO_WINCH: _unanswered,
    Cmd.DO_SET_ROI: _accepted,
    Cmd.DO_SET_ROI_LOCATION: _accepted,
    Cmd.DO_SET_ROI_NONE: _accepted,
}
