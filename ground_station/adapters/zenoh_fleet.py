"""The desk's end of a fleet over zenoh: everything that arrives is decoded into one queue.

zenoh's threads only put into the queue; the desk's one thread takes from it. Nothing that asks
blocks: answers come through the same queue.
"""

import queue
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh

from companion.core.base.errors import LeewayError
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
from companion.fleet.topics import VehicleKeys, life_of, vehicle_of
from ground_station.core.fleet.fleet_link import (
    CommandAnswered,
    EventsReceived,
    FleetInput,
    LivelinessChanged,
    MessageRejected,
    StateReceived,
)

QUEUE_SIZE = 100_000


class ZenohFleet:
    """The desk's end of one fleet."""

    def __init__(self, fleet: str, config: Path | None) -> None:
        """Join with this configuration file (JSON5), or as a peer found by multicast.

        Raises LeewayError where the file is not valid, or the network refuses us.
        """
        self._keys = VehicleKeys(fleet, "*")
        self._fleet = fleet
        self._queue: queue.Queue[FleetInput] = queue.Queue(QUEUE_SIZE)
        where = str(config) if config is not None else "zenoh"
        try:
            settings = zenoh.Config() if config is None else zenoh.Config.from_file(str(config))
            self._session = zenoh.open(settings)
        except zenoh.ZError as error:
            raise LeewayError(f"{where}: {error}") from error
        liveliness = self._session.liveliness()
        self._held = (  # zenoh undeclares what nobody holds
            self._session.declare_subscriber(self._keys.state, self._on_state),
            self._session.declare_subscriber(self._keys.event, self._on_event),
            liveliness.declare_subscriber(self._keys.alive(), self._on_liveliness, history=True),
        )

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Everything that has come; waits this long for the first."""
        found: list[FleetInput] = []
        try:
            found.append(self._queue.get(timeout=wait_s))
            while True:
                found.append(self._queue.get_nowait())
        except queue.Empty:
            return found

    def ask_states(self, wait_s: float) -> None:
        """Ask every member for its newest state."""
        self._session.get(self._keys.state, self._on_state_reply, timeout=wait_s)

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Ask a member for the events that it keeps after this number."""
        events: list[FleetEvent] = []

        def take(reply: zenoh.Reply) -> None:
            event = self._decoded(reply, vehicle, decode_event)
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
            result = self._decoded(reply, command.vehicle, decode_result)
            if isinstance(result, Result) and result.id == command.id:
                results.append(result)

        def done() -> None:
            self._queue.put(CommandAnswered(command.id, results[0] if results else None))

        key = VehicleKeys(self._fleet, command.vehicle).command
        self._session.get(
            key,
            zenoh.handlers.Callback(take, done),
            payload=encode(command),
            timeout=wait_s,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            express=True,
        )

    def close(self) -> None:
        """Leave the network."""
        self._session.close()

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        seen = life_of(str(sample.key_expr))
        if seen is not None:
            self._queue.put(LivelinessChanged(*seen, up=sample.kind == zenoh.SampleKind.PUT))

    def _on_state(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        state = self._decoded_from(key, sample.payload.to_bytes(), vehicle_of(key), decode_state)
        if isinstance(state, State):
            self._queue.put(StateReceived(state))

    def _on_event(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        event = self._decoded_from(key, sample.payload.to_bytes(), vehicle_of(key), decode_event)
        if isinstance(event, FleetEvent):
            self._queue.put(EventsReceived(event.vehicle, [event]))

    def _on_state_reply(self, reply: zenoh.Reply) -> None:
        sample = reply.ok
        vehicle = vehicle_of(str(sample.key_expr)) if sample is not None else None
        state = self._decoded(reply, vehicle, decode_state)
        if isinstance(state, State):
            self._queue.put(StateReceived(state))

    def _decoded(
        self, reply: zenoh.Reply, vehicle: str | None, decode: Callable[[bytes], Any]
    ) -> Any:
        sample = reply.ok
        if sample is None:
            return None
        return self._decoded_from(str(sample.key_expr), sample.payload.to_bytes(), vehicle, decode)

    def _decoded_from(
        self, key: str, raw: bytes, vehicle: str | None, decode: Callable[[bytes], Any]
    ) -> Any:
        """A message of the vehicle whose key it came by; anything else is rejected."""
        message = decode(raw)
        if isinstance(message, Refused):
            self._queue.put(MessageRejected(key, message.reason))
            return None
        if message.vehicle != vehicle:
            self._queue.put(MessageRejected(key, f"speaks for {message.vehicle}"))
            return None
        return message
