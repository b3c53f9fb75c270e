"""Mode numbers, arming requirements and take-off."""

import math
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import (
    AIR,
    FLIGHT,
    Behaviour,
    Behaviours,
    Observation,
    Where,
    acknowledgement,
)
from sim_bridge.conform.behaviours.mission import TAKEOFF, WAYPOINT
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.subject import HEIGHT_M, Subject

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_HOME_TOLERANCE_M = 3.0
_MANUAL_MODE = {"px4": "POSCTL", "ardupilot": "LOITER"}


def _mode_name_for_role(subject: Subject, role: str) -> str:
    roles = {
        "hold": subject.dialect.hold,
        "mission": subject.dialect.mission,
        "guided": subject.dialect.guided,
        "pilot": _MANUAL_MODE[subject.dialect.name],
    }
    return roles.get(role, role)


def _request_mode_and_observe(role: str, subject: Subject) -> str:
    """Request a mode; return the response, and the HEARTBEAT mode 2 s later."""
    mode = _mode_name_for_role(subject, role)
    response = subject.request_mode(mode)
    subject.client.collect_messages(2.0)
    return f"{response}, {'there' if subject.mode == mode else subject.mode}"


def _set_mode_and_read_custom_mode(role: str, subject: Subject) -> int:
    mode = _mode_name_for_role(subject, role)
    subject.set_mode_and_wait(mode)
    return subject.client.latest["HEARTBEAT"].custom_mode


@behaviour("modes/mission_loaded", "The mission mode with one is")
def _observe_mission_mode_with_mission(subject: Subject) -> str:
    _upload_short_mission(subject)
    return _request_mode_and_observe("mission", subject)


def _upload_short_mission(subject: Subject) -> None:
    takeoff = subject.item(TAKEOFF, 0.0, 0.0, 8.0, param4=math.nan)
    subject.upload_accepted([takeoff, subject.item(WAYPOINT, 20.0, 0.0, 8.0)])


@behaviour("modes/old_set_mode", "SET_MODE is answered by")
def _observe_set_mode_message(subject: Subject) -> str:
    """SET_MODE, the message: which acknowledgement comes."""
    number = subject.dialect.modes["RTL" if subject.is_px4 else "LOITER"]
    flag = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    subject.client.send("SET_MODE", base_mode=flag, custom_mode=number)
    ack = subject.client.wait_next_message("COMMAND_ACK", 2.0)
    subject.client.collect_messages(1.5)
    is_mode_set = subject.client.latest["HEARTBEAT"].custom_mode == number
    word = "no COMMAND_ACK" if ack is None else f"COMMAND_ACK for {ack.command}"
    return f"{word}, {'there' if is_mode_set else 'not there'}"


def _observe_nav_command_mode(command_number: int, expected_mode: str, subject: Subject) -> str:
    """A navigation command on the ground, disarmed, that is only a mode."""
    response = subject.client.send_command_and_wait_ack(command_number)
    subject.client.collect_messages(2.0)
    return f"{response}, {'there' if subject.mode == expected_mode else 'not there'}"


def _observe_arming_in_mode(role: str, subject: Subject) -> str:
    """Arm in a mode, without a radio control."""
    mode = _mode_name_for_role(subject, role)
    if subject.mode != mode:
        if subject.request_mode(mode) != "ACCEPTED":
            return f"{mode} is refused"
        subject.client.collect_messages(1.5)
    response = subject.request_arm()
    subject.client.collect_messages(1.5)
    armed = subject.is_armed
    subject.request_disarm()
    return f"{response}, {'armed' if armed else 'not armed'}"


@behaviour("arming/mission", "Arming in the mission mode is")
def _observe_arming_in_mission_mode(subject: Subject) -> str:
    """With a mission that begins with a take-off."""
    _upload_short_mission(subject)
    response = _arm_in_mission_mode(subject)
    has_lifted_off = subject.client.wait_until(lambda: not subject.is_on_ground, 12.0)
    return f"{response}, {'takes off' if has_lifted_off else 'stays'}"


@behaviour("arming/mission_empty", "Arming in an empty mission mode is")
def _arm_in_mission_mode(subject: Subject) -> str:
    subject.request_mode(subject.dialect.mission)
    subject.client.collect_messages(1.5)
    if subject.mode != subject.dialect.mission:
        raise ObservationError("the mode is refused")
    return subject.request_arm()


@behaviour("arming/idle", "Armed and left on the ground it disarms after", unit="s", within=2.5)
def _measure_idle_disarm_delay_s(subject: Subject) -> float:
    """Armed on the ground, nothing else."""
    if subject.request_arm() != "ACCEPTED" or not subject.client.wait_until(
        lambda: subject.is_armed, 3.0
    ):
        raise ObservationError("it does not arm")
    start_s = subject.client.t_s
    if not subject.client.wait_until(lambda: not subject.is_armed, 40.0):
        return math.inf
    return round(subject.client.t_s - start_s, 1)


@behaviour("takeoff/disarmed", "NAV_TAKEOFF while disarmed is")
def _observe_takeoff_while_disarmed(subject: Subject) -> str:
    alt_m = subject.home_amsl_m + HEIGHT_M if subject.is_px4 else HEIGHT_M
    nan = math.nan
    params = (nan, 0, 0, nan, nan, nan, alt_m) if subject.is_px4 else (0, 0, 0, 0, 0, 0, alt_m)
    response = subject.client.send_command_and_wait_ack(mavlink.MAV_CMD_NAV_TAKEOFF, *params)
    subject.client.collect_messages(2.0)
    return f"{response}, {subject.mode}"


@behaviour("takeoff/altitude", "NAV_TAKEOFF's altitude is", AIR)
def _classify_takeoff_altitude_reference(subject: Subject) -> Observation:
    """Compare the suite's own take-off: requested and reached altitude."""
    if subject.climbed is None:
        raise ObservationError("no take-off was observed")
    requested_m, top = subject.climbed
    note = f"{requested_m:.1f} m asked; {top.rel_m:.1f} m above home, {top.amsl_m:.1f} m AMSL"
    if abs(subject.home_amsl_m) < 2.0 * _HOME_TOLERANCE_M:
        raise ObservationError(
            f"home is at {subject.home_amsl_m:.1f} m AMSL: the two cannot be distinguished"
        )
    if abs(top.rel_m - requested_m) < _HOME_TOLERANCE_M:
        return Observation("above home", note)
    return Observation(
        "AMSL" if abs(top.amsl_m - requested_m) < _HOME_TOLERANCE_M else "neither", note
    )


@behaviour("takeoff/mode_after", "The mode after a take-off is", FLIGHT)
def _observe_mode_after_takeoff(subject: Subject) -> str:
    """Repeat the take-off, because the suite itself changes to the holding mode."""
    subject.take_off_and_wait()
    subject.client.collect_messages(2.0)
    return subject.mode


@behaviour("arming/disarm_in_air", "Disarming in the air is", AIR)
def _observe_disarm_in_air(subject: Subject) -> str:
    response = subject.request_disarm()
    subject.client.collect_messages(1.5)
    return f"{response}, {'armed' if subject.is_armed else 'disarmed'}"


@behaviour("arming/after_land", "After LAND it disarms", FLIGHT)
def _measure_disarm_delay_after_landing(subject: Subject) -> Observation:
    """Fly LAND from hover: measure the time from reported ground contact to disarmed."""
    subject.take_off_and_wait(8.0)
    subject.set_mode_and_wait("LAND")
    if not subject.client.wait_until(lambda: subject.is_on_ground, 90.0):
        raise ObservationError("it does not land")
    down_s = subject.client.t_s
    subject.client.wait_until(lambda: not subject.is_armed, 30.0)
    duration_s = subject.client.t_s - down_s
    word = (
        "stays armed"
        if subject.is_armed
        else "within 1.5 s"
        if duration_s < 1.5
        else "after 1.5 to 5 s"
    )
    return Observation(word, f"{duration_s:.1f} s, by HEARTBEAT")


@behaviour("modes/home", "GET_HOME_POSITION is")
def _observe_home_position_request(subject: Subject) -> str:
    response = subject.client.send_command_and_wait_ack(mavlink.MAV_CMD_GET_HOME_POSITION)
    home_message = subject.client.wait_next_message("HOME_POSITION", 2.0)
    return f"{response}, {'sent' if home_message is not None else 'not sent'}"


BEHAVIOURS.extend(
    Behaviour(
        f"modes/{role.lower()}",
        f"{description}, disarmed, is",
        partial(_request_mode_and_observe, role),
    )
    for role, description in (
        ("mission", "The mission mode without a mission"),
        ("guided", "The mode for set-points"),
        ("pilot", "The pilot's position mode without a pilot"),
        ("RTL", "RTL"),
        ("LAND", "LAND"),
    )
)
BEHAVIOURS.extend(
    Behaviour(
        f"modes/number_{role.lower()}",
        f"HEARTBEAT.custom_mode for {description} is",
        partial(_set_mode_and_read_custom_mode, role),
        Where.AIR if role in ("RTL", "LAND") else Where.GROUND,
    )
    for role, description in (("hold", "holding"), ("RTL", "RTL"), ("LAND", "LAND"))
)
add = BEHAVIOURS.add
_rtl = partial(_observe_nav_command_mode, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, "RTL")
_land = partial(_observe_nav_command_mode, mavlink.MAV_CMD_NAV_LAND, "LAND")
add("modes/command_rtl", "NAV_RETURN_TO_LAUNCH, disarmed, is", _rtl)
add("modes/command_land", "NAV_LAND, disarmed, is", _land)
for _role, _description in (
    ("hold", "Arming in the holding mode is"),
    ("pilot", "Arming in the pilot's mode without a pilot is"),
    ("RTL", "Arming in RTL is"),
    ("LAND", "Arming in LAND is"),
):
    add(f"arming/{_role.lower()}", _description, partial(_observe_arming_in_mode, _role))
_prearm_checks = acknowledgement(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
add("arming/prearm_command", "RUN_PREARM_CHECKS is", _prearm_checks)
add("arming/armed_already", "Arming when armed is", Subject.request_arm, AIR)
