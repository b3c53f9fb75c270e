"""Commands that were received: each is carried out once, and always gets the same answer.

Written down before a command is carried out and again with its answer, so that a companion killed
between the two does not launch a second time: it answers `interrupted`.
"""

import hashlib
from dataclasses import dataclass, field
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError
from companion.fleet.messages import FINAL, Answered, Command, HandBack, Launch, Recall

FRESH_S = 15.0
"""A command rests on a state no older, by the vehicle's own clock; states come every second."""

KEPT = 2000
"""Commands remembered: a day's work of one vehicle many times over, in about 200 kB."""


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One command as it was taken; without an answer it is (or was, when killed) being done."""

    id: str
    digest: str
    answer: Answered | None = None
    reason: str = ""


class BookKept(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The book as it lies on the disk."""

    format: Literal["command-book/1"] = "command-book/1"
    entries: list[Entry] = []
    ended: list[str] = []


ONCE = (Launch, HandBack)
"""What a companion that was killed while doing it must not do again; the rest, done twice, is the
same as done once.
"""


@dataclass(frozen=True, slots=True)
class Verdict:
    """An answer that needs nothing to be carried out."""

    answer: Answered
    reason: str = ""


@dataclass(slots=True)
class CommandBook:
    """`look` first; where it returns `None`, `begin`, carry out, `end`.

    `ended` are assignments that are over: nothing launches them again.
    """

    entries: dict[str, Entry] = field(default_factory=dict)
    ended: list[str] = field(default_factory=list)

    def look(self, command: Command, life: str, uptime_s: float) -> Verdict | None:
        """The answer to a command that is known, stale, or none of ours; `None`: carry it out."""
        known = self.entries.get(command.id)
        if known is not None:
            verdict = _again(known, digest_of(command))
            cut = verdict.answer in (Answered.INTERRUPTED, Answered.LATER)
            if not cut or isinstance(command.deed, ONCE):
                return verdict
        if isinstance(command.deed, Recall):
            return None
        if command.life != life:
            return Verdict(Answered.STALE, "meant for another life of this companion")
        age_s = uptime_s - command.as_of_s
        if age_s < 0.0:  # the desk copies a state's uptime: an honest one is never ahead
            words = f"rests on a state of {-age_s:.0f} s from now: nobody can know it"
            return Verdict(Answered.REFUSED, words)
        if age_s > FRESH_S:
            words = f"rests on a state {age_s:.0f} s old, expected at most {FRESH_S:.0f} s"
            return Verdict(Answered.STALE, words)
        assignment = getattr(command.deed, "assignment", None)
        if assignment in self.ended:
            return Verdict(Answered.REFUSED, f"assignment {assignment} is over")
        return None

    def begin(self, command: Command) -> None:
        """A command is about to be carried out."""
        self._note(Entry(id=command.id, digest=digest_of(command)))

    def end(self, command: Command, verdict: Verdict) -> None:
        """It has been; an answer that settles nothing is forgotten, so that it may come again."""
        if verdict.answer in FINAL:
            entry = Entry(
                id=command.id,
                digest=digest_of(command),
                answer=verdict.answer,
                reason=verdict.reason,
            )
            self._note(entry)
        else:
            self.entries.pop(command.id, None)

    def close(self, assignment: str) -> None:
        """An assignment is over."""
        if assignment not in self.ended:
            self.ended = [*self.ended, assignment][-KEPT:]

    def _note(self, entry: Entry) -> None:
        self.entries.pop(entry.id, None)
        self.entries[entry.id] = entry
        while len(self.entries) > KEPT:
            self.entries.pop(next(iter(self.entries)))

    def kept(self) -> BookKept:
        """What a restart needs."""
        return BookKept(entries=list(self.entries.values()), ended=list(self.ended))

    @classmethod
    def restored(cls, kept: BookKept) -> "CommandBook":
        """The book as it was; what was being done is now `interrupted`."""
        entries = {
            e.id: e
            if e.answer is not None
            else msgspec.structs.replace(e, answer=_CUT, reason=_WHY)
            for e in kept.entries
        }
        return cls(entries, list(kept.ended))


_CUT = Answered.INTERRUPTED
_WHY = "the companion restarted while doing it; its state tells how it went"


def book_from_dict(table: object, where: str) -> CommandBook:
    """Check a book that was read; LeewayError names the file."""
    try:
        return CommandBook.restored(msgspec.convert(table, BookKept))
    except msgspec.ValidationError as error:
        raise LeewayError(f"{where}: {error}") from error


def digest_of(command: Command) -> str:
    """Tells two commands apart by what they ask, not by when they were sent."""
    asked = msgspec.json.encode((command.vehicle, command.deed), order="deterministic")
    return hashlib.sha256(asked).hexdigest()[:16]


def _again(known: Entry, digest: str) -> Verdict:
    if known.digest != digest:
        return Verdict(Answered.REFUSED, "this id was used for another command")
    if known.answer is None:
        return Verdict(Answered.LATER, "being done")
    return Verdict(known.answer, known.reason)
