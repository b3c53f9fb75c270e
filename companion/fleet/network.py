"""The network as a fleet member needs it: zenoh, or a bus within one process."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from companion.core.mission.flight_file import NeighbourFleet

OPEN_MARK = "[OPEN NETWORK]"
"""Stands before log lines, and before where a truck is, on a network that lets strangers in."""

OPEN_WORDS = "OPEN NETWORK: strangers may listen and command"


WIND_COV = "wind_cov"
"""Stands in the request for states of whoever reads `State.wind_cov_m2ps2`."""

ASKED_AGAIN_S = 150.0
"""A listener asks for states at its beginning, at least once a minute where it is a desk, and
within two seconds of a state that it refused.
"""


class Ask(Enum):
    """What somebody on the network wants of the vehicle."""

    COMMAND = "command"
    EVENTS = "events"
    TWIN = "twin"
    ROSTER = "roster"
    NOTICE = "notice"


@dataclass(frozen=True, slots=True)
class Asked:
    """A command's bytes, the events after a number, notice that another life bears our name, a
    roster's bytes, or words for people.

    `answer` sends replies, and no more after the first call. `signer` is who signed a command;
    empty in a fleet without a roster.
    """

    ask: Ask
    answer: Callable[[list[bytes]], None]
    payload: bytes = b""
    after: int = 0
    signer: str = ""


@dataclass(frozen=True, slots=True)
class Told:
    """A track's bytes, the vehicle whose key it came by, and the cell in that key. `fleet`: the
    neighbouring fleet in that key; empty: our own.
    """

    speaker: str
    cell: str
    raw: bytes
    fleet: str = ""

    @property
    def name(self) -> str:
        """As refusals call it."""
        return f"{self.fleet}/{self.speaker}" if self.fleet else self.speaker


class MemberLink(Protocol):
    """One life of one member. Its liveliness token is there until `close`; nothing here blocks."""

    def asked(self) -> list[Asked]:
        """Everything that waits."""
        ...

    def be_woken(self, wake: Callable[[], None]) -> None:
        """Who waits now, and is to be woken when something is asked."""
        ...

    def publish_state(self, raw: bytes) -> None:
        """Tell the newest state; who asks later gets it too."""
        ...

    def publish_event(self, raw: bytes) -> None:
        """Tell an event, if anybody listens."""
        ...

    def publish_track(self, raw: bytes, cell: str) -> None:
        """Tell those who listen to this cell where we are; what cannot leave at once is worth
        nothing later.
        """
        ...

    def hear_near(self, lat_deg: float, lon_deg: float) -> None:
        """Listen to the cells about this place from now on; before the first, to none."""
        ...

    def hear_fleets(self, neighbours: Sequence["NeighbourFleet"]) -> None:
        """Listen to the tracks of these fleets, too, in the same cells; to no others' any more."""
        ...

    def tracks(self) -> list[Told]:
        """What neighbours told since the last call, our own excepted; each one's oldest first."""
        ...

    def winds(self) -> list[bytes]:
        """What a desk told of the winds of others since the last call, oldest first."""
        ...

    def wind_cov_is_read(self) -> bool:
        """Whether somebody asks for states, and all who do read the covariance of the wind."""
        ...

    def close(self) -> None:
        """Say what is left to say, and leave."""
        ...
