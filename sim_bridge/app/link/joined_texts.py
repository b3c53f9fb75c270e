"""STATUSTEXTs as displayed by a ground station, with chunks joined."""

from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.codec import Message

FULL_CHUNK_BYTES = 50
"""Bytes of a chunk that is not the last."""


@dataclass(slots=True)
class JoinedTexts:
    """Incomplete texts of one sender, by their `id`."""

    _chunks_by_id: dict[int, list[str]] = field(default_factory=dict)

    def add_chunk_and_take_complete_text(self, message: Message) -> str | None:
        """Return the text that this message completes, or None if chunks are missing at its end.
        A lost chunk becomes `...`.
        """
        if message.id == 0:
            return message.text.strip()
        chunks = self._chunks_by_id.setdefault(message.id, [])
        if message.chunk_seq < len(chunks):  # the id is reused: the previous text is incomplete
            chunks.clear()
        chunks += ["..."] * (message.chunk_seq - len(chunks))
        chunks.append(message.text)
        if len(message.text) >= FULL_CHUNK_BYTES:
            return None
        return "".join(self._chunks_by_id.pop(message.id)).strip()
