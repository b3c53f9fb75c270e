"""What an autopilot does with each message that reaches it, as far as both do alike."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.commands import Command, from_int, from_long
from sim_bridge.autopilot.mavlink.enums import Result, VehicleType
from sim_bridge.autopilot.mavlink.setpoints import global_setpoint, local_setpoint

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_GCS_FORGOTTEN_S = 2.5
"""PX4, TelemetryStatus.msg, HEARTBEAT_TIMEOUT_US; only PX4 asks who is on a link."""

OnMessage = Callable[["Autopilot", int, Message], None]


def _is_for_us(ap: "Autopilot", message: Message) -> bool:
    fields = message.__dict__
    system = fields.get("target_system", fields.get("target", 0))
    return system in (0, ap.system_id) and fields.get("target_component", 0) in (0, 1)


def heartbeat(ap: "Autopilot", link_id: int, message: Message) -> None:
    """HEARTBEAT: who is there; a ground station's keeps the data link alive."""
    link = ap.radio.links[link_id]
    if message.type == VehicleType.GCS:
        link.gcs_until_s = ap.t_s + _GCS_FORGOTTEN_S
        ap.gcs_heard(message.src_system)


def timesync(ap: "Autopilot", link_id: int, message: Message) -> None:
    """TIMESYNC: answer a request; note an answer to ours."""
    if message.tc1 == 0:
        ap.radio.send(link_id, "TIMESYNC", tc1=ap.time_boot_ns, ts1=message.ts1)
    else:
        ap.timesync_echoes[link_id, message.src_system, message.src_component] = message.ts1


def ping(ap: "Autopilot", link_id: int, message: Message) -> None:
    """PING request: sent back to its sender, by PX4; ArduCopter does not answer."""
    if ap.behaviour.answers_ping and message.target_system == 0 and message.target_component == 0:
        ap.radio.send(
            link_id,
            "PING",
            time_usec=message.time_usec,
            seq=message.seq,
            target_system=message.src_system,
            target_component=message.src_component,
        )


def command_long(ap: "Autopilot", link_id: int, message: Message) -> None:
    """COMMAND_LONG."""
    _command(ap, from_long(link_id, message))


def command_int(ap: "Autopilot", link_id: int, message: Message) -> None:
    """COMMAND_INT."""
    _command(ap, from_int(link_id, message))


def _command(ap: "Autopilot", command: Command) -> None:
    handler = ap.behaviour.commands.get(command.number)
    result = Result.UNSUPPORTED if handler is None else handler(ap, command)
    if result is not None:
        ap.radio.acknowledge(command, result)


def command_ack(ap: "Autopilot", link_id: int, message: Message) -> None:
    """COMMAND_ACK: somebody answered a command of ours."""
    ap.radio.forget_own_command(message.command)


def param_request_read(ap: "Autopilot", link_id: int, message: Message) -> None:
    """PARAM_REQUEST_READ: by index, or by name when the index is -1."""
    name: str | None = message.param_id
    if message.param_index >= 0:
        name = ap.params.name_at(message.param_index)
    if name is not None and (name in ap.params or name == "_HASH_CHECK"):
        ap.radio.send_parameter(link_id, name, ap.behaviour.index_told(message.param_index))
    else:
        ap.behaviour.parameter_unknown(ap, link_id, message)


def param_request_list(ap: "Autopilot", link_id: int, message: Message) -> None:
    """PARAM_REQUEST_LIST: all of them, a few at each step."""
    ap.radio.start_parameter_list(link_id)


def param_set(ap: "Autopilot", link_id: int, message: Message) -> None:
    """PARAM_SET: the answer is the value that is then stored, whatever it is."""
    ap.behaviour.set_parameter(ap, link_id, message)


def mission(name: str) -> OnMessage:
    """A message of the mission protocol, by the name of its method there."""

    def handle(ap: "Autopilot", link_id: int, message: Message) -> None:
        getattr(ap.protocol, name)(link_id, message)

    return handle


def mission_item(ap: "Autopilot", link_id: int, message: Message) -> None:
    """MISSION_ITEM and MISSION_ITEM_INT; current = 2 is ArduPilot's old way to say go there."""
    if message.current == 2 and ap.behaviour.guided_item(ap, link_id, message):
        return
    if message.msg_name == "MISSION_ITEM":
        ap.protocol.item_float(link_id, message)
    else:
        ap.protocol.item_int(link_id, message)


def mission_set_current(ap: "Autopilot", link_id: int, message: Message) -> None:
    """MISSION_SET_CURRENT: no acknowledgement exists; MISSION_CURRENT tells."""
    ap.behaviour.mission_set_current(ap, link_id, message.seq)


def set_mode(ap: "Autopilot", link_id: int, message: Message) -> None:
    """SET_MODE, deprecated but understood by both."""
    ap.behaviour.set_mode_message(ap, link_id, message)


def position_target_local(ap: "Autopilot", link_id: int, message: Message) -> None:
    """SET_POSITION_TARGET_LOCAL_NED."""
    setpoint = local_setpoint(message, ap.here())
    if setpoint is not None:
        ap.behaviour.modes.take_setpoint(ap, setpoint)


def position_target_global(ap: "Autopilot", link_id: int, message: Message) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT."""
    setpoint = global_setpoint(message, ap.here())
    if setpoint is not None:
        ap.behaviour.modes.take_setpoint(ap, setpoint)


def rc_channels_override(ap: "Autopilot", link_id: int, message: Message) -> None:
    """RC_CHANNELS_OVERRIDE."""
    channels = [message.__dict__[f"chan{number}_raw"] for number in range(1, 19)]
    # channels 9 to 18 are extensions: an old sender's zeros mean leave alone, 65534 release
    channels[8:] = [65535 if c == 0 else 0 if c == 65534 else c for c in channels[8:]]
    ap.behaviour.override_channels(ap, message.src_system, channels)


def manual_control(ap: "Autopilot", link_id: int, message: Message) -> None:
    """MANUAL_CONTROL: a joystick, as channels 1 to 4 (z is throttle, 0 to 1000)."""
    axes = (message.y, -message.x, None, message.r)
    channels = [65535] * 18
    for index, axis in enumerate(axes):
        if axis is not None and abs(axis) <= 1000:
            channels[index] = 1500 + round(0.4 * axis)
    if abs(message.z) <= 1000:
        channels[2] = 1100 + round(0.8 * max(message.z, 0))
    ap.behaviour.override_channels(ap, message.src_system, channels)


def request_data_stream(ap: "Autopilot", link_id: int, message: Message) -> None:
    """REQUEST_DATA_STREAM: ArduPilot's groups; PX4 has none."""
    names = ap.behaviour.data_stream(message.req_stream_id)
    link = ap.radio.links[link_id]
    rate_hz = message.req_message_rate
    interval = None
    if message.start_stop and rate_hz > 0:
        interval = max(1.0 / rate_hz, ap.STEP_S)
    for name in names:
        if name != "HEARTBEAT":
            link.set_interval(name, interval, ap.t_s)


def file_transfer(ap: "Autopilot", link_id: int, message: Message) -> None:
    """FILE_TRANSFER_PROTOCOL: there are no files; every request but an answer is refused."""
    payload = message.payload.ljust(251, b"\0")
    seq, session, opcode = payload[0] | payload[1] << 8, payload[2], payload[3]
    if opcode >= 128:
        return
    nak = (seq + 1 & 0xFFFF).to_bytes(2, "little") + bytes([session, 129, 1, opcode, 0, 0])
    ap.radio.send(
        link_id,
        "FILE_TRANSFER_PROTOCOL",
        target_network=0,
        target_system=message.src_system,
        target_component=message.src_component,
        payload=(nak + bytes(4) + b"\x06").ljust(251, b"\0"),
    )


HANDLERS: dict[str, OnMessage] = {
    "HEARTBEAT": heartbeat,
    "TIMESYNC": timesync,
    "PING": ping,
    "COMMAND_LONG": command_long,
    "COMMAND_INT": command_int,
    "COMMAND_ACK": command_ack,
    "PARAM_REQUEST_READ": param_request_read,
    "PARAM_REQUEST_LIST": param_request_list,
    "PARAM_SET": param_set,
    "MISSION_COUNT": mission("count"),
    "MISSION_WRITE_PARTIAL_LIST": mission("write_partial_list"),
    "MISSION_ITEM": mission_item,
    "MISSION_ITEM_INT": mission_item,
    "MISSION_REQUEST_LIST": mission("request_list"),
    "MISSION_REQUEST": mission("request"),
    "MISSION_REQUEST_INT": mission("request"),
    "MISSION_CLEAR_ALL": mission("clear_all"),
    "MISSION_ACK": mission("ack"),
    "MISSION_SET_CURRENT": mission_set_current,
    "SET_MODE": set_mode,
    "SET_POSITION_TARGET_LOCAL_NED": position_target_local,
    "SET_POSITION_TARGET_GLOBAL_INT": position_target_global,
    "RC_CHANNELS_OVERRIDE": rc_channels_override,
    "MANUAL_CONTROL": manual_control,
    "REQUEST_DATA_STREAM": request_data_stream,
    "FILE_TRANSFER_PROTOCOL": file_transfer,
}


def handle(ap: "Autopilot", link_id: int, message: Message) -> None:
    """Act on one message, if it is meant for us and we know what it is."""
    handler = HANDLERS.get(message.msg_name)
    if handler is None or not _is_for_us(ap, message):
        return
    handler(ap, link_id, message)
