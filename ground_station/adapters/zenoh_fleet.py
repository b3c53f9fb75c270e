"""The desk's end of a fleet over zenoh: everything that arrives is decoded into one queue.

zenoh's threads only put into the queue; the desk's one thread takes from it. Nothing that asks
blocks: answers come through the same queue.
"""

import queue
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.membership import ON_ITS_OWN, JoinOptions
from companion.fleet.messages import (
    Command,
    FleetEvent,
    Refused,
    Result,
    State,
    decode_event,
    decode_result,
    decode_state,
    encode,
)
from companion.fleet.refusals import Refusals
from companion.fleet.topics import VehicleKeys, life_of, vehicle_of
from companion.fleet.zenoh_config import read_config
from ground_station.adapters.clock import monotonic_s
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    EventsReceived,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)

if TYPE_CHECKING:
    from companion.fleet.identity import Identity
    from ground_station.adapters.roster_share import RosterShare

QUEUE_SIZE = 100_000
DECODERS: dict[str, Callable[[bytes], Any]] = {
    "state": decode_state,
    "event": decode_event,
    "result": decode_result,
}


class ZenohFleet:
    """The desk's end of one fleet."""

    def __init__(self, fleet: str, config: Path | None, options: JoinOptions = ON_ITS_OWN) -> None:
        """Join with this configuration file (JSON5), or as `options` say.

        Raises LeewayError where a file is not valid, or the network refuses us.
        """
        self.open_network = options.open_network
        self._keys = VehicleKeys(fleet, "*")
        self._fleet = fleet
        self._queue: queue.Queue[FleetInput] = queue.Queue(QUEUE_SIZE)
        self._refusals = Refusals()
        identity = _identity(fleet, options)
        self._trust = identity.trust if identity is not None else None
        file = config or (identity.zenoh if identity is not None else None)
        try:
            self._session = zenoh.open(read_config(file, open_network=options.open_network))
        except zenoh.ZError as error:
            raise LeewayError(f"{file or 'zenoh'}: {error}") from error
        self._roster = _share_of(self._session, identity, self._refusals.note)
        liveliness = self._session.liveliness()
        self._held = (  # zenoh undeclares what nobody holds
            self._session.declare_subscriber(self._keys.state, self._on_state),
            self._session.declare_subscriber(self._keys.event, self._on_event),
            liveliness.declare_subscriber(self._keys.alive(), self._on_liveliness, history=True),
        )

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Everything that has come; waits this long for the first."""
        found: list[FleetInput] = self._turn()
        try:
            found.append(self._queue.get(timeout=wait_s))
            while True:
                found.append(self._queue.get_nowait())
        except queue.Empty:
            return found

    def _turn(self) -> list[FleetInput]:
        """What this end itself has to tell: what was not believed, and a warning for its owner."""
        now_s = monotonic_s()
        if self._roster is not None:
            self._roster.turn(now_s)
        said = self._refusals.due(now_s)
        return [] if said is None else [MessageRejected("fleet", said)]

    @property
    def warning(self) -> str:
        """What a person should know about this end's own standing; empty: nothing."""
        return self._trust.warning() if self._trust is not None else ""

    def ask_states(self, wait_s: float) -> None:
        """Ask every member for its newest state."""
        self._session.get(self._keys.state, self._on_state_reply, timeout=wait_s)

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Ask a member for the events that it keeps after this number."""
        events: list[FleetEvent] = []

        def take(reply: zenoh.Reply) -> None:
            event = self._decoded(reply, vehicle, "event")
            if isinstance(event, FleetEvent):
                events.append(event)

        def done() -> None:
            events.sort(key=lambda event: event.seq)
            if events:
                self._queue.put(EventsReceived(vehicle, events, replayed=True))

        selector = f"{VehicleKeys(self._fleet, vehicle).event}?after={after}"
        self._session.get(
            selector,
            zenoh.handlers.Callback(take, done),
            timeout=wait_s,
            consolidation=zenoh.ConsolidationMode.NONE,  # every event has the same key
        )

    def send(self, command: Command, wait_s: float) -> None:
        """Send a command. Its answer, or the time-out, is received."""
        results: list[Result] = []

        def take(reply: zenoh.Reply) -> None:
            result = self._decoded(reply, command.vehicle, "result")
            if isinstance(result, Result) and result.id == command.id:
                results.append(result)
            elif isinstance(result, Result):
                self._refusals.note(f"{command.vehicle} did not take a command: {result.reason}")

        def done() -> None:
            self._queue.put(CommandAnswered(command.id, results[0] if results else None))

        key = VehicleKeys(self._fleet, command.vehicle).command
        self._session.get(
            key,
            zenoh.handlers.Callback(take, done),
            payload=self._sealed(command),
            timeout=wait_s,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            express=True,
        )

    def _sealed(self, command: Command) -> bytes:
        raw = encode(command)
        return raw if self._trust is None else self._trust.seal("command", raw)

    def close(self) -> None:
        """Leave the network."""
        self._session.close()

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        seen = life_of(str(sample.key_expr))
        if seen is not None:
            if self._roster is not None and sample.kind == zenoh.SampleKind.PUT:
                self._roster.somebody_joined()
            self._queue.put(LivelinessChanged(*seen, up=sample.kind == zenoh.SampleKind.PUT))

    def _on_state(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        state = self._decoded_from(key, sample.payload.to_bytes(), "state")
        if isinstance(state, State):
            self._queue.put(StateReceived(state))

    def _on_event(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        event = self._decoded_from(key, sample.payload.to_bytes(), "event")
        if isinstance(event, FleetEvent):
            self._queue.put(EventsReceived(event.vehicle, [event]))

    def _on_state_reply(self, reply: zenoh.Reply) -> None:
        state = self._decoded(reply, None, "state")
        if isinstance(state, State):
            self._queue.put(StateReceived(state))

    def _decoded(self, reply: zenoh.Reply, vehicle: str | None, kind: str) -> Any:
        """A message of the vehicle that was asked; of anybody who answered, where all were."""
        sample = reply.ok
        if sample is None:
            return None
        key = str(sample.key_expr)
        if vehicle is not None and vehicle_of(key) != vehicle:
            self._refusals.note(f"{vehicle}: {kind}: answered by {vehicle_of(key)}")
            return None
        return self._decoded_from(key, sample.payload.to_bytes(), kind)

    def _decoded_from(self, key: str, raw: bytes, kind: str) -> Any:
        """A message of the vehicle whose key it came by; anything else is refused."""
        vehicle = vehicle_of(key)
        told = raw if self._trust is None else self._trust.told(kind, raw, vehicle)
        if isinstance(told, Refused):
            self._refusals.note(f"{vehicle}: {told.reason}")
            return None
        message = DECODERS[kind](told)
        if isinstance(message, Refused):
            self._queue.put(MessageRejected(key, message.reason))
            return None
        if message.vehicle != vehicle:
            self._refusals.note(f"{vehicle}: {kind}: speaks for {message.vehicle}")
            return None
        return message


def _identity(fleet: str, options: JoinOptions) -> "Identity | None":
    """The identity of a program that has one: cryptography is loaded only for those."""
    if options.identity is None:
        return None
    from companion.fleet.identity import identity_of

    return identity_of(options.identity, fleet)


def _share_of(
    session: zenoh.Session, identity: "Identity | None", refuse: Callable[[str], None]
) -> "RosterShare | None":
    if identity is None:
        return None
    from ground_station.adapters.roster_share import RosterShare

    return RosterShare(session, identity, refuse)
