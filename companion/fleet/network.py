"""Interface of a fleet member to the network: zenoh, or a bus within one process."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from companion.core.mission.flight_file import NeighbourFleet

OPEN_MARK = "[OPEN NETWORK]"
"""Prefix of log lines, and of a truck's position, on a network open to strangers."""

OPEN_WARNING = "OPEN NETWORK: strangers may listen and command"


WIND_COV = "wind_cov"
"""Parameter in a state request of a client that reads `State.wind_cov_m2ps2`."""

STATE_REQUEST_MAX_INTERVAL_S = 150.0
"""Clients request states at their start, a desk at least once a minute, and within two seconds of a
state that they rejected.
"""


class RequestKind(Enum):
    """Kind of a request from the network."""

    COMMAND = "command"
    EVENTS = "events"
    DUPLICATE = "twin"
    ROSTER = "roster"
    DESK = "desk"
    TEXT = "notice"


@dataclass(frozen=True, slots=True)
class MemberRequest:
    """A command's bytes, a request for events after a number, notice of another instance with this
    name, a roster's bytes, or a text for people.

    `reply` sends replies, once. `signer` is the signer of a command; empty in a fleet without a
    roster.
    """

    kind: RequestKind
    reply: Callable[[list[bytes]], None]
    payload: bytes = b""
    after_seq: int = 0
    signer: str = ""


@dataclass(frozen=True, slots=True)
class ReceivedTrack:
    """A received track: its bytes, the vehicle and the cell in its key. `fleet`: the neighbouring
    fleet in that key; empty for the own fleet.
    """

    sender: str
    cell: str
    raw: bytes
    fleet: str = ""

    @property
    def sender_display_name(self) -> str:
        """The name in rejection messages."""
        return f"{self.fleet}/{self.sender}" if self.fleet else self.sender


class Authority(Protocol):
    """Authority by the roster in force, `companion.fleet.trust.MemberTrust`."""

    @property
    def roster_stamp(self) -> str:
        """Number and hash of the roster."""
        ...

    def authority_error_or_empty(self, action: Any, author: str, signer: str) -> str:
        """Return why the roster does not permit an action; empty: it does."""
        ...


class MemberLink(Protocol):
    """Link of one member instance. A liveliness token exists until `close`; no method blocks.

    `trust`: the roster in force; None: a fleet without one.
    """

    @property
    def trust(self) -> Authority | None: ...

    def drain_requests(self) -> list[MemberRequest]:
        """Return and remove all pending requests."""
        ...

    def set_request_callback(self, on_request: Callable[[], None]) -> None:
        """Set the function that is called when a request arrives."""
        ...

    def publish_state(self, state_bytes: bytes) -> None:
        """Publish the newest state, which later state requests also receive."""
        ...

    def publish_event(self, event_bytes: bytes) -> None:
        """Publish an event to its subscribers."""
        ...

    def publish_track(self, track_bytes: bytes, cell: str) -> None:
        """Publish the position to subscribers of this cell; a track that cannot be sent immediately
        is dropped.
        """
        ...

    def subscribe_near(self, lat_deg: float, lon_deg: float) -> None:
        """Subscribe to the cells around this position; before the first call, to none."""
        ...

    def subscribe_fleets(self, neighbours: Sequence["NeighbourFleet"]) -> None:
        """Subscribe to these fleets' tracks in the same cells, and to no other fleet's."""
        ...

    def drain_tracks(self) -> list[ReceivedTrack]:
        """Return neighbours' tracks since the last call; oldest first for each vehicle."""
        ...

    def drain_wind_messages(self) -> list[bytes]:
        """Return the winds published by a desk since the last call, oldest first."""
        ...

    def do_all_clients_read_wind_cov(self) -> bool:
        """Return True if states are requested, and all clients read the wind covariance."""
        ...

    def close(self) -> None:
        """Send what is queued, then leave the network."""
        ...
