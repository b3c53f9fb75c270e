"""Who calls a desk or router over TLS: who is on a line that should not be, who was turned away.

A line bears the name in its caller's certificate. A revoked member gets a line, and no rights on
it; a line that is open stays open when its certificate ends, but no new one is had with it.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import Enum

from companion.fleet.roster import Roster, RosterMember


class TurnedAway(Enum):
    """Why a caller got no line."""

    ENDED = "ended"
    STRANGER = "stranger"


class Unwelcome(Enum):
    """Why somebody on a line should not be there."""

    REVOKED = "revoked"
    ENDED = "ended"
    UNLISTED = "unlisted"


UNWELCOME_WORDS = {
    Unwelcome.REVOKED: "is revoked",
    Unwelcome.ENDED: "has a certificate that has ended",
    Unwelcome.UNLISTED: "is not on the roster",
}


@dataclass(frozen=True, slots=True)
class DoorFigures:
    """At one moment. `lines`: open ones by the name in the certificate. `turned_away`: calls since
    the program began; None: nobody counts them here.
    """

    lines: Mapping[str, int] = field(default_factory=dict)
    unwelcome: Mapping[str, Unwelcome] = field(default_factory=dict)
    turned_away: Mapping[TurnedAway, int] | None = None


def unwelcome_on(lines: Iterable[str], roster: Roster, now_us: int) -> dict[str, Unwelcome]:
    """Those of whose messages nobody believes all, and why."""
    found = {name: _why(roster.by_name.get(name), now_us) for name in lines}
    return {name: why for name, why in found.items() if why is not None}


def _why(member: RosterMember | None, now_us: int) -> Unwelcome | None:
    if member is None:
        return Unwelcome.UNLISTED
    if member.revoked:
        return Unwelcome.REVOKED
    return Unwelcome.ENDED if now_us > member.not_after_us else None


def ended_members(roster: Roster, now_us: int) -> list[tuple[str, datetime]]:
    """Who may call with an ended certificate: those of the roster whose end has passed."""
    return [
        (member.name, member.not_after)
        for member in roster.members
        if not member.revoked and now_us > member.not_after_us
    ]


def turned_away_words(new: Counter[TurnedAway], ended: list[tuple[str, datetime]]) -> list[str]:
    """What a person is told of so many calls. Which member called is not known, only who may."""
    words: list[str] = []
    if new[TurnedAway.ENDED]:
        may = ", ".join(f"{name} ({end:%Y-%m-%d})" for name, end in ended[:5])
        more = f", {len(ended) - 5} more" if len(ended) > 5 else ""
        who = f"by the roster ended: {may}{more}" if may else "by the roster nobody's has ended"
        words.append(f"turned away: {new[TurnedAway.ENDED]} with an ended certificate; {who}")
    if new[TurnedAway.STRANGER]:
        count = new[TurnedAway.STRANGER]
        words.append(f"turned away: {count} without a certificate of this fleet")
    return words
