"""A member's link on which everything is signed: bytes go out in envelopes, and only what the
roster allows comes in. The member behind it does not know the difference.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from companion.adapters.clock import is_due
from companion.core.base.rate_limit import RateLimit
from companion.core.mission.flight_file import NeighbourFleet
from companion.fleet.envelope import read_envelope
from companion.fleet.messages import Answered, Refused, Result, decode_told_track, encode
from companion.fleet.network import Ask, Asked, MemberLink, Told
from companion.fleet.refusals import Refusals
from companion.fleet.roles import COMMANDS
from companion.fleet.trust import DAY_S, Trust, told_by_neighbour

FAILED_HZ, FAILED_BURST = 250.0, 500.0
"""Messages that were not believed and are looked at, of each name that they claim: a look costs 0.1
ms, an answer as much. Beyond it all in this name are left out; of those that come of nobody so few
that the flight's loop is free for the others.
"""

ROSTERS = "an authority"
"""No member's name."""

TOLD_HZ, TOLD_BURST = 400.0, 4000.0
"""Events that are told again: signing one takes 0.1 ms, and anybody may ask for all. Twice what a
member keeps at once, for those who come to the network together.
"""


@dataclass(slots=True)
class SignedLink:
    """One life of one member. It takes newer rosters in as they come."""

    link: MemberLink
    trust: Trust
    life: str
    clock_s: Callable[[], float]
    refusals: Refusals = field(default_factory=Refusals)
    _notices: list[str] = field(default_factory=list)
    _warned_s: float | None = None
    _failed: dict[str, RateLimit] = field(default_factory=dict)
    _told: RateLimit = field(default_factory=lambda: RateLimit(TOLD_HZ, TOLD_BURST))
    _neighbours: dict[str, NeighbourFleet] = field(default_factory=dict)

    # --- in ------------------------------------------------------------------------------------

    def asked(self) -> list[Asked]:
        """Everything that waits and may be believed, and notices of what may not."""
        found = [passed for one in self.link.asked() if (passed := self._passed(one)) is not None]
        now_s = self.clock_s()
        if is_due(self._warned_s, DAY_S, now_s):
            self._warn(now_s)
        said = self.refusals.due(now_s)
        notices = [*self._notices, *([said] if said is not None else [])]
        self._notices.clear()
        return [*found, *(_notice(words) for words in notices)]

    def _passed(self, asked: Asked) -> Asked | None:
        match asked.ask:
            case Ask.COMMAND:
                return self._command(asked)
            case Ask.EVENTS:
                return Asked(asked.ask, self._telling(asked.answer), after=asked.after)
            case Ask.ROSTER:
                if self._may_look(ROSTERS):
                    self._take_roster(asked.payload)
                return None
            case _:
                return asked

    def _command(self, asked: Asked) -> Asked | None:
        name = claimed_by(self.trust, asked.payload)
        if not self._may_look(name):
            return None
        answer = self._sealing("result", asked.answer)
        found = self.trust.commanded(asked.payload)
        if isinstance(found, Refused):
            self._note(name, found.reason)
            answer([encode(self._refusal(found.reason))])
            return None
        return Asked(Ask.COMMAND, answer, found.raw, signer=found.signer)

    def _may_look(self, name: str) -> bool:
        """Whether a message in this name is looked at: after a flood of forged ones it may wait."""
        limit = self._failed.get(name)
        if limit is None or limit.take(self.clock_s(), 0.0):
            return True
        self.refusals.note(f"too many in the name of {name or 'nobody'} to look at")
        return False

    def _note(self, name: str, reason: str) -> None:
        self.refusals.note(reason)
        limit = self._failed.setdefault(name, RateLimit(FAILED_HZ, FAILED_BURST))
        limit.spend(self.clock_s(), 1.0)

    def _refusal(self, reason: str) -> Result:
        """It names no command: an answer that did would be ours, signed, to a command that the
        desk really sent, at the asking of somebody who only knows its id.
        """
        return Result(
            id="", vehicle=self.trust.name, life=self.life, answer=Answered.REFUSED, reason=reason
        )

    def _take_roster(self, raw: bytes) -> None:
        try:
            taken = self.trust.take_roster(raw)
        except OSError as error:
            self._notices.append(f"roster not written down: {error.strerror}")
            return
        if isinstance(taken, Refused):
            self._note(ROSTERS, taken.reason)
        elif taken is not None:
            self._notices.append(f"roster {taken.number} is in force")
            self._warn(self.clock_s())

    def _warn(self, now_s: float) -> None:
        """At the start, with each roster, and again every day: a program may run for months."""
        self._warned_s = now_s
        warning = self.trust.warning()
        if warning:
            self._notices.append(warning)

    def tracks(self) -> list[Told]:
        """The newest that each neighbour told and signed itself."""
        found: dict[tuple[str, str], Told] = {}
        for told in reversed(self.link.tracks()):
            who = (told.fleet, told.speaker)
            if who in found:
                continue
            believed = self._believed(told)
            if isinstance(believed, Refused):
                self.refusals.note(believed.reason)
            else:
                found[who] = believed
        return list(found.values())

    def _believed(self, told: Told) -> Told | Refused:
        """The cell is looked at here: a true track that somebody plays to another cell does not
        hide the one before it.
        """
        raw = self._opened(told)
        if isinstance(raw, Refused):
            return Refused(f"{told.name}: {raw.reason}")
        opened = replace(told, raw=raw)
        track = decode_told_track(opened)
        return track if isinstance(track, Refused) else opened

    def _opened(self, told: Told) -> bytes | Refused:
        if not told.fleet:
            return self.trust.told("track", told.raw, told.speaker)
        neighbour = self._neighbours.get(told.fleet)
        if neighbour is None:
            return Refused("track: of no neighbour any more")
        return told_by_neighbour(neighbour, told.raw, told.speaker)

    def hear_fleets(self, neighbours: Sequence[NeighbourFleet]) -> None:
        """Listen to these fleets, too. Whose vehicles' keys nobody has told is not believed, and
        so not listened to.
        """
        known = [one for one in neighbours if one.keys]
        if without := [one.fleet for one in neighbours if not one.keys]:
            words = f"no keys of their vehicles: not kept apart from {', '.join(without)}"
            self._notices.append(words)
        self._neighbours = {one.fleet: one for one in known}
        self.link.hear_fleets(known)

    def hear_near(self, lat_deg: float, lon_deg: float) -> None:
        """Listen to the cells about this place."""
        self.link.hear_near(lat_deg, lon_deg)

    def winds(self) -> list[bytes]:
        """What a desk signed of the winds of others."""
        found: list[bytes] = []
        for raw in self.link.winds():
            told = self.trust.told_winds(raw)
            if isinstance(told, Refused):
                self.refusals.note(told.reason)
            else:
                found.append(told)
        return found

    def wind_cov_is_read(self) -> bool:
        """Whether all who asked for states of late read the covariance of the wind."""
        return self.link.wind_cov_is_read()

    def be_woken(self, wake: Callable[[], None]) -> None:
        """Who waits now."""
        self.link.be_woken(wake)

    # --- out -----------------------------------------------------------------------------------

    def publish_state(self, raw: bytes) -> None:
        """Tell the newest state."""
        self.link.publish_state(self.trust.seal("state", raw))

    def publish_event(self, raw: bytes) -> None:
        """Tell an event."""
        self.link.publish_event(self.trust.seal("event", raw))

    def publish_track(self, raw: bytes, cell: str) -> None:
        """Tell those who listen to this cell where we are."""
        self.link.publish_track(self.trust.seal("track", raw), cell)

    def _telling(self, answer: Callable[[list[bytes]], None]) -> Callable[[list[bytes]], None]:
        """Events in their envelopes, or none: they are asked for again."""

        def tell(replies: list[bytes]) -> None:
            free = self._told.take(self.clock_s(), len(replies))
            answer([self.trust.seal("event", raw) for raw in replies] if free else [])

        return tell

    def _sealing(
        self, kind: str, answer: Callable[[list[bytes]], None]
    ) -> Callable[[list[bytes]], None]:
        return lambda replies: answer([self.trust.seal(kind, raw) for raw in replies])

    def close(self) -> None:
        """Say what is left to say, and leave."""
        self.link.close()


def claimed_by(trust: Trust, raw: bytes) -> str:
    """In whose name a command comes, of those on the roster who may command; empty: nobody's. He
    need not have signed it.
    """
    envelope = read_envelope("command", raw)
    if isinstance(envelope, Refused):
        return ""
    member = trust.roster.by_name.get(envelope.signer)
    may = member is not None and not member.revoked and member.role in COMMANDS
    return envelope.signer if may else ""


def _notice(words: str) -> Asked:
    return Asked(Ask.NOTICE, lambda replies: None, words.encode())
