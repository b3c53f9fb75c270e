"""A member's link on which everything is signed: bytes go out in envelopes, and only what the
roster allows comes in. The member behind it does not know the difference.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.adapters.clock import is_due
from companion.fleet.messages import Answered, Refused, Result, encode
from companion.fleet.network import Ask, Asked, MemberLink, Told
from companion.fleet.refusals import Refusals
from companion.fleet.trust import DAY_S, Trust


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
                return Asked(asked.ask, self._sealing("event", asked.answer), after=asked.after)
            case Ask.ROSTER:
                self._take_roster(asked.payload)
                return None
            case _:
                return asked

    def _command(self, asked: Asked) -> Asked | None:
        answer = self._sealing("result", asked.answer)
        found = self.trust.commanded(asked.payload)
        if isinstance(found, Refused):
            self.refusals.note(found.reason)
            answer([encode(self._refusal(found.reason))])
            return None
        return Asked(Ask.COMMAND, answer, found.raw, signer=found.signer)

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
            self.refusals.note(taken.reason)
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
        found: dict[str, Told] = {}
        for told in reversed(self.link.tracks()):
            if told.speaker in found:
                continue
            raw = self.trust.told("track", told.raw, told.speaker)
            if isinstance(raw, Refused):
                self.refusals.note(f"{told.speaker}: {raw.reason}")
            else:
                found[told.speaker] = Told(told.speaker, raw)
        return list(found.values())

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

    def publish_track(self, raw: bytes) -> None:
        """Tell the neighbours where we are."""
        self.link.publish_track(self.trust.seal("track", raw))

    def _sealing(
        self, kind: str, answer: Callable[[list[bytes]], None]
    ) -> Callable[[list[bytes]], None]:
        return lambda replies: answer([self.trust.seal(kind, raw) for raw in replies])

    def close(self) -> None:
        """Say what is left to say, and leave."""
        self.link.close()


def _notice(words: str) -> Asked:
    return Asked(Ask.NOTICE, lambda replies: None, words.encode())
