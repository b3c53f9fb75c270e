"""Format of the text of phase and decision events: written onboard, read by desk, map and reports.

Phase: `BEFORE -> NOW: REASON`. Decision: `KIND: REASON`; the reason of a diversion is
`to SITE: CAUSE`, that of a delivery `EVIDENCE; released at LAT, LON`. Names of phases, kinds and
sites contain neither `: ` nor ` -> `.
"""

from typing import NamedTuple

DIVERT, DELIVERED = "divert", "delivered"
_ARROW, _COLON, _TO, _AT = " -> ", ": ", "to ", "; released at "


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

    @classmethod
    def create_delivery(cls, evidence: str, lat_deg: float, lon_deg: float) -> "DecisionEvent":
        """Confirm the release of the parcel."""
        return cls(DELIVERED, f"{evidence}{_AT}{lat_deg:.6f}, {lon_deg:.6f}")

    @property
    def release_evidence(self) -> str:
        """Evidence of the release of a delivery."""
        return self.reason.partition(_AT)[0]

    @property
    def release_position(self) -> tuple[float, float] | None:
        """Latitude and longitude of a release, degrees; None: not reported."""
        lat, _, lon = self.reason.partition(_AT)[2].partition(", ")
        try:
            return float(lat), float(lon)
        except ValueError:
            return None

    @property
    def diversion_site(self) -> str | None:
        """Site of a diversion; None for any other decision."""
        if self.kind != DIVERT:
            return None
        return self.reason.removeprefix(_TO).partition(_COLON)[0]
