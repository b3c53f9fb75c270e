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
"""Builds one message from the present state; None when there is nothing to send."""

_TEXT_SIZE = 50
_PARAMETERS_PER_STEP = 4


@dataclass(slots=True)
class _OwnCommand:
    """A command that the autopilot itself sent to companions, and may send again."""

    number: int
    params: tuple[float, ...]
    tries: int
    next_s: float


class LinkHabits(Protocol):
    """How an autopilot uses its links."""

    def default_streams(self, kind: LinkKind) -> dict[str, float]:
        """Seconds between two messages of each name that is streamed unasked."""
        ...

    def status_text(
        self, text: str, links: Mapping[int, LinkState], t_s: float
    ) -> tuple[str, list[int]]:
        """A STATUSTEXT as it is sent, and the links that it is sent on."""
        ...

    def parameter_names(self, params: ParameterStore) -> list[str]:
        """Names in the order of a parameter list."""
        ...

    def hash_check(self, params: ParameterStore) -> float:
        """The value of _HASH_CHECK."""
        ...

    def forwards(self, kind: LinkKind, params: ParameterStore) -> bool:
        """Whether messages that arrive on such a link are passed on to the others."""
        ...


class Radio:
    """All links of one autopilot, and the frames that wait to be sent on them."""

    def __init__(self, state: VehicleState, router: Router, habits: LinkHabits) -> None:
        self._state = state
        self._router = router
        self._habits = habits
        self.links: dict[int, LinkState] = {}
        self._outbox: list[tuple[int, bytes]] = []
        self._own_commands: list[_OwnCommand] = []
        self._text_id = 0

    def add_link(
        self, link_id: int, kind: LinkKind, *, stream: bool, signing: Signer | None
    ) -> None:
        """Bring a link up with its kind's streams."""
        system = self._state.system_id
        link = LinkState(
            link_id,
            kind,
            Encoder(system, 1, signing=signing),
            Decoder(stream=stream, keep_unknown=True, signing=signing),
        )
        self.links[link_id] = link
        self._router.add_link(link_id)
        self._start_streams(link)

    def sign(self, secret_key: bytes, timestamp_10us: int) -> None:
        """Sign on every link with this key."""
        signing = Signing(secret_key, timestamp_10us)
        for link_id, link in self.links.items():
            link.encoder.signing = link.decoder.signing = signing.on_link(link_id)

    def drop_link(self, link_id: int) -> None:
        """Take a link down."""
        self.links.pop(link_id, None)
        self._router.drop_link(link_id)

    def reboot(self) -> None:
        """Forget every request and every peer."""
        self._own_commands.clear()
        self._text_id = 0
        for link in self.links.values():
            link.gcs_until_s = None
            link.peers.clear()
            link.parameters = None
            self._start_streams(link)

    def take_outbox(self) -> list[tuple[int, bytes]]:
        """Frames to send, in order; the outbox is then empty."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def take_in(self, link_id: int, datagram: bytes) -> list[Message]:
        """Messages for this autopilot; those for others are passed on."""
        link = self.links[link_id]
        mine = (self._state.system_id, 1)
        messages = []
        for message in link.decoder.feed(datagram):
            if (message.src_system, message.src_component) == mine:
                continue
            routing = self._router.route(link_id, message)
            forwards = self._habits.forwards(link.kind, self._state.params)
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
            self._outbox.append((link_id, link.encoder.encode(Message(name, **fields))))

    def send_all(self, name: str, **fields: Any) -> None:
        """Queue one message on every link."""
        for link_id in self.links:
            self.send(link_id, name, **fields)

    def say(self, severity: Severity, text: str) -> None:
        """Queue a STATUSTEXT where the autopilot sends them, in chunks of 50 bytes."""
        text, link_ids = self._habits.status_text(text, self.links, self._state.t_s)
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

    def acknowledge(self, command: Command, result: MavResult, progress: int = 0) -> None:
        """Queue a COMMAND_ACK to the sender of a command."""
        self.send(
            command.link_id,
            "COMMAND_ACK",
            command=command.number,
            result=int(result),
            progress=progress,
            target_system=command.system,
            target_component=command.component,
        )

    def send_parameter(self, link_id: int, name: str, index: int | None = None) -> None:
        """Queue a PARAM_VALUE."""
        state = self._state
        if name == "_HASH_CHECK":
            value, kind, index = self._habits.hash_check(state.params), 5, 65535
        else:
            value, kind = state.params.wire(name)
            if index is None:
                index = state.params.index_of(name)
        self.send(
            link_id,
            "PARAM_VALUE",
            param_id=name,
            param_value=value,
            param_type=kind,
            param_count=len(state.params),
            param_index=index,
        )

    def start_parameter_list(self, link_id: int) -> None:
        """Begin to send all parameters on a link, a few at each step."""
        self.links[link_id].parameters = iter(self._habits.parameter_names(self._state.params))

    def ask_companions(self, number: int, *params: float) -> None:
        """Send a command to the companions on the links; repeated until answered."""
        padded = (*params, *(0.0,) * (7 - len(params)))
        self.forget_own_command(number)
        self._own_commands.append(_OwnCommand(number, padded, 3, self._state.t_s))

    def forget_own_command(self, number: int) -> None:
        """Stop repeating a command: somebody answered."""
        self._own_commands = [c for c in self._own_commands if c.number != number]

    def repeat_own_commands(self) -> None:
        """Send unanswered commands again, three times in all."""
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

    def _start_streams(self, link: LinkState) -> None:
        link.clear_streams()
        for name, interval_s in self._habits.default_streams(link.kind).items():
            link.set_interval(name, interval_s, self._state.t_s)

    def stream(self, builders: Mapping[str, Builder]) -> None:
        """Send what is due on each link."""
        built: dict[str, Message | None] = {}
        for link in self.links.values():
            for name in link.due(self._state.t_s + 1e-6):
                if name not in built:
                    fields = builders[name]()
                    built[name] = None if fields is None else Message(name, **fields)
                message = built[name]
                if message is not None:
                    self._outbox.append((link.id, link.encoder.encode(message)))
            if link.parameters is not None:
                self._send_parameters(link)

    def _send_parameters(self, link: LinkState) -> None:
        assert link.parameters is not None
        for _ in range(_PARAMETERS_PER_STEP):
            name = next(link.parameters, None)
            if name is None:
                link.parameters = None
                return
            self.send_parameter(link.id, name)
