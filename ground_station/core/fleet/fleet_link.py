"""Interfaces of the desk to a network (zenoh, or a bus within one process) and to a clock."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from companion.core.base.desk_heartbeat import DeskHeartbeat
from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.messages import Command, FleetEvent, Result, State
from ground_station.core.fleet.station_message import StationWind


@dataclass(frozen=True, slots=True)
class LivelinessChanged:
    """A process instance of a member has joined (`has_joined`) or left the network."""

    vehicle: str
    instance_id: str
    has_joined: bool


@dataclass(frozen=True, slots=True)
class StateReceived:
    """A member has published its state."""

    state: State


@dataclass(frozen=True, slots=True)
class StationWindReceived:
    """A wind station has published a measurement."""

    wind: StationWind


@dataclass(frozen=True, slots=True)
class DeskHeartbeatReceived:
    """A desk of the fleet runs."""

    heartbeat: DeskHeartbeat


@dataclass(frozen=True, slots=True)
class EventsReceived:
    """Events as they happened, or (`replayed`) all requested ones, in order."""

    vehicle: str
    events: list[FleetEvent]
    replayed: bool = False


@dataclass(frozen=True, slots=True)
class CommandResponse:
    """The response to a command; `result` None: no response in time."""

    command_id: str
    result: Result | None


@dataclass(frozen=True, slots=True)
class MessageRejected:
    """An invalid message and the reason; `count`: rejections since the last report."""

    key: str
    reason: str
    count: int = 1


FleetInput = (
    LivelinessChanged
    | StateReceived
    | StationWindReceived
    | DeskHeartbeatReceived
    | EventsReceived
    | CommandResponse
    | MessageRejected
)


class FleetLink(Protocol):
    """The desk's end of a fleet's network. Requests do not block: `receive` returns responses."""

    def receive(self, wait_s: float) -> list[FleetInput]:
        """Return all received inputs; wait up to `wait_s` for the first."""
        ...

    def request_states(self, wait_s: float) -> None:
        """Request the latest state of every member, and the network's list of members."""
        ...

    def request_events(self, vehicle: str, after: int, wait_s: float) -> None:
        """Request a member's stored events after this number."""
        ...

    def send(self, command: Command, wait_s: float) -> None:
        """Send a command. Its response or time-out arrives by `receive`."""
        ...

    def publish(self, message: SharedWinds | DeskHeartbeat) -> None:
        """Publish the winds for one vehicle, or this desk's heartbeat; the next one replaces a lost
        one.
        """
        ...

    def neighbour_keys(self, fleet: str) -> Mapping[str, str]:
        """Return the public keys of a neighbouring fleet's vehicles, by name (may be empty)."""
        ...

    def close(self) -> None:
        """Leave the network."""
        ...


class Clock(Protocol):
    """The desk's two clocks; a simulated day provides its own."""

    def monotonic_s(self) -> float:
        """Return the seconds of a monotonic clock, for silence and time-outs."""
        ...

    def epoch_us(self) -> int:
        """Return microseconds since 1970, for display and for the day's time through restarts."""
        ...


@dataclass(frozen=True, slots=True)
class OffsetClock:
    """A clock with an offset on its time stamps.

    After a restart the wall clock may be behind the store's last entry; the day's time may not go
    back.
    """

    clock: Clock
    offset_us: int

    def monotonic_s(self) -> float:
        """Return the clock's monotonic time."""
        return self.clock.monotonic_s()

    def epoch_us(self) -> int:
        """Return the clock's time stamp plus the offset."""
        return self.clock.epoch_us() + self.offset_us
