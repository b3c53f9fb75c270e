"""Texts for ground stations. A STATUSTEXT carries 50 bytes; a longer text goes in several.

QGroundControl, Mission Planner and MAVProxy join them again (MAVLink 2).
"""

from dataclasses import dataclass

from companion.adapters.autopilots.codec import mavlink

CHUNK_BYTES = 50
MOST_CHUNKS = 5
"""250 bytes are 20 ms more of a radio at 57,600 baud; the log has the whole text."""

LARGEST_ID = 65535


@dataclass(slots=True)
class StatusTexts:
    """Numbers the texts that need several messages; 0 is for those that need one."""

    _id: int = 0

    def messages(self, severity: int, text: str) -> list[mavlink.MAVLink_message]:
        """A text as it is sent. Each chunk but the last is full: a shorter one ends the text."""
        raw = text.encode("ascii", "replace")
        if len(raw) <= CHUNK_BYTES:
            return [mavlink.MAVLink_statustext_message(severity, raw)]
        self._id = self._id % LARGEST_ID + 1
        raw = raw[: CHUNK_BYTES * MOST_CHUNKS - 1]
        return [
            mavlink.MAVLink_statustext_message(
                severity, raw[at : at + CHUNK_BYTES], self._id, at // CHUNK_BYTES
            )
            for at in range(0, len(raw) + 1, CHUNK_BYTES)
        ]
