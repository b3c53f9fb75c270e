"""How long commands take to be answered, by deed, and which wait for an answer now."""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field

from ground_station.core.fleet.time_counts import TimeCounts

BOUNDS_S = (0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Loopback takes milliseconds, a bad radio a second or two; 5 s is the time-out of one sending."""


@dataclass(slots=True)
class AnswerTimes:
    """Of the commands that one desk has sent since it began. A command that is sent again counts
    from its first sending. `timeouts`: sendings that nobody answered in time, by deed.
    """

    by_deed: dict[str, TimeCounts] = field(default_factory=dict)
    timeouts: Counter[str] = field(default_factory=Counter)
    _sent: dict[str, tuple[str, float]] = field(default_factory=dict)

    def sent(self, id_: str, deed: str, t_s: float) -> None:
        """A command has left the desk, for the first time or again."""
        self._sent.setdefault(id_, (deed, t_s))

    def timed_out(self, id_: str) -> None:
        """Nobody has answered one sending in time."""
        if id_ in self._sent:
            self.timeouts[self._sent[id_][0]] += 1

    def answered(self, id_: str, t_s: float) -> None:
        """A command's final answer has come."""
        if id_ in self._sent:
            deed, sent_s = self._sent.pop(id_)
            before = self.by_deed.get(deed) or TimeCounts.none(BOUNDS_S)
            self.by_deed[deed] = before.and_one(t_s - sent_s)

    def keep_only(self, ids: Collection[str]) -> None:
        """All others need no answer any more: they are void, or were answered to another desk."""
        self._sent = {id_: sent for id_, sent in self._sent.items() if id_ in ids}

    @property
    def unanswered(self) -> Counter[str]:
        """How many wait for their final answer, by deed."""
        return Counter(deed for deed, _ in self._sent.values())
