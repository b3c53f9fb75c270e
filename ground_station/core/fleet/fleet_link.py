"""What the desk needs of a network and of a clock: zenoh, or a bus within one process."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.messages import Command, FleetEvent, Result, State
from ground_station.core.fleet.station_message import StationWind


@dataclass(frozen=True, slots=True)
class LivelinessChanged:
    """A life of a member (one run of its process) has joined (`up`) or left the network."""

    vehicle: str
    life: str
    up: bool


@dataclass(frozen=True, slots=True)
class StateReceived:
    """A member has published its state."""

    state: State


@dataclass(frozen=True, slots=True)
class StationWindReceived:
    """A wind station has told what it measures."""

    wind: StationWind


@dataclass(frozen=True, slots=True)
class EventsReceived:
    """Events as they happened, or (`replayed`) all that were asked for, in order."""

    vehicle: str
    events: list[FleetEvent]
    replayed: bool = False


@dataclass(frozen=True, slots=True)
class CommandAnswered:
    """The answer to a command; `result` None: nobody answered in time."""

    command_id: str
    result: Result | None


@dataclass(frozen=True, slots=True)
class MessageRejected:
    """Bytes that are no valid message, and why; `count` of them since the last time."""

    key: str
    reason: str
    count: int = 1


FleetInput = (
    LivelinessChanged
    | StateReceived
    | StationWindReceived
    | EventsReceived
    | CommandAnswered
    | MessageRejected
)


class FleetLink(Protocol):
    """The desk's end of one fleet's network. Nothing that asks blocks: answers are received."""

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Everything that has come; waits this long for the first."""
        ...

    def ask_states(self, wait_s: float) -> None:
        """Ask every member for its newest state, and the network for who is there."""
        ...

    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Ask a member for the events that it keeps after this number."""
        ...

    def send(self, command: Command, wait_s: float) -> None:
        """Send a command. Its answer, or the time-out, is received."""
        ...

    def tell_winds(self, winds: SharedWinds) -> None:
        """Tell one vehicle the winds that others feel; what is lost is told anew soon."""
        ...

    def neighbour_keys(self, fleet: str) -> Mapping[str, str]:
        """The public keys of a neighbouring fleet's vehicles, by name; none without identities."""
        ...

    def close(self) -> None:
        """Leave the network."""
        ...


class Clock(Protocol):
    """The desk's two clocks; a simulated day brings its own."""

    def monotonic_s(self) -> float:
        """Seconds of a clock that never goes back, for silences and time-outs."""
        ...

    def epoch_us(self) -> int:
        """Microseconds since 1970: for people, and for the day's time through restarts."""
        ...


@dataclass(frozen=True, slots=True)
class OffsetClock:
    """A clock whose time stamps are later by an offset.

    After a restart the wall clock may be behind the store's last entry; the day's time must go on.
    """

    clock: Clock
    offset_us: int

    def monotonic_s(self) -> float:
        """The clock's own."""
        return self.clock.monotonic_s()

    def epoch_us(self) -> int:
        """The clock's, and the offset."""
        return self.clock.epoch_us() + self.offset_us
