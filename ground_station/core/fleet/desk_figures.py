"""The figures of a running desk at one moment, for those who watch it from outside.

Frozen: the desk's thread makes one after the other, and any thread may read the newest. Moments
are kept rather than ages, so that an age that is read later is right also where the desk hangs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from companion.fleet.roster import Roster
from ground_station.core.fleet.door import DoorFigures
from ground_station.core.fleet.name_counts import MOST_NAMES
from ground_station.core.fleet.time_counts import TimesBy

DAY_US = 86_400_000_000


class Standing(Enum):
    """How the desk finds a member. `SILENT`: on the network, but its states do not come, or two
    companions share its name. `GONE`: not on the network.
    """

    PRESENT = "present"
    SILENT = "silent"
    GONE = "gone"


@dataclass(frozen=True, slots=True)
class MemberFigures:
    """One member. `heard_s`: when its last state came to this desk; None: none has. `flies`: the
    store has a flight of it that was launched and is not over.
    """

    vehicle: str
    standing: Standing
    heard_s: float | None
    flies: bool


@dataclass(frozen=True, slots=True)
class CommandFigures:
    """Commands since the desk began, by deed: times to their answers, how many wait for one now,
    how many sendings timed out.
    """

    answer_times: TimesBy
    unanswered: Mapping[str, int]
    timeouts: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class OutboxFigures:
    """Commands that have no final answer, sent or not. `oldest_us`: when the oldest was written
    down; None: there is none.
    """

    rows: int
    oldest_us: int | None


@dataclass(frozen=True, slots=True)
class StoreFigures:
    """`away_since_s` None: it is there. `write_took_s`: its newest writing transaction.
    `retries`: how often it was tried again while it was away.
    """

    away_since_s: float | None
    write_took_s: float | None
    retries: int


@dataclass(frozen=True, slots=True)
class ReplanFigures:
    """Plans made anew, by result, and whether one is being made."""

    times: TimesBy
    is_replanning: bool


@dataclass(frozen=True, slots=True)
class CertificateFigures:
    """When certificates end: the desk's own (None: it is not on the roster, or revoked) and the
    members', those that end soonest first.
    """

    own_us: int | None
    members_us: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class DeskFigures:
    """Everything. `turned_s`: when the desk's loop last came round. `waiting`: messages received
    and not yet taken in. `unlisted`: members beyond `MOST_NAMES`. None: not known, or there is
    none on this desk.
    """

    turned_s: float
    waiting: int
    open_network: bool
    members: tuple[MemberFigures, ...]
    standings: Mapping[Standing, int]
    unlisted: int
    held: int | None
    commands: CommandFigures
    outbox: OutboxFigures | None
    rejected: Mapping[str, int]
    store: StoreFigures
    replans: ReplanFigures | None
    certificates: CertificateFigures | None
    door: DoorFigures | None = None


def listed(members: list[MemberFigures]) -> tuple[MemberFigures, ...]:
    """At most `MOST_NAMES`: first those that fly, then those that are on the network."""
    if len(members) > MOST_NAMES:
        members = sorted(members, key=lambda m: (not m.flies, m.standing is Standing.GONE))
    return tuple(members[:MOST_NAMES])


def days_left(end_us: int, now_us: int) -> float:
    """Days until a certificate ends; below 0 where it has ended."""
    return (end_us - now_us) / DAY_US


def certificates_of(roster: Roster, me: str, own_end_us: int | None = None) -> CertificateFigures:
    """When the certificates of a roster end; who is revoked needs none. `own_end_us`: when the one
    ends that this desk has, where it is known; a roster tells of a newer one before it is carried.
    """
    ends = sorted((m.not_after_us, m.name) for m in roster.members if not m.revoked)
    own = next((end for end, name in ends if name == me), None)
    if own is not None and own_end_us is not None:
        own = min(own, own_end_us)
    others = [(name, end) for end, name in ends if name != me]
    return CertificateFigures(own, tuple(others[:MOST_NAMES]))
