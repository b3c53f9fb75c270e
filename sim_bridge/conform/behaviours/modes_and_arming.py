"""Modes by their numbers, what arming asks for, take-off."""

import math
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviour, Finding, Where
from sim_bridge.conform.behaviours.mission import TAKEOFF, waypoint
from sim_bridge.conform.errors import CannotSee
from sim_bridge.conform.missions import Item
from sim_bridge.conform.subject import HEIGHT_M, Subject

_HOME_TOLERANCE_M = 3.0
_STICK_MODE = {"px4": "POSCTL", "ardupilot": "LOITER"}


def _wanted(s: Subject, role: str) -> str:
    roles = {
        "hold": s.dialect.hold,
        "mission": s.dialect.mission,
        "guided": s.dialect.guided,
        "pilot": _STICK_MODE[s.dialect.name],
    }
    return roles.get(role, role)


def _mode(role: str, s: Subject) -> str:
    """Ask for a mode; the answer, and what HEARTBEAT says 2 s later."""
    mode = _wanted(s, role)
    answer = s.set_mode(mode)
    s.client.collect(2.0)
    return f"{answer}, {'there' if s.mode == mode else s.mode}"


def _mode_number(role: str, s: Subject) -> int:
    mode = _wanted(s, role)
    s.enter(mode)
    return s.client.latest["HEARTBEAT"].custom_mode


def _mission_mode_with_mission(s: Subject) -> str:
    _upload_short(s)
    return _mode("mission", s)


def _upload_short(s: Subject) -> None:
    items = [Item(TAKEOFF, *s.place(0.0, 0.0), 8.0, param4=math.nan), waypoint(s, 20.0, 0.0, 8.0)]
    done = s.upload(items)
    if done.ack != "ACCEPTED":
        raise CannotSee(f"the mission was not taken: {done.ack}")


def _old_set_mode(s: Subject) -> str:
    """SET_MODE, the message: which acknowledgement comes."""
    number = s.dialect.modes["RTL" if s.is_px4 else "LOITER"]
    flag = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    s.client.send("SET_MODE", base_mode=flag, custom_mode=number)
    ack = s.client.hear("COMMAND_ACK", 2.0)
    s.client.collect(1.5)
    there = s.client.latest["HEARTBEAT"].custom_mode == number
    word = "no COMMAND_ACK" if ack is None else f"COMMAND_ACK for {ack.command}"
    return f"{word}, {'there' if there else 'not there'}"


def _nav_command(number: int, mode: str, s: Subject) -> str:
    """A navigation command on the ground, disarmed, that is only a mode."""
    answer = s.client.command(number)
    s.client.collect(2.0)
    return f"{answer}, {'there' if s.mode == mode else 'not there'}"


def _arm_in_hold(s: Subject) -> str:
    answer = s.arm_once()
    s.client.collect(1.5)
    armed = s.is_armed
    s.disarm_once()
    return f"{answer}, {'armed' if armed else 'not armed'}"


def _arm_in(mode: str, s: Subject) -> str:
    """Arm in a mode, without a radio control."""
    if s.set_mode(mode) != "ACCEPTED":
        return f"{mode} is refused"
    s.client.collect(1.5)
    answer = s.arm_once()
    s.client.collect(1.5)
    armed = s.is_armed
    s.disarm_once()
    return f"{answer}, {'armed' if armed else 'not armed'}"


def _arm_in_pilots_mode(s: Subject) -> str:
    return _arm_in(_STICK_MODE[s.dialect.name], s)


def _arm_in_mission(s: Subject) -> str:
    """With a mission that begins with a take-off."""
    _upload_short(s)
    s.set_mode(s.dialect.mission)
    s.client.collect(1.5)
    if s.mode != s.dialect.mission:
        return "the mode is refused"
    answer = s.arm_once()
    took_off = s.client.until(lambda: not s.is_on_ground, 12.0)
    return f"{answer}, {'takes off' if took_off else 'stays'}"


def _arm_in_mission_without(s: Subject) -> str:
    s.set_mode(s.dialect.mission)
    s.client.collect(1.5)
    if s.mode != s.dialect.mission:
        return "the mode is refused"
    return s.arm_once()


def _idle_disarm(s: Subject) -> float:
    """Armed on the ground, nothing else."""
    if s.arm_once() != "ACCEPTED" or not s.client.until(lambda: s.is_armed, 3.0):
        raise CannotSee("it does not arm")
    start_s = s.client.t_s
    if not s.client.until(lambda: not s.is_armed, 40.0):
        return math.inf
    return round(s.client.t_s - start_s, 1)


def _takeoff_disarmed(s: Subject) -> str:
    alt_m = s.home_amsl_m + HEIGHT_M if s.is_px4 else HEIGHT_M
    nan = math.nan
    params = (nan, 0, 0, nan, nan, nan, alt_m) if s.is_px4 else (0, 0, 0, 0, 0, 0, alt_m)
    answer = s.client.command(mavlink.MAV_CMD_NAV_TAKEOFF, *params)
    s.client.collect(2.0)
    return f"{answer}, {s.mode}"


def _takeoff_altitude(s: Subject) -> Finding:
    """What the take-off of the suite itself asked, and got."""
    if s.climbed is None:
        raise CannotSee("it has not been seen to take off")
    asked_m, top = s.climbed
    note = f"{asked_m:.1f} m asked; {top.rel_m:.1f} m above home, {top.amsl_m:.1f} m AMSL"
    if abs(s.home_amsl_m) < 2.0 * _HOME_TOLERANCE_M:
        raise CannotSee(f"home is at {s.home_amsl_m:.1f} m AMSL: no telling one from the other")
    if abs(top.rel_m - asked_m) < _HOME_TOLERANCE_M:
        return Finding("above home", note)
    return Finding("AMSL" if abs(top.amsl_m - asked_m) < _HOME_TOLERANCE_M else "neither", note)


def _mode_after_takeoff(s: Subject) -> str:
    """Flown anew, since the suite itself goes to the holding mode."""
    s.take_off()
    s.client.collect(2.0)
    return s.mode


def _disarm_in_air(s: Subject) -> str:
    answer = s.disarm_once()
    s.client.collect(1.5)
    return f"{answer}, {'armed' if s.is_armed else 'disarmed'}"


def _arm_again(s: Subject) -> str:
    return s.arm_once()


def _land_after(s: Subject) -> Finding:
    """LAND from the hover: from the ground contact that it tells to disarmed."""
    s.take_off(8.0)
    s.enter("LAND")
    if not s.client.until(lambda: s.is_on_ground, 90.0):
        raise CannotSee("it does not land")
    down_s = s.client.t_s
    s.client.until(lambda: not s.is_armed, 30.0)
    took_s = s.client.t_s - down_s
    word = "stays armed" if s.is_armed else "within 1.5 s" if took_s < 1.5 else "after 1.5 to 5 s"
    return Finding(word, f"{took_s:.1f} s, by HEARTBEAT")


def _prearm_check(s: Subject) -> str:
    return s.client.command(mavlink.MAV_CMD_RUN_PREARM_CHECKS)


def _home_set(s: Subject) -> str:
    answer = s.client.command(mavlink.MAV_CMD_GET_HOME_POSITION)
    came = s.client.hear("HOME_POSITION", 2.0)
    return f"{answer}, {'sent' if came is not None else 'not sent'}"


BEHAVIOURS = (
    *(
        Behaviour(f"modes/{role.lower()}", f"{says}, disarmed, is", partial(_mode, role))
        for role, says in (
            ("mission", "The mission mode without a mission"),
            ("guided", "The mode for set-points"),
            ("pilot", "The pilot's position mode without a pilot"),
            ("RTL", "RTL"),
            ("LAND", "LAND"),
        )
    ),
    Behaviour("modes/mission_loaded", "The mission mode with one is", _mission_mode_with_mission),
    *(
        Behaviour(
            f"modes/number_{role.lower()}",
            f"HEARTBEAT.custom_mode for {says} is",
            partial(_mode_number, role),
            Where.AIR if role in ("RTL", "LAND") else Where.GROUND,
        )
        for role, says in (("hold", "holding"), ("RTL", "RTL"), ("LAND", "LAND"))
    ),
    Behaviour("modes/old_set_mode", "SET_MODE is answered by", _old_set_mode),
    Behaviour(
        "modes/command_rtl",
        "NAV_RETURN_TO_LAUNCH, disarmed, is",
        partial(_nav_command, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, "RTL"),
    ),
    Behaviour(
        "modes/command_land",
        "NAV_LAND, disarmed, is",
        partial(_nav_command, mavlink.MAV_CMD_NAV_LAND, "LAND"),
    ),
    Behaviour("modes/home", "GET_HOME_POSITION is", _home_set),
    Behaviour("arming/prearm_command", "RUN_PREARM_CHECKS is", _prearm_check),
    Behaviour("arming/hold", "Arming in the holding mode is", _arm_in_hold),
    Behaviour("arming/rtl", "Arming in RTL is", partial(_arm_in, "RTL")),
    Behaviour("arming/land", "Arming in LAND is", partial(_arm_in, "LAND")),
    Behaviour("arming/pilot", "Arming in the pilot's mode without a pilot is", _arm_in_pilots_mode),
    Behaviour(
        "arming/mission_empty", "Arming in an empty mission mode is", _arm_in_mission_without
    ),
    Behaviour("arming/mission", "Arming in the mission mode is", _arm_in_mission),
    Behaviour(
        "arming/idle",
        "Armed and left on the ground it disarms after",
        _idle_disarm,
        unit="s",
        within=2.5,
    ),
    Behaviour("takeoff/disarmed", "NAV_TAKEOFF while disarmed is", _takeoff_disarmed),
    Behaviour("takeoff/altitude", "NAV_TAKEOFF's altitude is", _takeoff_altitude, Where.AIR),
    Behaviour(
        "takeoff/mode_after", "The mode after a take-off is", _mode_after_takeoff, Where.FLIGHT
    ),
    Behaviour("arming/disarm_in_air", "Disarming in the air is", _disarm_in_air, Where.AIR),
    Behaviour("arming/armed_already", "Arming when armed is", _arm_again, Where.AIR),
    Behaviour("arming/after_land", "After LAND it disarms", _land_after, Where.FLIGHT),
)
