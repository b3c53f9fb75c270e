"""How long something took, counted by upper bounds: small however often it happened."""

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, replace

TimesBy = Mapping[str, "TimeCounts"]
"""By a name of a few: a deed, a result."""


@dataclass(frozen=True, slots=True)
class TimeCounts:
    """`counts[k]` took at most `bounds_s[k]` and longer than the bound before; the last count took
    longer than all bounds. Another duration makes new counts: who holds these may keep them.
    """

    bounds_s: tuple[float, ...]
    counts: tuple[int, ...]
    sum_s: float = 0.0

    @classmethod
    def none(cls, bounds_s: tuple[float, ...]) -> "TimeCounts":
        """Nothing has happened yet."""
        return cls(bounds_s, (0,) * (len(bounds_s) + 1))

    @property
    def total(self) -> int:
        """How often it happened."""
        return sum(self.counts)

    def and_one(self, took_s: float) -> "TimeCounts":
        """The same and one more, which took so long."""
        k = bisect_left(self.bounds_s, took_s)
        counts = (*self.counts[:k], self.counts[k] + 1, *self.counts[k + 1 :])
        return replace(self, counts=counts, sum_s=self.sum_s + took_s)
