"""What was heard and not believed: all of it counted, said at most once a minute."""

from collections import Counter
from dataclasses import dataclass, field

SAY_AGAIN_S = 60.0
KINDS = 50
"""Reasons told apart: whoever forges may make up any number of them."""


@dataclass(slots=True)
class Refusals:
    """Counts by reason; `due` empties it into one line."""

    total: int = 0
    _counts: Counter[str] = field(default_factory=Counter)
    _said_s: float | None = None

    def note(self, reason: str) -> None:
        """One more."""
        self.total += 1
        known = reason in self._counts or len(self._counts) < KINDS
        self._counts[reason if known else "other reasons"] += 1

    def due(self, now_s: float) -> str | None:
        """What a person should be told now; None: nothing, or not yet again."""
        recent = self._said_s is not None and now_s - self._said_s < SAY_AGAIN_S
        if recent or not self._counts:
            return None
        said = "; ".join(f"{reason} ({n})" for reason, n in self._counts.most_common(3))
        others = len(self._counts) - 3
        more = f"; {others} other reasons" if others > 0 else ""
        self._counts, self._said_s = Counter(), now_s
        return f"not believed: {said}{more}"[:500]
