"""What nobody has defined, and what is meant for others."""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform import missions
from sim_bridge.conform.behaviour import Behaviour
from sim_bridge.conform.client import NO_ANSWER, Identity
from sim_bridge.conform.missions import Item
from sim_bridge.conform.subject import Subject

_NO_COMMAND = 31999
_NO_MESSAGE = 41999
_REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
_VERSION = float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)


def _command_long(s: Subject) -> str:
    return s.client.command(_NO_COMMAND)


def _command_int(s: Subject) -> str:
    return s.client.command_int(_NO_COMMAND)


def _interval(s: Subject) -> str:
    return s.client.ask_interval(_NO_MESSAGE, 1e6)


def _request(s: Subject) -> str:
    return s.client.command(_REQUEST, _NO_MESSAGE)


def _mode(s: Subject) -> str:
    flag = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
    return s.client.command(mavlink.MAV_CMD_DO_SET_MODE, flag, 99.0, 99.0)


def _mode_without_flag(s: Subject) -> str:
    _, main, sub = s.dialect.mode_params(s.dialect.hold)
    return s.client.command(mavlink.MAV_CMD_DO_SET_MODE, 0.0, main, sub)


def _mission_type(s: Subject) -> str:
    s.client.send("MISSION_COUNT", count=1, mission_type=200)
    reply = s.client.hear(("MISSION_ACK", "MISSION_REQUEST", "MISSION_REQUEST_INT"), 3.0)
    if reply is None:
        return NO_ANSWER
    return f"{reply.get_type()} {getattr(reply, 'type', '')}".strip()


def _mission_command(s: Subject) -> str:
    return missions.upload(
        s.client, s.with_home([Item(_NO_COMMAND, *s.place(50.0, 0.0), 20.0)])
    ).ack


def _mission_frame(s: Subject) -> str:
    item = Item(mavlink.MAV_CMD_NAV_WAYPOINT, *s.place(50.0, 0.0), 20.0, frame=99)
    return missions.upload(s.client, s.with_home([item])).ack


def _other_system(s: Subject) -> str:
    s.client.say_command(_REQUEST, _VERSION, target_system=77, target_component=1)
    return s.client.answer_to(_REQUEST)


def _broadcast(s: Subject) -> str:
    s.client.say_command(_NO_COMMAND, target_system=0, target_component=0)
    return s.client.answer_to(_NO_COMMAND)


def _unheard_sender(s: Subject) -> str:
    """A command from a system that has never sent a HEARTBEAT."""
    stranger = Identity(201, 7, mavlink.MAV_TYPE_GENERIC)
    s.client.say_command(_REQUEST, _VERSION, as_whom=stranger)
    ack = s.client.hear("COMMAND_ACK", 3.0, lambda m: m.command == _REQUEST)
    return NO_ANSWER if ack is None else f"answered to {ack.target_system}/{ack.target_component}"


def _noise(s: Subject) -> bool:
    """Whether it still answers after bytes that are no frame, and after a frame that is cut."""
    s.client.send_bytes(bytes(range(256)))
    s.client.send_bytes(b"\xfd\x21\x00\x00\x00\xff\xbe\x4c\x00\x00\x01")
    s.client.collect(0.5)
    s.client.command(_REQUEST, _VERSION)  # may be swallowed with the cut frame
    return s.client.command(_REQUEST, _VERSION) == "ACCEPTED"


BEHAVIOURS = (
    Behaviour("unknown/command_long", "An unknown COMMAND_LONG is", _command_long),
    Behaviour("unknown/command_int", "An unknown COMMAND_INT is", _command_int),
    Behaviour("unknown/interval", "An interval for an unknown message is", _interval),
    Behaviour("unknown/request", "A request for an unknown message is", _request),
    Behaviour("unknown/mode", "An unknown mode number is", _mode),
    Behaviour("unknown/mode_flag", "A mode without the custom-mode flag is", _mode_without_flag),
    Behaviour("unknown/mission_type", "An upload of mission type 200 is answered", _mission_type),
    Behaviour("unknown/mission_command", "An item with an unknown command is", _mission_command),
    Behaviour("unknown/mission_frame", "An item in frame 99 is", _mission_frame),
    Behaviour("unknown/other_system", "A command for system 77 is", _other_system),
    Behaviour("unknown/broadcast", "An unknown command to everybody is", _broadcast),
    Behaviour("unknown/unheard_sender", "A command from a system never heard is", _unheard_sender),
    Behaviour("unknown/noise", "It answers after noise on the link", _noise),
)
