"""Parts of desk tests: a manual clock, drone states, and the desk's end of a network."""

from dataclasses import dataclass, field
from typing import Any

from companion.fleet.messages import Command, Launch, State


@dataclass
class HandClock:
    """A desk's clock that the test sets. `epoch_s`: Unix time when `t_s` is 0."""

    t_s: float = 0.0
    epoch_s: float = 0.0

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return round((self.epoch_s + self.t_s) * 1e6)


def a_state(vehicle: str = "d1", **more: Any) -> State:
    """Return the state of a drone on standby."""
    fields: dict[str, Any] = {
        "instance_id": "a", "uptime_s": 0.0, "epoch_us": 0, "airframe": "m100",
        "max_payload_kg": 1.0, "phase": "standby", "log": "l", "last_seq": 0,
    }  # fmt: skip
    return State(vehicle=vehicle, **(fields | more))


@dataclass
class Wire:
    """The desk's end of a network: tests put received messages here, sent ones are kept."""

    heard: list[Any] = field(default_factory=list)
    sent: list[Command] = field(default_factory=list)

    def receive(self, wait_s: float) -> list[Any]:
        found, self.heard = self.heard, []
        return found

    def request_states(self, wait_s: float) -> None: ...
    def request_events(self, vehicle: str, after: int, wait_s: float) -> None: ...
    def publish(self, message: object) -> None: ...
    def close(self) -> None: ...

    def neighbour_keys(self, fleet: str) -> dict[str, str]:
        return {}

    def send(self, command: Command, wait_s: float) -> None:
        self.sent.append(command)

    def launches(self) -> list[str]:
        return [command.id for command in self.sent if isinstance(command.action, Launch)]
