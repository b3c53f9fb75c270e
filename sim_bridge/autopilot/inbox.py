"""Dispatch of the messages that an autopilot receives."""

from collections.abc import Callable
from dataclasses import dataclass, field

from sim_bridge.autopilot.behaviour import AutopilotBehaviour
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.commands import Command, command_from_int, command_from_long
from sim_bridge.autopilot.mavlink.enums import MavResult, VehicleType
from sim_bridge.autopilot.services.mission_protocol import MissionProtocol
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.services.setpoints import decode_global_setpoint, decode_local_setpoint
from sim_bridge.autopilot.state import STEP_S, VehicleState

_GCS_TIMEOUT_S = 2.5
"""PX4, TelemetryStatus.msg, HEARTBEAT_TIMEOUT_US; only PX4 uses it, to identify peers of a link."""

OnMessage = Callable[[int, Message], None]
"""Takes the link and the message."""


@dataclass(slots=True)
class MessageDispatcher:
    """Hands each message to the part that acts on it.

    `timesync_echoes` holds the latest ts1 that was echoed, by (link, system, component).
    """

    _state: VehicleState
    _radio: Radio
    _behaviour: AutopilotBehaviour
    _protocol: MissionProtocol
    timesync_echoes: dict[tuple[int, int, int], int] = field(default_factory=dict)
    _handlers: dict[str, OnMessage] = field(init=False)

    def __post_init__(self) -> None:
        self._handlers = {
            "HEARTBEAT": self._record_gcs_heartbeat,
            "TIMESYNC": self._answer_timesync_or_store_echo,
            "PING": self._answer_ping_request,
            "COMMAND_LONG": self._run_command_long,
            "COMMAND_INT": self._run_command_int,
            "COMMAND_ACK": self._stop_own_command_retry,
            "PARAM_REQUEST_READ": self._send_requested_parameter,
            "PARAM_REQUEST_LIST": self._start_sending_parameter_list,
            "PARAM_SET": self._handle_param_set,
            "MISSION_COUNT": self._protocol.handle_mission_count,
            "MISSION_WRITE_PARTIAL_LIST": self._protocol.handle_write_partial_list,
            "MISSION_ITEM": self._handle_mission_item,
            "MISSION_ITEM_INT": self._handle_mission_item,
            "MISSION_REQUEST_LIST": self._protocol.handle_request_list,
            "MISSION_REQUEST": self._protocol.handle_item_request,
            "MISSION_REQUEST_INT": self._protocol.handle_item_request,
            "MISSION_CLEAR_ALL": self._protocol.handle_clear_all,
            "MISSION_ACK": self._protocol.handle_peer_ack,
            "MISSION_SET_CURRENT": self._handle_mission_set_current,
            "SET_MODE": self._handle_set_mode,
            "SET_POSITION_TARGET_LOCAL_NED": self._handle_local_setpoint,
            "SET_POSITION_TARGET_GLOBAL_INT": self._handle_global_setpoint,
            "RC_CHANNELS_OVERRIDE": self._handle_rc_channels_override,
            "MANUAL_CONTROL": self._handle_manual_control_as_rc_override,
            "REQUEST_DATA_STREAM": self._set_stream_group_interval,
            "FILE_TRANSFER_PROTOCOL": self._refuse_file_transfer,
            "SETUP_SIGNING": self._enable_signing_if_disarmed,
        }

    def handle_message_if_addressed(self, link_id: int, message: Message) -> None:
        """Handle one message if it is addressed to this vehicle and known."""
        handler = self._handlers.get(message.msg_name)
        if handler is not None and self._is_addressed_to_vehicle(message):
            handler(link_id, message)

    def _is_addressed_to_vehicle(self, message: Message) -> bool:
        fields = message.__dict__
        system = fields.get("target_system", fields.get("target", 0))
        return system in (0, self._state.system_id) and fields.get("target_component", 0) in (0, 1)

    def _record_gcs_heartbeat(self, link_id: int, message: Message) -> None:
        """HEARTBEAT: a ground station's keeps the data link alive."""
        link = self._radio.links[link_id]
        if message.type == VehicleType.GCS:
            link.gcs_until_s = self._state.t_s + _GCS_TIMEOUT_S
            self._behaviour.on_gcs_heartbeat(message.src_system)

    def _answer_timesync_or_store_echo(self, link_id: int, message: Message) -> None:
        """Handle TIMESYNC: respond to a request; store a response to the autopilot's own."""
        if message.tc1 == 0:
            self._radio.send(link_id, "TIMESYNC", tc1=self._state.time_boot_ns, ts1=message.ts1)
        else:
            self.timesync_echoes[link_id, message.src_system, message.src_component] = message.ts1

    def _enable_signing_if_disarmed(self, link_id: int, message: Message) -> None:
        """Handle SETUP_SIGNING: every link then signs, and accepts only signed frames.

        On the ground only, as in ArduPilot.
        """
        if not self._state.is_armed:
            self._radio.enable_signing(bytes(message.secret_key), message.initial_timestamp)

    def _answer_ping_request(self, link_id: int, message: Message) -> None:
        """Handle a PING request: PX4 returns it to its sender; ArduCopter does not respond."""
        is_request = message.target_system == 0 and message.target_component == 0
        if self._behaviour.responds_to_ping and is_request:
            self._radio.send(
                link_id,
                "PING",
                time_usec=message.time_usec,
                seq=message.seq,
                target_system=message.src_system,
                target_component=message.src_component,
            )

    def _run_command_long(self, link_id: int, message: Message) -> None:
        """COMMAND_LONG."""
        self._run_and_acknowledge_command(command_from_long(link_id, message))

    def _run_command_int(self, link_id: int, message: Message) -> None:
        """COMMAND_INT."""
        self._run_and_acknowledge_command(command_from_int(link_id, message))

    def _run_and_acknowledge_command(self, command: Command) -> None:
        handler = self._behaviour.commands.get(command.number)
        result = MavResult.UNSUPPORTED if handler is None else handler(command)
        if result is not None:
            self._radio.send_command_ack(command, result)

    def _stop_own_command_retry(self, link_id: int, message: Message) -> None:
        """Handle the COMMAND_ACK for the autopilot's own command."""
        self._radio.stop_command_retry(message.command)

    def _send_requested_parameter(self, link_id: int, message: Message) -> None:
        """PARAM_REQUEST_READ: by index, or by name when the index is -1."""
        name: str | None = message.param_id
        if message.param_index >= 0:
            name = self._state.params.name_at(message.param_index)
        if name is not None and (name in self._state.params or name == "_HASH_CHECK"):
            index = self._behaviour.param_value_response_index(message.param_index)
            self._radio.send_parameter(link_id, name, index)
        else:
            self._behaviour.handle_unknown_parameter_request(link_id, message)

    def _start_sending_parameter_list(self, link_id: int, message: Message) -> None:
        """PARAM_REQUEST_LIST: all of them, a few at each step."""
        self._radio.start_parameter_list(link_id)

    def _handle_param_set(self, link_id: int, message: Message) -> None:
        """Handle PARAM_SET: the response contains the value then stored."""
        self._behaviour.handle_param_set_and_respond(link_id, message)

    def _handle_mission_item(self, link_id: int, message: Message) -> None:
        """MISSION_ITEM and MISSION_ITEM_INT; current = 2 is an old command to fly there."""
        if message.current == 2 and self._behaviour.try_fly_to_guided_mission_item(
            link_id, message
        ):
            return
        if message.msg_name == "MISSION_ITEM":
            self._protocol.handle_item_float(link_id, message)
        else:
            self._protocol.handle_item_int(link_id, message)

    def _handle_mission_set_current(self, link_id: int, message: Message) -> None:
        """MISSION_SET_CURRENT: no acknowledgement exists; MISSION_CURRENT reports it."""
        self._behaviour.on_mission_set_current(link_id, message.seq)

    def _handle_set_mode(self, link_id: int, message: Message) -> None:
        """SET_MODE: deprecated, but both take it."""
        self._behaviour.handle_set_mode_message(link_id, message)

    def _handle_local_setpoint(self, link_id: int, message: Message) -> None:
        """SET_POSITION_TARGET_LOCAL_NED."""
        setpoint = decode_local_setpoint(message, self._state)
        if setpoint is not None:
            self._behaviour.on_setpoint(setpoint)

    def _handle_global_setpoint(self, link_id: int, message: Message) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT."""
        setpoint = decode_global_setpoint(message, self._state)
        if setpoint is not None:
            self._behaviour.on_setpoint(setpoint)

    def _handle_rc_channels_override(self, link_id: int, message: Message) -> None:
        """RC_CHANNELS_OVERRIDE."""
        channels = [message.__dict__[f"chan{number}_raw"] for number in range(1, 19)]
        # channels 9 to 18 are extensions: an old sender's zeros mean leave alone, 65534 release
        channels[8:] = [65535 if c == 0 else 0 if c == 65534 else c for c in channels[8:]]
        self._behaviour.on_rc_override(message.src_system, channels)

    def _handle_manual_control_as_rc_override(self, link_id: int, message: Message) -> None:
        """MANUAL_CONTROL: a joystick, as channels 1 to 4 (z is throttle, 0 to 1000)."""
        axes = (message.y, -message.x, None, message.r)
        channels = [65535] * 18
        for index, axis in enumerate(axes):
            if axis is not None and abs(axis) <= 1000:
                channels[index] = 1500 + round(0.4 * axis)
        if abs(message.z) <= 1000:
            channels[2] = 1100 + round(0.8 * max(message.z, 0))
        self._behaviour.on_rc_override(message.src_system, channels)

    def _set_stream_group_interval(self, link_id: int, message: Message) -> None:
        """REQUEST_DATA_STREAM: ArduPilot's groups; PX4 has none."""
        names = self._behaviour.message_names_of_stream_group(message.req_stream_id)
        link = self._radio.links[link_id]
        rate_hz = message.req_message_rate
        interval = None
        if message.start_stop and rate_hz > 0:
            interval = max(1.0 / rate_hz, STEP_S)
        for name in names:
            if name != "HEARTBEAT":
                link.set_message_interval(name, interval, self._state.t_s)

    def _refuse_file_transfer(self, link_id: int, message: Message) -> None:
        """FILE_TRANSFER_PROTOCOL: there are no files; every request is refused."""
        payload = message.payload.ljust(251, b"\0")
        seq, session, opcode = payload[0] | payload[1] << 8, payload[2], payload[3]
        if opcode >= 128:
            return
        nak = (seq + 1 & 0xFFFF).to_bytes(2, "little") + bytes([session, 129, 1, opcode, 0, 0])
        self._radio.send(
            link_id,
            "FILE_TRANSFER_PROTOCOL",
            target_network=0,
            target_system=message.src_system,
            target_component=message.src_component,
            payload=(nak + bytes(4) + b"\x06").ljust(251, b"\0"),
        )
