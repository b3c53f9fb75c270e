"""STATUSTEXT messages for ground stations: 50 bytes each; a longer text uses several.

QGroundControl, Mission Planner and MAVProxy join them (MAVLink 2).
"""

from dataclasses import dataclass

from companion.adapters.autopilots.codec import mavlink

CHUNK_BYTES = 50
MAX_CHUNKS = 5
"""250 bytes take 20 ms on a radio at 57,600 baud; the log contains the whole text."""

MAX_TEXT_ID = 65535


@dataclass(slots=True)
class StatusTexts:
    """Assigns IDs to texts of several messages; ID 0 marks a text in one message."""

    _text_id: int = 0

    def split_into_messages(self, severity: int, text: str) -> list[mavlink.MAVLink_message]:
        """Return a text's messages. Each chunk except the last is full: a shorter one ends it."""
        raw = text.encode("ascii", "replace")
        if len(raw) <= CHUNK_BYTES:
            return [mavlink.MAVLink_statustext_message(severity, raw)]
        self._text_id = self._text_id % MAX_TEXT_ID + 1
        raw = raw[: CHUNK_BYTES * MAX_CHUNKS - 1]
        return [
            mavlink.MAVLink_statustext_message(
                severity, raw[at : at + CHUNK_BYTES], self._text_id, at // CHUNK_BYTES
            )
            for at in range(0, len(raw) + 1, CHUNK_BYTES)
        ]
