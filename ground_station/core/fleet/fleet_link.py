"""What the desk needs of a network: zenoh, or a bus within one process."""

from dataclasses import dataclass
from typing import Protocol

from companion.fleet.messages import Command, FleetEvent, Result, State


@dataclass(frozen=True, slots=True)
class Alive:
    """A life of a vehicle's companion came (`up`) or went."""

    vehicle: str
    life: str
    up: bool


@dataclass(frozen=True, slots=True)
class StateHeard:
    """A vehicle told its state."""

    state: State


@dataclass(frozen=True, slots=True)
class EventsHeard:
    """Events as they happened, or (`replayed`) all that were asked for, in order."""

    vehicle: str
    events: list[FleetEvent]
    replayed: bool = False


@dataclass(frozen=True, slots=True)
class CommandAnswered:
    """The answer to a command; `None`: nobody answered."""

    command_id: str
    result: Result | None


@dataclass(frozen=True, slots=True)
class Nonsense:
    """Bytes that are no message of ours, and why."""

    key: str
    reason: str


Heard = Alive | StateHeard | EventsHeard | CommandAnswered | Nonsense


class Fleet(Protocol):
    """The desk's end of one fleet. Asking never blocks: answers come as `Heard`."""

    def heard(self, wait_s: float) -> list[Heard]:
        """What has arrived; waits so long for the first."""
        ...

    def ask_states(self, wait_s: float) -> None:
        """Ask every vehicle for its newest state."""
        ...

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Ask a vehicle for the events that it keeps after this number."""
        ...

    def send(self, command: Command, wait_s: float) -> None:
        """Send a command; its answer, or that there was none in this time, is heard."""
        ...

    def close(self) -> None:
        """Leave the network."""
        ...


class Clock(Protocol):
    """The desk's two clocks; a simulated day brings its own."""

    def monotonic_s(self) -> float:
        """For silences and waits: it never goes back."""
        ...

    def epoch_us(self) -> int:
        """Microseconds since 1970: for people, and for the day's time through restarts."""
        ...


@dataclass(frozen=True, slots=True)
class LaterClock:
    """A clock whose stamps are so much later: the day's time goes on where a desk comes back with
    a clock that was set back.
    """

    clock: Clock
    later_us: int

    def monotonic_s(self) -> float:
        """For silences and waits."""
        return self.clock.monotonic_s()

    def epoch_us(self) -> int:
        """Later than the clock's."""
        return self.clock.epoch_us() + self.later_us
