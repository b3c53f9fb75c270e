"""RC override, other components on the system, other stations, a home that moves, the parcel."""

from collections.abc import Callable
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import AIR, GROUND, Behaviours, Observation, acknowledgement
from sim_bridge.conform.behaviours.mission import WAYPOINT
from sim_bridge.conform.behaviours.mission_flight import start_straight_mission
from sim_bridge.conform.client import NO_RESPONSE, Identity, enum_entry_name
from sim_bridge.conform.errors import ObservationError
from sim_bridge.conform.missions import Item
from sim_bridge.conform.subject import Subject

BEHAVIOURS = Behaviours()
behaviour = BEHAVIOURS.register_as_behaviour

_OTHER_STATION = Identity(200, 190, mavlink.MAV_TYPE_GCS)
_CHANGE_SPEED = mavlink.MAV_CMD_DO_CHANGE_SPEED
_DEFLECTED = (1500, 1900, 1500, 1500)
_IGNORE = 65535
_READY_S = 90.0
_LOWER_M = 20.0
_FAR_M = 3000.0
_OTHER_LIST_EAST_M = 200.0
"""Offset east of home of the other station's list."""


def _send_rc_override_for_duration(
    subject: Subject, channel_pulses_us: tuple[int, ...], duration_s: float, sender: Identity | None
) -> None:
    """RC_CHANNELS_OVERRIDE at 20 Hz; the channels after those given are left alone."""
    end_s = subject.client.t_s + duration_s
    fields = {f"chan{i + 1}_raw": value for i, value in enumerate(channel_pulses_us)}
    fields |= {f"chan{i}_raw": _IGNORE for i in range(len(channel_pulses_us) + 1, 9)}
    while subject.client.t_s < end_s:
        subject.client.send("RC_CHANNELS_OVERRIDE", sender, **fields)
        subject.client.collect_messages(0.05)


def _send_rc_override_release(subject: Subject, sender: Identity | None = None) -> None:
    _send_rc_override_for_duration(subject, (0, 0, 0, 0), 0.3, sender)


def _is_override_in_rc_channels(sender: Identity | None, subject: Subject) -> bool:
    """Observe whether an override appears in RC_CHANNELS, on the ground."""
    _send_rc_override_release(subject)
    subject.client.collect_messages(2.0)
    subject.client.clear_received()
    _send_rc_override_for_duration(subject, _DEFLECTED, 3.0, sender)
    messages = subject.client.received_messages("RC_CHANNELS")
    seen = any(m.chan2_raw == _DEFLECTED[1] for m in messages)
    _send_rc_override_release(subject, sender)
    return seen


def _observe_stick_in_hold(
    send_for_duration: Callable[[Subject, float, float], None], subject: Subject
) -> Observation:
    """Sticks centred, then the pitch stick pushed over in 0.5 s, in the holding mode in the air."""
    send_for_duration(subject, 0.0, 2.0)
    before = subject.mode
    for tenths in range(1, 11):
        send_for_duration(subject, 0.1 * tenths, 0.04)
    send_for_duration(subject, 1.0, 1.5)
    subject.client.collect_messages(0.8)
    after = subject.mode
    _send_rc_override_release(subject)
    return Observation("nothing" if after == before else f"mode {after}", f"{before} to {after}")


def _send_pitch_override(subject: Subject, deflection: float, duration_s: float) -> None:
    pulses_us = (1500, round(1500 + 400 * deflection), 1500, 1500)
    _send_rc_override_for_duration(subject, pulses_us, duration_s, None)


def _send_manual_control(subject: Subject, deflection: float, duration_s: float) -> None:
    fields = {"x": round(1000 * deflection), "y": 0, "z": 500, "r": 0, "buttons": 0}
    end_s = subject.client.t_s + duration_s
    while subject.client.t_s < end_s:
        subject.client.send("MANUAL_CONTROL", target=subject.client.target[0], **fields)
        subject.client.collect_messages(0.05)


def _send_companion_heartbeats(subject: Subject) -> None:
    for _ in range(5):
        subject.client.send_heartbeat(subject.client.companion)
        subject.client.collect_messages(0.6)


@behaviour("foreign/heartbeat", "With a companion on its link HEARTBEAT goes on")
def _observe_heartbeat_with_companion(subject: Subject) -> str:
    """Observe whether a companion's HEARTBEAT on the link leaves the autopilot's identity
    unchanged."""
    _send_companion_heartbeats(subject)
    beats = subject.client.received_messages("HEARTBEAT")
    return "alike" if beats and len({m.custom_mode for m in beats}) == 1 else "otherwise"


@behaviour("foreign/echo", "A link hears its own companion's HEARTBEAT back")
def _is_companion_heartbeat_sent_back(subject: Subject) -> bool:
    """Observe whether the autopilot sends a companion's HEARTBEAT back on its link."""
    _send_companion_heartbeats(subject)
    companion = subject.client.companion
    return (companion.system, companion.component) in subject.client.others


@behaviour("foreign/command", "A companion's command is")
def _observe_ack_target_of_companion_command(subject: Subject) -> str:
    """A command from the vehicle's own system, another component: its target in the ACK."""
    subject.client.send_heartbeat(subject.client.companion)
    number = mavlink.MAV_CMD_REQUEST_MESSAGE
    version = float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    subject.client.send_command(number, version, identity=subject.client.companion)
    ack = subject.client.wait_next_message("COMMAND_ACK", 3.0, lambda m: m.command == number)
    return NO_RESPONSE if ack is None else f"answered to component {ack.target_component}"


@behaviour("foreign/timesync", "TIMESYNC: it")
def _observe_own_timesync_requests(subject: Subject) -> Observation:
    """Observe whether the autopilot sends TIMESYNC requests without being requested to."""
    own = [0]

    def count_request_and_continue() -> bool:
        message = subject.client.latest.get("TIMESYNC")
        if message is not None and message.tc1 == 0:
            own[0] += 1
        return False

    subject.client.wait_until(count_request_and_continue, 4.0)
    return Observation("asks" if own[0] else "only answers")


@behaviour("foreign/ping", "PING is answered")
def _is_ping_answered(subject: Subject) -> bool:
    subject.client.send("PING", time_usec=1, seq=77, target_system=0, target_component=0)
    return subject.client.wait_next_message("PING", 2.0, lambda m: m.seq == 77) is not None


def _observe_gripper_command(gripper_action: float, subject: Subject) -> Observation:
    """Send DO_GRIPPER: the first response, and those that follow within 6 s."""
    number = mavlink.MAV_CMD_DO_GRIPPER
    subject.client.clear_received()
    subject.client.send_command_and_wait_ack(number, 1.0, gripper_action)
    subject.client.collect_messages(6.0)
    acks = [m for m in subject.client.received_messages("COMMAND_ACK") if m.command == number]
    words = [enum_entry_name("MAV_RESULT", m.result) for m in acks]
    gripper_texts = [text for text in subject.client.status_texts() if "ripper" in text]
    return Observation(", then ".join(words) or NO_RESPONSE, "; ".join(gripper_texts))


@behaviour("fence/enable", "DO_FENCE_ENABLE is")
def _response_to_fence_enable(subject: Subject) -> str:
    response = subject.client.send_command_and_wait_ack(mavlink.MAV_CMD_DO_FENCE_ENABLE, 1.0)
    subject.client.collect_messages(0.5)
    subject.client.send_command_and_wait_ack(mavlink.MAV_CMD_DO_FENCE_ENABLE, 0.0)
    return response


@behaviour("acks/offboard", "OFFBOARD without set-points, disarmed, is")
def _observe_offboard_without_setpoints(subject: Subject) -> str:
    """PX4 accepts OFFBOARD without set-points while disarmed: there arming shows the difference."""
    if not subject.is_px4:
        return "there is none"
    response = subject.request_mode("OFFBOARD")
    subject.client.collect_messages(1.5)
    mode = subject.mode
    armed = subject.request_arm()
    subject.request_disarm()
    return f"{response}, {mode}, arming {armed}"


@behaviour("acks/set_home", "DO_SET_HOME to here is")
def _observe_set_home_here(subject: Subject) -> str:
    position = subject.wait_position()
    response = subject.client.send_command_and_wait_ack(mavlink.MAV_CMD_DO_SET_HOME, 1.0)
    home = subject.client.wait_next_message("HOME_POSITION", 3.0)
    if home is None:
        raise ObservationError("no HOME_POSITION")
    off = abs(home.latitude * 1e-7 - position.lat_deg) * 111_000.0
    return f"{response}, {'here' if off < 5.0 else 'elsewhere'}"


def _send_set_home_until_accepted(
    subject: Subject, depth_below_ground_m: float, north_m: float = 0.0
) -> str:
    """Send DO_SET_HOME to a position at this distance north of home and this depth below the ground
    there; repeat until an estimator that has just started accepts it.
    """
    amsl_m = subject.home_amsl_m - depth_below_ground_m
    end_s = subject.client.t_s + _READY_S
    while True:
        response = _send_set_home(subject, north_m, amsl_m)
        if response != "FAILED" or subject.is_armed or subject.client.t_s > end_s:
            return response
        subject.client.collect_messages(2.0)


@behaviour(
    "home/lower_ground",
    "DO_SET_HOME 20 m lower, disarmed, raises relative_alt by",
    unit="m",
    within=1.0,
)
@behaviour(
    "home/lower_air",
    "DO_SET_HOME 20 m lower in the air raises relative_alt by",
    AIR,
    unit="m",
    within=1.5,
)
def _measure_height_change_after_lower_home(subject: Subject) -> Observation:
    """Measure the increase of relative_alt when home is set 20 m lower; then restore home."""
    before = subject.wait_position().rel_m
    ground_m = subject.home_amsl_m
    response = _send_set_home_until_accepted(subject, _LOWER_M)
    subject.client.collect_messages(1.5)
    after = subject.wait_position().rel_m
    _restore_home(subject, ground_m)
    return Observation(round(after - before, 1), response)


@behaviour(
    "home/lower_mission",
    "DO_SET_HOME 20 m lower in a mission takes it up or down by",
    AIR,
    unit="m",
    within=3.0,
)
def _measure_mission_height_change(subject: Subject) -> Observation:
    """Measure the height change (AMSL) in a mission within 12 s after home is set 20 m lower."""
    start_straight_mission(subject)
    ground_m, before_m = subject.home_amsl_m, subject.wait_position().amsl_m
    response = _send_set_home_until_accepted(subject, _LOWER_M)
    subject.client.collect_messages(12.0)
    after_m = subject.wait_position().amsl_m
    _restore_home(subject, ground_m)
    return Observation(round(after_m - before_m, 1), response)


@behaviour("home/far_ground", "DO_SET_HOME 3 km away, disarmed, is")
@behaviour("home/far_air", "DO_SET_HOME 3 km away in the air is", AIR)
def _response_to_distant_home(subject: Subject) -> str:
    ground_m = subject.home_amsl_m
    response = _send_set_home_until_accepted(subject, 0.0, north_m=_FAR_M)
    subject.client.collect_messages(0.5)
    _restore_home(subject, ground_m)
    return response


def _restore_home(subject: Subject, ground_amsl_m: float) -> None:
    _send_set_home(subject, 0.0, ground_amsl_m)
    subject.client.collect_messages(1.5)


def _send_set_home(subject: Subject, north_m: float, amsl_m: float) -> str:
    position = (*subject.lat_lon_deg_from_home(north_m, 0.0), amsl_m)
    return subject.client.send_command_int_and_wait_ack(
        mavlink.MAV_CMD_DO_SET_HOME, position=position, frame=mavlink.MAV_FRAME_GLOBAL
    )


@behaviour("stranger/mode", "RTL by another station is", AIR)
def _observe_mode_change_by_other_station(subject: Subject) -> str:
    """DO_SET_MODE to RTL by another station, in the holding mode in the air."""
    with subject.client.use_identity(_OTHER_STATION):
        subject.client.send_heartbeat()
        response = subject.request_mode("RTL")
        subject.client.wait_until(lambda: subject.mode == "RTL", 3.0)
    return f"{response}, {'changed' if subject.mode == 'RTL' else 'as it was'}"


@behaviour("stranger/disarm", "A disarm by another station is")
def _observe_disarm_by_other_station(subject: Subject) -> str:
    """Disarm by another station, without force, of a vehicle armed on the ground by the suite."""
    subject.arm_with_retries()
    with subject.client.use_identity(_OTHER_STATION):
        subject.client.send_heartbeat()
        response = subject.request_disarm()
        subject.client.wait_until(lambda: not subject.is_armed, 3.0)
    return f"{response}, {'armed' if subject.is_armed else 'disarmed'}"


def _other_station_item(subject: Subject, further_m: float = 0.0) -> Item:
    return subject.item(WAYPOINT, 0.0, _OTHER_LIST_EAST_M + further_m, 20.0)


def _owner_of_stored_item(subject: Subject, item_index: int) -> str:
    """Return "theirs" if the item that is stored now is the other station's."""
    stored = missions.download(subject.client)
    east_deg = _other_station_item(subject).lon_deg
    is_theirs = bool(stored) and abs(stored[item_index].y * 1e-7 - east_deg) < 1e-5
    return "theirs" if is_theirs else "ours"


@behaviour("stranger/upload", "A list of equal length from another station in flight is", AIR)
def _observe_upload_by_other_station(subject: Subject) -> str:
    """Upload a list of equal length from another station, in flight; return the list stored after
    it."""
    start_straight_mission(subject)
    theirs = [_other_station_item(subject, 40.0 * n) for n in range(3)]
    with subject.client.use_identity(_OTHER_STATION):
        subject.client.send_heartbeat()
        response = subject.upload(theirs).ack
    return f"{response}, {_owner_of_stored_item(subject, subject.first_flown_seq())}"


@behaviour("stranger/edit", "An item by another station in flight is", AIR)
def _observe_partial_write_by_other_station(subject: Subject) -> str:
    """Rewrite one item from another station (a partial write), in flight."""
    start_straight_mission(subject)
    seq, items = subject.first_flown_seq() + 2, [_other_station_item(subject)]
    with subject.client.use_identity(_OTHER_STATION):
        subject.client.send_heartbeat()
        done = missions.write_partial(subject.client, seq, items)
    return f"{done.ack}, {_owner_of_stored_item(subject, -1)}"


add = BEHAVIOURS.add
_gcs_override, _other_override, _sticks, _joystick, _open, _close = (
    partial(_is_override_in_rc_channels, None),
    partial(_is_override_in_rc_channels, _OTHER_STATION),
    partial(_observe_stick_in_hold, _send_pitch_override),
    partial(_observe_stick_in_hold, _send_manual_control),
    partial(_observe_gripper_command, 0.0),
    partial(_observe_gripper_command, 1.0),
)
add("rc_override/seen", "An override of the ground station is in RC_CHANNELS", _gcs_override)
add("rc_override/stranger", "An override of another system is in RC_CHANNELS", _other_override)
add("rc_override/sticks", "A stick moved in the holding mode changes", _sticks, AIR)
add("rc_override/joystick", "MANUAL_CONTROL moved in the holding mode changes", _joystick, AIR)
add("parcel/gripper_open", "DO_GRIPPER, open, is", _open)
add("parcel/gripper_close", "DO_GRIPPER, close, is", _close)
for _name, _description, _where, _command, *_params in (
    ("parcel/servo", "DO_SET_SERVO is", GROUND, mavlink.MAV_CMD_DO_SET_SERVO, 9.0, 1700.0),
    ("parcel/actuator", "DO_SET_ACTUATOR is", GROUND, mavlink.MAV_CMD_DO_SET_ACTUATOR, 0.0),
    ("parcel/winch", "DO_WINCH is", GROUND, mavlink.MAV_CMD_DO_WINCH, 1.0),
    ("acks/roi", "DO_SET_ROI_NONE is", GROUND, mavlink.MAV_CMD_DO_SET_ROI_NONE),
    ("acks/yaw", "CONDITION_YAW in the air is", AIR, mavlink.MAV_CMD_CONDITION_YAW, 90.0),
    ("acks/loiter", "NAV_LOITER_UNLIM in the air is", AIR, mavlink.MAV_CMD_NAV_LOITER_UNLIM),
    ("acks/speed_type", "DO_CHANGE_SPEED of type 77 is", AIR, _CHANGE_SPEED, 77.0, 3.0, -1.0),
):
    add(_name, _description, acknowledgement(_command, *_params), _where)
