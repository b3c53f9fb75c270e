"""Counts by name, of as many names as are worth the room."""

from collections import Counter
from dataclasses import dataclass, field

MOST_NAMES = 1000
"""As many members as one desk is meant for."""

OTHERS, NOBODY = "others", "nobody"


@dataclass(slots=True)
class NameCounts:
    """The first `most` names have a count each, all later ones one together: it never falls.

    What came from no member at all is counted as `NOBODY`.
    """

    most: int = MOST_NAMES
    counts: Counter[str] = field(default_factory=Counter)

    def add(self, name: str, count: int) -> None:
        """So many more of this name."""
        name = name or NOBODY
        known = name in self.counts or len(self.counts) < self.most
        self.counts[name if known else OTHERS] += count
