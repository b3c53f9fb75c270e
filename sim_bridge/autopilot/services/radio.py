"""The autopilot's links: sending, streaming, texts, parameters, forwarding."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message, Signer
from sim_bridge.autopilot.mavlink.commands import Command
from sim_bridge.autopilot.mavlink.enums import MavResult, Severity
from sim_bridge.autopilot.mavlink.links import LinkState
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mavlink.router import Router
from sim_bridge.autopilot.mavlink.signing import Signing
from sim_bridge.autopilot.state import VehicleState

Fields = dict[str, Any]
"""Fields of one message by name, in their wire units."""
Builder = Callable[[], Fields | None]
"""Builds one message from the current state; None when there is nothing to send."""

_TEXT_SIZE = 50
_PARAMETERS_PER_STEP = 4


@dataclass(slots=True)
class _OwnCommand:
    """A command that the autopilot itself sent to companions, and may send again."""

    number: int
    params: tuple[float, ...]
    tries: int
    next_s: float


class LinkPolicy(Protocol):
    """Link behaviour of an autopilot."""

    def default_message_intervals_s(self, kind: LinkKind) -> dict[str, float]:
        """Interval in seconds of each message streamed by default."""
        ...

    def status_text_and_target_links(
        self, text: str, links: Mapping[int, LinkState], t_s: float
    ) -> tuple[str, list[int]]:
        """A STATUSTEXT as it is sent, and the links that it is sent on."""
        ...

    def parameter_list_names(self, params: ParameterStore) -> list[str]:
        """Names in the order of a parameter list."""
        ...

    def hash_check_param_value(self, params: ParameterStore) -> float:
        """The value of _HASH_CHECK."""
        ...

    def is_forwarding_enabled(self, kind: LinkKind, params: ParameterStore) -> bool:
        """Return True if messages received on such a link are forwarded to the others."""
        ...


class Radio:
    """All links of one autopilot, and the frames queued for them."""

    def __init__(self, state: VehicleState, router: Router, habits: LinkPolicy) -> None:
        self._state = state
        self._router = router
        self._habits = habits
        self.links: dict[int, LinkState] = {}
        self._outbox: list[tuple[int, bytes]] = []
        self._own_commands: list[_OwnCommand] = []
        self._text_id = 0
        self.signing: Signing | None = None

    def add_link(
        self, link_id: int, kind: LinkKind, *, stream: bool, signing: Signer | None
    ) -> None:
        """Start a link with the default streams of its kind."""
        system = self._state.system_id
        link = LinkState(
            link_id,
            kind,
            Encoder(system, 1, signing=signing),
            Decoder(stream=stream, keep_unknown=True, signing=signing),
        )
        self.links[link_id] = link
        self._router.add_link(link_id)
        self._start_default_streams(link)

    def enable_signing(self, secret_key: bytes, timestamp_10us: int) -> None:
        """Sign on every link with this key."""
        self.signing = signing = Signing(secret_key, timestamp_10us)
        for link_id, link in self.links.items():
            link.encoder.signing = link.decoder.signing = signing.link_signer(link_id)

    def drop_link(self, link_id: int) -> None:
        """Take a link down."""
        self.links.pop(link_id, None)
        self._router.drop_link(link_id)

    def reset_at_reboot(self) -> None:
        """Reset all requests and peers."""
        self._own_commands.clear()
        self._text_id = 0
        for link in self.links.values():
            link.gcs_until_s = None
            link.peers.clear()
            link.parameters = None
            self._start_default_streams(link)

    def take_outgoing_frames(self) -> list[tuple[int, bytes]]:
        """Frames to send, in order; the outbox is then empty."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def decode_and_forward_received(self, link_id: int, datagram: bytes) -> list[Message]:
        """Decode messages for this autopilot; forward those for others."""
        link = self.links[link_id]
        own_address = (self._state.system_id, 1)
        messages = []
        for message in link.decoder.decode_bytes(datagram):
            if (message.src_system, message.src_component) == own_address:
                continue
            routing = self._router.learn_sender_and_route(link_id, message)
            forwards = self._habits.is_forwarding_enabled(link.kind, self._state.params)
            for other in routing.forward_to if forwards else ():
                if isinstance(other, int) and other in self.links:
                    self._outbox.append((other, message.wire_bytes))
            link.peers.add((message.src_system, message.src_component))
            if routing.deliver and message.msg_name != "UNKNOWN":
                messages.append(message)
        return messages

    def send(self, link_id: int, name: str, **fields: Any) -> None:
        """Queue one message on one link."""
        link = self.links.get(link_id)
        if link is not None:
            self._outbox.append((link_id, link.encoder.encode_next_frame(Message(name, **fields))))

    def send_on_all_links(self, name: str, **fields: Any) -> None:
        """Queue one message on every link."""
        for link_id in self.links:
            self.send(link_id, name, **fields)

    def send_status_text(self, severity: Severity, text: str) -> None:
        """Queue a STATUSTEXT where the autopilot sends them, in chunks of 50 bytes."""
        text, link_ids = self._habits.status_text_and_target_links(
            text, self.links, self._state.t_s
        )
        chunks = [text[at : at + _TEXT_SIZE] for at in range(0, len(text), _TEXT_SIZE)]
        text_id = 0
        if len(chunks) > 1:
            self._text_id = text_id = self._text_id % 65535 + 1
        for link_id in link_ids:
            for number, chunk in enumerate(chunks):
                self.send(
                    link_id,
                    "STATUSTEXT",
                    severity=int(severity),
                    text=chunk,
                    id=text_id,
                    chunk_seq=number,
                )

    def send_command_ack(self, command: Command, result: MavResult) -> None:
        """Queue a COMMAND_ACK to the sender of a command."""
        self.send(
            command.link_id,
            "COMMAND_ACK",
            command=command.number,
            result=int(result),
            target_system=command.system,
            target_component=command.component,
        )

    def send_parameter(self, link_id: int, name: str, param_index: int | None = None) -> None:
        """Queue a PARAM_VALUE."""
        state = self._state
        if name == "_HASH_CHECK":
            value, kind, param_index = self._habits.hash_check_param_value(state.params), 5, 65535
        else:
            value, kind = state.params.wire_value_and_type(name)
            if param_index is None:
                param_index = state.params.index_of(name)
        self.send(
            link_id,
            "PARAM_VALUE",
            param_id=name,
            param_value=value,
            param_type=kind,
            param_count=len(state.params),
            param_index=param_index,
        )

    def start_parameter_list(self, link_id: int) -> None:
        """Begin to send all parameters on a link, a few at each step."""
        self.links[link_id].parameters = iter(self._habits.parameter_list_names(self._state.params))

    def send_command_to_companions(self, command_number: int, *params: float) -> None:
        """Send a command to the companions on the links; repeated until acknowledged."""
        padded = (*params, *(0.0,) * (7 - len(params)))
        self.stop_command_retry(command_number)
        self._own_commands.append(_OwnCommand(command_number, padded, 3, self._state.t_s))

    def stop_command_retry(self, command_number: int) -> None:
        """Stop repeating a command after its acknowledgement."""
        self._own_commands = [c for c in self._own_commands if c.number != command_number]

    def resend_due_own_commands(self) -> None:
        """Repeat unacknowledged commands, three times in total."""
        state = self._state
        for command in [c for c in self._own_commands if c.next_s <= state.t_s]:
            for link in self.links.values():
                if not any(system == state.system_id for system, _ in link.peers):
                    continue
                fields = {f"param{i + 1}": value for i, value in enumerate(command.params)}
                self.send(
                    link.id,
                    "COMMAND_LONG",
                    target_system=state.system_id,
                    target_component=0,
                    command=command.number,
                    confirmation=3 - command.tries,
                    **fields,
                )
            command.tries -= 1
            command.next_s = state.t_s + 0.2
        self._own_commands = [c for c in self._own_commands if c.tries > 0]

    def _start_default_streams(self, link: LinkState) -> None:
        link.clear_streams()
        for name, interval_s in self._habits.default_message_intervals_s(link.kind).items():
            link.set_message_interval(name, interval_s, self._state.t_s)

    def send_due_messages(self, builders: Mapping[str, Builder]) -> None:
        """Send due messages on each link."""
        message_by_name: dict[str, Message | None] = {}
        for link in self.links.values():
            for name in link.take_and_reschedule_due_messages(self._state.t_s + 1e-6):
                if name not in message_by_name:
                    fields = builders[name]()
                    message_by_name[name] = None if fields is None else Message(name, **fields)
                message = message_by_name[name]
                if message is not None:
                    self._outbox.append((link.id, link.encoder.encode_next_frame(message)))
            if link.parameters is not None:
                self._send_next_listed_parameters(link)

    def _send_next_listed_parameters(self, link: LinkState) -> None:
        assert link.parameters is not None
        for _ in range(_PARAMETERS_PER_STEP):
            name = next(link.parameters, None)
            if name is None:
                link.parameters = None
                return
            self.send_parameter(link.id, name)
