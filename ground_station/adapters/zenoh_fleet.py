"""The desk's end of a fleet over zenoh: what arrives goes into the inbox, as bytes.

Nothing that asks blocks: answers come by way of the inbox too.
"""

from pathlib import Path
from typing import Any

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.event_log import BATCH
from companion.fleet.messages import Command, Refused, Result, decode_result, encode
from companion.fleet.topics import VehicleKeys, life_of, vehicle_of
from ground_station.adapters.fleet_inbox import FleetInbox
from ground_station.core.fleet.fleet_link import FleetInput


class ZenohFleet:
    """The desk's end of one fleet."""

    def __init__(self, fleet: str, config: Path | None) -> None:
        """Join with this configuration file (JSON5), or as a peer found by multicast.

        Raises LeewayError where the file is not valid, or the network refuses us.
        """
        self._keys = VehicleKeys(fleet, "*")
        self._fleet = fleet
        self.inbox = FleetInbox()
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
        return self.inbox.receive(wait_s)

    def ask_states(self, wait_s: float) -> None:
        """Ask every member for its newest state."""
        self._session.get(self._keys.state, self._on_state_reply, timeout=wait_s)

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Ask a member for the events that it keeps after this number."""
        raws: list[bytes] = []

        def take(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None or vehicle_of(str(sample.key_expr)) != vehicle:
                return
            if len(raws) < BATCH:
                raws.append(sample.payload.to_bytes())

        def done() -> None:
            if raws:
                self.inbox.hear_replay(vehicle, raws)

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
            result = self._result(reply, command.vehicle)
            if result is not None and result.id == command.id and not results:
                results.append(result)

        def done() -> None:
            self.inbox.hear_answer(command.id, results[0] if results else None)

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
            self.inbox.hear_life(*seen, up=sample.kind == zenoh.SampleKind.PUT)

    def _on_state(self, sample: zenoh.Sample) -> None:
        self.inbox.hear_state(str(sample.key_expr), sample.payload.to_bytes())

    def _on_event(self, sample: zenoh.Sample) -> None:
        self.inbox.hear_event(str(sample.key_expr), sample.payload.to_bytes())

    def _on_state_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._on_state(reply.ok)

    def _result(self, reply: zenoh.Reply, vehicle: str) -> Result | None:
        """The answer of the vehicle that was asked; anything else is rejected."""
        sample = reply.ok
        if sample is None:
            return None
        result: Any = decode_result(sample.payload.to_bytes())
        if isinstance(result, Refused):
            self.inbox.reject(vehicle, result.reason)
            return None
        if not result.vehicle == vehicle == vehicle_of(str(sample.key_expr)):
            self.inbox.reject(vehicle, f"an answer speaks for {result.vehicle}")
            return None
        return result
