"""Format of the text of phase and decision events: written onboard, read by desk, map and reports.

Phase: `BEFORE -> NOW: REASON`. Decision: `KIND: REASON`; the reason of a diversion is
`to SITE: CAUSE`. Names of phases, kinds and sites contain neither `: ` nor ` -> `.
"""

from typing import NamedTuple

DIVERT = "divert"
_ARROW, _COLON, _TO = " -> ", ": ", "to "


class PhaseEvent(NamedTuple):
    """A transition between two phases of the companion."""

    before: str
    now: str
    reason: str

    @property
    def text(self) -> str:
        """Text of the event."""
        return f"{self.before}{_ARROW}{self.now}{_COLON}{self.reason}"

    @classmethod
    def parse(cls, text: str) -> "PhaseEvent":
        """Read the text of an event; fields that it lacks are empty."""
        phases, _, reason = text.partition(_COLON)
        before, _, now = phases.partition(_ARROW)
        return cls(before, now, reason)


class DecisionEvent(NamedTuple):
    """A decision of the companion."""

    kind: str
    reason: str

    @property
    def text(self) -> str:
        """Text of the event."""
        return f"{self.kind}{_COLON}{self.reason}"

    @classmethod
    def parse(cls, text: str) -> "DecisionEvent":
        """Read the text of an event; without a reason where it has none."""
        kind, _, reason = text.partition(_COLON)
        return cls(kind, reason)

    @classmethod
    def create_diversion(cls, site: str, cause: str) -> "DecisionEvent":
        """Decide to land at another site."""
        return cls(DIVERT, f"{_TO}{site}{_COLON}{cause}")

    @property
    def diversion_site(self) -> str | None:
        """Site of a diversion; None for any other decision."""
        if self.kind != DIVERT:
            return None
        return self.reason.removeprefix(_TO).partition(_COLON)[0]
