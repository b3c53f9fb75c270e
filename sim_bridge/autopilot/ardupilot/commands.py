"""Commands as ArduCopter takes them, and its conditions for modes and arming.

Sources: the measured facts; ArduPilot, ArduCopter/GCS_MAVLink_Copter.cpp, AP_Arming_Copter.cpp.
"""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.goals import Vec3
from sim_bridge.autopilot.flight.modes import (
    ARDUPILOT_NAMES,
    ARDUPILOT_NUMBERS,
    NEED_POSITION,
    Mode,
)
from sim_bridge.autopilot.mavlink.commands import (
    COMMON_COMMANDS,
    FORCE_DISARM,
    Command,
    Handler,
    as_int,
)
from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    RELATIVE_FRAMES,
    TERRAIN_FRAMES,
    Cmd,
    ModeFlag,
    Result,
    Severity,
)
from sim_bridge.autopilot.mavlink.setpoints import Setpoint

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

FORCE_ARM = 2989.0
PREARM_OK_AFTER_S = 36.0
_ARMABLE = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER, Mode.GUIDED, Mode.AUTO})
_AUTO_MAY_ARM = 1
_CHECKS_OFF = 0


def starts_with_takeoff(ap: "Autopilot") -> bool:
    """Whether the first navigation item is a take-off."""
    plan = ap.executor.plan
    first = plan.landing_at(plan.first, consume=False)
    if first is None:
        return False
    if plan.items[first].command == Cmd.NAV_TAKEOFF:
        return True
    return any(item.command == Cmd.NAV_TAKEOFF for item in plan.ahead(first))


def waits_for_terrain(ap: "Autopilot") -> bool:
    """Whether a mission needs terrain data; there is none without a ground station that has it."""
    return any(item.frame in TERRAIN_FRAMES for item in ap.store.mission[1:])


def prearm_problem(ap: "Autopilot") -> str | None:
    """What the pre-arm checks find, whatever the mode."""
    if ap.t_since_boot_s < PREARM_OK_AFTER_S:
        return "EKF3 still initialising" if ap.t_since_boot_s > 10.0 else "Gyros not calibrated"
    if not ap.gnss_ok:
        return "GPS 1: Bad fix"
    if waits_for_terrain(ap):
        return "waiting for terrain data"
    voltage, least = ap.battery_voltage_v, ap.params["BATT_ARM_VOLT"]
    if voltage is not None and voltage < least:
        return "Battery 1 below minimum arming voltage"
    return None


def arming_problem(ap: "Autopilot") -> str | None:
    """Why arming is refused now."""
    checking = ap.params.value("ARMING_CHECK", "ARMING_CHECK", 1.0) != _CHECKS_OFF
    if checking:
        problem = prearm_problem(ap)
        if problem is not None:
            return problem
    mode = ap.mode
    if mode not in _ARMABLE:
        return f"{ARDUPILOT_NAMES.get(mode, 'mode')} mode not armable"
    if mode in NEED_POSITION and not ap.has_position:
        return "Need Position Estimate"
    if mode is Mode.AUTO:
        if not int(ap.params["AUTO_OPTIONS"]) & _AUTO_MAY_ARM:
            return "AUTO mode not armable"
        if ap.executor.plan.is_empty:
            return "Mode requires mission"
        if not starts_with_takeoff(ap):
            return "Missing Takeoff Cmd"
    if checking and mode not in (Mode.GUIDED, Mode.AUTO):
        sticks = ap.pilot.sticks()
        if sticks is None:
            return "Throttle below Failsafe"
        if sticks.throttle > (0.05 if mode is Mode.STABILIZE else 0.6):
            return "Throttle too high"
    return None


def mode_problem(ap: "Autopilot", mode: Mode) -> str | None:
    """Why a mode cannot be entered now."""
    if ap.is_armed and mode in NEED_POSITION and not ap.has_position:
        return "requires position"
    if mode is Mode.AUTO and ap.is_armed:  # disarmed, nothing is asked of it (mode_auto.cpp, init)
        if ap.executor.plan.is_empty:
            return "init failed"
        if ap.is_landed and not starts_with_takeoff(ap):
            ap.say(Severity.CRITICAL, "Auto: Missing Takeoff Cmd")
            return "init failed"
    return None


def request_mode(ap: "Autopilot", number: int) -> Result:
    """Change the mode by its number, if it exists and can be entered."""
    mode = ARDUPILOT_NUMBERS.get(number)
    if mode is None:
        ap.say(Severity.WARNING, f"No such mode {number}")
        return Result.FAILED
    problem = mode_problem(ap, mode)
    if problem is not None:
        ap.say(Severity.WARNING, f"Mode change to {ARDUPILOT_NAMES[mode]} failed: {problem}")
        return Result.FAILED
    ap.set_mode(mode)
    return Result.ACCEPTED


def _do_set_mode(ap: "Autopilot", command: Command) -> Result:
    if not as_int(command.param1, 0) & ModeFlag.CUSTOM:
        return Result.DENIED
    return request_mode(ap, as_int(command.param2))


def _arm_disarm(ap: "Autopilot", command: Command) -> Result:
    if command.param1 == 1.0:
        if ap.is_armed:
            return Result.ACCEPTED
        if command.param2 != FORCE_ARM:
            problem = arming_problem(ap)
            if problem is not None:
                ap.say(Severity.CRITICAL, f"Arm: {problem}")
                return Result.FAILED
        ap.arm()
        return Result.ACCEPTED
    if command.param1 == 0.0:
        if ap.is_armed and not ap.is_landed and command.param2 != FORCE_DISARM:
            return Result.FAILED
        ap.disarm()
        return Result.ACCEPTED
    return Result.UNSUPPORTED


def _takeoff(ap: "Autopilot", command: Command) -> Result:
    """Relative altitude; armed, in GUIDED (or with a pilot's mode, which is not simulated)."""
    height = command.param7
    if command.frame is not None and command.frame not in RELATIVE_FRAMES:
        return Result.DENIED
    if not ap.is_armed or ap.mode is not Mode.GUIDED or not ap.is_landed:
        return Result.FAILED
    if not math.isfinite(height) or height <= 0.0:
        return Result.FAILED
    ap.takeoff_down_m = ap.home_ned_m[2] - height
    ap.hold_point = None
    ap.setpoint = None
    ap.behaviour.allow_take_off()
    return Result.ACCEPTED


def mode_command(mode: Mode) -> Handler:
    """A navigation command that is only a change of mode."""

    def handle(ap: "Autopilot", command: Command) -> Result:
        if mode_problem(ap, mode) is not None:
            return Result.FAILED
        ap.set_mode(mode)
        return Result.ACCEPTED

    return handle


def place_of_command(ap: "Autopilot", command: Command) -> Vec3 | None:
    """Where a COMMAND_INT's place is, in its own frame; None if it says none."""
    lat, lon, alt = command.lat_deg, command.lon_deg, command.param7
    if not all(math.isfinite(number) for number in (lat, lon, alt)):
        return None
    if abs(lat) > 90.0 or abs(lon) > 180.0:
        return None
    if command.frame in AMSL_FRAMES:
        down = ap.frame.alt_amsl_m - alt
    elif command.frame in RELATIVE_FRAMES:
        down = ap.home_ned_m[2] - alt
    else:
        return None
    north, east = ap.frame.to_ne_m(lat, lon)
    return north, east, down


def _reposition(ap: "Autopilot", command: Command) -> Result:
    """COMMAND_INT only; the frame is obeyed, the speed is not."""
    if command.frame is None:
        return Result.UNSUPPORTED
    may_change_mode = bool(as_int(command.param2, 0) & 1)
    if ap.mode is not Mode.GUIDED and not may_change_mode:
        return Result.DENIED
    place = place_of_command(ap, command)
    if place is None:
        return Result.DENIED
    if ap.mode is not Mode.GUIDED:
        if mode_problem(ap, Mode.GUIDED) is not None:
            return Result.FAILED
        ap.set_mode(Mode.GUIDED)
    yaw = math.radians(command.param4) if math.isfinite(command.param4) else None
    ap.behaviour.modes.take_setpoint(ap, Setpoint(ap.t_s, place, None, yaw, 0.0))
    return Result.ACCEPTED


def _change_speed(ap: "Autopilot", command: Command) -> Result:
    """Airspeed is treated as ground speed; nothing below zero."""
    kind, speed = as_int(command.param1), command.param2
    if kind not in (0, 1, 2, 3):
        return Result.FAILED
    if not math.isfinite(speed) or speed <= 0.0:
        return Result.DENIED
    ap.ardupilot.change_speed(ap, kind, speed)
    return Result.ACCEPTED


def _pause_continue(ap: "Autopilot", command: Command) -> Result:
    if ap.mode is not Mode.AUTO or command.param1 not in (0.0, 1.0):
        return Result.DENIED if ap.mode is Mode.AUTO else Result.FAILED
    if command.param1 == 0.0:
        ap.executor.pause()
    else:
        ap.executor.resume()
    return Result.ACCEPTED


def _set_mission_current(ap: "Autopilot", command: Command) -> Result:
    if not ap.executor.set_current(as_int(command.param1)):
        return Result.FAILED
    ap.behaviour.announce_current(ap)
    return Result.ACCEPTED


def _mission_start(ap: "Autopilot", command: Command) -> Result:
    if not ap.is_armed or mode_problem(ap, Mode.AUTO) is not None:
        return Result.FAILED
    ap.behaviour.allow_take_off()
    ap.set_mode(Mode.AUTO)
    return Result.ACCEPTED


def _reboot(ap: "Autopilot", command: Command) -> Result:
    if command.param1 != 1.0 or (ap.is_armed and command.param6 != 20190226.0):
        return Result.FAILED
    ap.radio.acknowledge(command, Result.ACCEPTED)
    ap.reboot()
    return Result.ACCEPTED


def _prearm_checks(ap: "Autopilot", command: Command) -> Result:
    if ap.is_armed:
        return Result.TEMPORARILY_REJECTED
    problem = prearm_problem(ap)
    if problem is not None:
        ap.say(Severity.CRITICAL, f"PreArm: {problem}")
    return Result.ACCEPTED


def _gripper(ap: "Autopilot", command: Command) -> Result:
    action = as_int(command.param2)
    if action not in (0, 1):
        return Result.DENIED
    return Result.ACCEPTED if ap.ardupilot.grip(ap, action) else Result.FAILED


def _servo(ap: "Autopilot", command: Command) -> Result:
    done = ap.ardupilot.servo(ap, as_int(command.param1), as_int(command.param2))
    return Result.ACCEPTED if done else Result.FAILED


def _condition_yaw(ap: "Autopilot", command: Command) -> Result:
    if not 0.0 <= command.param1 <= 360.0:
        return Result.FAILED
    ap.ardupilot.turn_to(ap, command.param1, command.param3, relative=command.param4 == 1.0)
    return Result.ACCEPTED


def _fence_enable(ap: "Autopilot", command: Command) -> Result:
    if command.param1 not in (0.0, 1.0):
        return Result.FAILED
    ap.params.set("FENCE_ENABLE", command.param1)
    return Result.ACCEPTED


def _failed(ap: "Autopilot", command: Command) -> Result:
    return Result.FAILED


def _accepted(ap: "Autopilot", command: Command) -> Result:
    return Result.ACCEPTED


COMMANDS: dict[int, Handler] = {
    **COMMON_COMMANDS,
    Cmd.DO_SET_MODE: _do_set_mode,
    Cmd.COMPONENT_ARM_DISARM: _arm_disarm,
    Cmd.NAV_TAKEOFF: _takeoff,
    Cmd.NAV_RETURN_TO_LAUNCH: mode_command(Mode.RTL),
    Cmd.NAV_LAND: mode_command(Mode.LAND),
    Cmd.NAV_LOITER_UNLIM: mode_command(Mode.LOITER),
    Cmd.DO_REPOSITION: _reposition,
    Cmd.DO_CHANGE_SPEED: _change_speed,
    Cmd.DO_PAUSE_CONTINUE: _pause_continue,
    Cmd.DO_SET_MISSION_CURRENT: _set_mission_current,
    Cmd.MISSION_START: _mission_start,
    Cmd.PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    Cmd.RUN_PREARM_CHECKS: _prearm_checks,
    Cmd.DO_GRIPPER: _gripper,
    Cmd.DO_SET_SERVO: _servo,
    Cmd.CONDITION_YAW: _condition_yaw,
    Cmd.DO_FENCE_ENABLE: _fence_enable,
    Cmd.DO_WINCH: _failed,  # there is none
    Cmd.DO_SET_ROI: _accepted,
    Cmd.DO_SET_ROI_LOCATION: _accepted,
    Cmd.DO_SET_ROI_NONE: _accepted,
}
