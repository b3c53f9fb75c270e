"""Undefined commands and messages, and those addressed to other systems."""

from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.behaviour import Behaviours, acknowledgement
from sim_bridge.conform.client import NO_RESPONSE, Identity
from sim_bridge.conform.subject import Subject

_COMMAND = 31999
_MESSAGE = 41999
"""Numbers that no dialect defines."""
_REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
_WAYPOINT = mavlink.MAV_CMD_NAV_WAYPOINT
_SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
_VERSION = float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
_CUSTOM_MODE = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)


def _send_unknown_command_int(subject: Subject) -> str:
    return subject.client.send_command_int_and_wait_ack(_COMMAND)


def _request_unknown_interval(subject: Subject) -> str:
    return subject.client.request_message_interval(_MESSAGE, 1e6)


def _request_mode_without_flag(subject: Subject) -> str:
    _, main, sub = subject.dialect.do_set_mode_params(subject.dialect.hold)
    return subject.client.send_command_and_wait_ack(_SET_MODE, 0.0, main, sub)


def _upload_unknown_type(subject: Subject) -> str:
    subject.client.send("MISSION_COUNT", count=1, mission_type=200)
    reply = subject.client.wait_next_message(
        ("MISSION_ACK", "MISSION_REQUEST", "MISSION_REQUEST_INT"), 3.0
    )
    if reply is None:
        return NO_RESPONSE
    return f"{reply.get_type()} {getattr(reply, 'type', '')}".strip()


def _upload_item(command: int, frame: int, subject: Subject) -> str:
    return subject.upload([subject.item(command, 50.0, 0.0, 20.0, frame=frame)]).ack


def _send_to(command: int, system: int, component: int, subject: Subject) -> str:
    subject.client.send_command(command, _VERSION, target_system=system, target_component=component)
    return subject.client.wait_ack(command)


def _send_from_unknown_system(subject: Subject) -> str:
    """A command from a system that has never sent a HEARTBEAT."""
    stranger = Identity(201, 7, mavlink.MAV_TYPE_GENERIC)
    subject.client.send_command(_REQUEST, _VERSION, identity=stranger)
    ack = subject.client.wait_next_message("COMMAND_ACK", 3.0, lambda m: m.command == _REQUEST)
    return NO_RESPONSE if ack is None else f"answered to {ack.target_system}/{ack.target_component}"


def _send_after_noise(subject: Subject) -> bool:
    """Observe responses after bytes that form no frame, and after a truncated frame."""
    subject.client.send_bytes(bytes(range(256)))
    subject.client.send_bytes(b"\xfd\x21\x00\x00\x00\xff\xbe\x4c\x00\x00\x01")
    subject.client.collect_messages(0.5)
    subject.client.send_command_and_wait_ack(_REQUEST, _VERSION)  # may be lost with the cut frame
    return subject.client.send_command_and_wait_ack(_REQUEST, _VERSION) == "ACCEPTED"


BEHAVIOURS = Behaviours()
add = BEHAVIOURS.add
add("unknown/command_long", "An unknown COMMAND_LONG is", acknowledgement(_COMMAND))
add("unknown/command_int", "An unknown COMMAND_INT is", _send_unknown_command_int)
add("unknown/interval", "An interval for an unknown message is", _request_unknown_interval)
add("unknown/request", "A request for an unknown message is", acknowledgement(_REQUEST, _MESSAGE))
add("unknown/mode", "An unknown mode number is", acknowledgement(_SET_MODE, _CUSTOM_MODE, 99, 99))
add("unknown/mode_flag", "A mode without the custom-mode flag is", _request_mode_without_flag)
add("unknown/mission_type", "An upload of mission type 200 is answered", _upload_unknown_type)
add(
    "unknown/mission_command",
    "An item with an unknown command is",
    partial(_upload_item, _COMMAND, 6),
)
add("unknown/mission_frame", "An item in frame 99 is", partial(_upload_item, _WAYPOINT, 99))
add("unknown/other_system", "A command for system 77 is", partial(_send_to, _REQUEST, 77, 1))
add(
    "unknown/broadcast",
    "An unknown broadcast command is",
    partial(_send_to, _COMMAND, 0, 0),
)
add("unknown/unheard_sender", "A command from an unknown system is", _send_from_unknown_system)
add("unknown/noise", "It answers after noise on the link", _send_after_noise)
