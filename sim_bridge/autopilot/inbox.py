"""What an autopilot does with each message that reaches it."""

from collections.abc import Callable

from sim_bridge.autopilot.behaviour import AutopilotBehaviour
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.commands import Command, from_int, from_long
from sim_bridge.autopilot.mavlink.enums import MavResult, VehicleType
from sim_bridge.autopilot.services.mission_protocol import MissionProtocol
from sim_bridge.autopilot.services.radio import Radio
from sim_bridge.autopilot.services.setpoints import global_setpoint, local_setpoint
from sim_bridge.autopilot.state import STEP_S, VehicleState

_GCS_FORGOTTEN_S = 2.5
"""PX4, TelemetryStatus.msg, HEARTBEAT_TIMEOUT_US; only PX4 asks who is on a link."""

OnMessage = Callable[[int, Message], None]
"""Takes the link and the message."""


class Inbox:
    """Hands each message to the part that acts on it.

    `timesync_echoes` holds the latest ts1 that was echoed, by (link, system, component).
    """

    def __init__(
        self,
        state: VehicleState,
        radio: Radio,
        behaviour: AutopilotBehaviour,
        protocol: MissionProtocol,
    ) -> None:
        self._state = state
        self._radio = radio
        self._behaviour = behaviour
        self._protocol = protocol
        self.timesync_echoes: dict[tuple[int, int, int], int] = {}
        self._handlers: dict[str, OnMessage] = {
            "HEARTBEAT": self._heartbeat,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "COMMAND_LONG": self._command_long,
            "COMMAND_INT": self._command_int,
            "COMMAND_ACK": self._command_ack,
            "PARAM_REQUEST_READ": self._param_request_read,
            "PARAM_REQUEST_LIST": self._param_request_list,
            "PARAM_SET": self._param_set,
            "MISSION_COUNT": protocol.count,
            "MISSION_WRITE_PARTIAL_LIST": protocol.write_partial_list,
            "MISSION_ITEM": self._mission_item,
            "MISSION_ITEM_INT": self._mission_item,
            "MISSION_REQUEST_LIST": protocol.request_list,
            "MISSION_REQUEST": protocol.request,
            "MISSION_REQUEST_INT": protocol.request,
            "MISSION_CLEAR_ALL": protocol.clear_all,
            "MISSION_ACK": protocol.ack,
            "MISSION_SET_CURRENT": self._mission_set_current,
            "SET_MODE": self._set_mode,
            "SET_POSITION_TARGET_LOCAL_NED": self._position_target_local,
            "SET_POSITION_TARGET_GLOBAL_INT": self._position_target_global,
            "RC_CHANNELS_OVERRIDE": self._rc_channels_override,
            "MANUAL_CONTROL": self._manual_control,
            "REQUEST_DATA_STREAM": self._request_data_stream,
            "FILE_TRANSFER_PROTOCOL": self._file_transfer,
            "SETUP_SIGNING": self._setup_signing,
        }

    def handle(self, link_id: int, message: Message) -> None:
        """Act on one message, if it is meant for us and known."""
        handler = self._handlers.get(message.msg_name)
        if handler is not None and self._is_for_us(message):
            handler(link_id, message)

    def _is_for_us(self, message: Message) -> bool:
        fields = message.__dict__
        system = fields.get("target_system", fields.get("target", 0))
        return system in (0, self._state.system_id) and fields.get("target_component", 0) in (0, 1)

    def _heartbeat(self, link_id: int, message: Message) -> None:
        """HEARTBEAT: a ground station's keeps the data link alive."""
        link = self._radio.links[link_id]
        if message.type == VehicleType.GCS:
            link.gcs_until_s = self._state.t_s + _GCS_FORGOTTEN_S
            self._behaviour.gcs_heard(message.src_system)

    def _timesync(self, link_id: int, message: Message) -> None:
        """TIMESYNC: answer a request; note an answer to ours."""
        if message.tc1 == 0:
            self._radio.send(link_id, "TIMESYNC", tc1=self._state.time_boot_ns, ts1=message.ts1)
        else:
            self.timesync_echoes[link_id, message.src_system, message.src_component] = message.ts1

    def _setup_signing(self, link_id: int, message: Message) -> None:
        """SETUP_SIGNING: from now on every link signs and hears only what is signed.

        On the ground only, as ArduPilot has it.
        """
        if not self._state.is_armed:
            self._radio.sign(bytes(message.secret_key), message.initial_timestamp)

    def _ping(self, link_id: int, message: Message) -> None:
        """PING request: sent back to its sender, by PX4; ArduCopter does not answer."""
        is_request = message.target_system == 0 and message.target_component == 0
        if self._behaviour.answers_ping and is_request:
            self._radio.send(
                link_id,
                "PING",
                time_usec=message.time_usec,
                seq=message.seq,
                target_system=message.src_system,
                target_component=message.src_component,
            )

    def _command_long(self, link_id: int, message: Message) -> None:
        """COMMAND_LONG."""
        self._run(from_long(link_id, message))

    def _command_int(self, link_id: int, message: Message) -> None:
        """COMMAND_INT."""
        self._run(from_int(link_id, message))

    def _run(self, command: Command) -> None:
        handler = self._behaviour.commands.get(command.number)
        result = MavResult.UNSUPPORTED if handler is None else handler(command)
        if result is not None:
            self._radio.acknowledge(command, result)

    def _command_ack(self, link_id: int, message: Message) -> None:
        """COMMAND_ACK: a command of ours was answered."""
        self._radio.forget_own_command(message.command)

    def _param_request_read(self, link_id: int, message: Message) -> None:
        """PARAM_REQUEST_READ: by index, or by name when the index is -1."""
        name: str | None = message.param_id
        if message.param_index >= 0:
            name = self._state.params.name_at(message.param_index)
        if name is not None and (name in self._state.params or name == "_HASH_CHECK"):
            index = self._behaviour.answered_index(message.param_index)
            self._radio.send_parameter(link_id, name, index)
        else:
            self._behaviour.parameter_unknown(link_id, message)

    def _param_request_list(self, link_id: int, message: Message) -> None:
        """PARAM_REQUEST_LIST: all of them, a few at each step."""
        self._radio.start_parameter_list(link_id)

    def _param_set(self, link_id: int, message: Message) -> None:
        """PARAM_SET: the answer is the value that is then stored."""
        self._behaviour.set_parameter(link_id, message)

    def _mission_item(self, link_id: int, message: Message) -> None:
        """MISSION_ITEM and MISSION_ITEM_INT; current = 2 is an old command to fly there."""
        if message.current == 2 and self._behaviour.guided_item(link_id, message):
            return
        if message.msg_name == "MISSION_ITEM":
            self._protocol.item_float(link_id, message)
        else:
            self._protocol.item_int(link_id, message)

    def _mission_set_current(self, link_id: int, message: Message) -> None:
        """MISSION_SET_CURRENT: no acknowledgement exists; MISSION_CURRENT reports it."""
        self._behaviour.mission_set_current(link_id, message.seq)

    def _set_mode(self, link_id: int, message: Message) -> None:
        """SET_MODE: deprecated, but both take it."""
        self._behaviour.set_mode_message(link_id, message)

    def _position_target_local(self, link_id: int, message: Message) -> None:
        """SET_POSITION_TARGET_LOCAL_NED."""
        setpoint = local_setpoint(message, self._state)
        if setpoint is not None:
            self._behaviour.take_setpoint(setpoint)

    def _position_target_global(self, link_id: int, message: Message) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT."""
        setpoint = global_setpoint(message, self._state)
        if setpoint is not None:
            self._behaviour.take_setpoint(setpoint)

    def _rc_channels_override(self, link_id: int, message: Message) -> None:
        """RC_CHANNELS_OVERRIDE."""
        channels = [message.__dict__[f"chan{number}_raw"] for number in range(1, 19)]
        # channels 9 to 18 are extensions: an old sender's zeros mean leave alone, 65534 release
        channels[8:] = [65535 if c == 0 else 0 if c == 65534 else c for c in channels[8:]]
        self._behaviour.override_channels(message.src_system, channels)

    def _manual_control(self, link_id: int, message: Message) -> None:
        """MANUAL_CONTROL: a joystick, as channels 1 to 4 (z is throttle, 0 to 1000)."""
        axes = (message.y, -message.x, None, message.r)
        channels = [65535] * 18
        for index, axis in enumerate(axes):
            if axis is not None and abs(axis) <= 1000:
                channels[index] = 1500 + round(0.4 * axis)
        if abs(message.z) <= 1000:
            channels[2] = 1100 + round(0.8 * max(message.z, 0))
        self._behaviour.override_channels(message.src_system, channels)

    def _request_data_stream(self, link_id: int, message: Message) -> None:
        """REQUEST_DATA_STREAM: ArduPilot's groups; PX4 has none."""
        names = self._behaviour.data_stream(message.req_stream_id)
        link = self._radio.links[link_id]
        rate_hz = message.req_message_rate
        interval = None
        if message.start_stop and rate_hz > 0:
            interval = max(1.0 / rate_hz, STEP_S)
        for name in names:
            if name != "HEARTBEAT":
                link.set_interval(name, interval, self._state.t_s)

    def _file_transfer(self, link_id: int, message: Message) -> None:
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
