"""STATUSTEXTs as a ground station shows them: those that came in chunks are joined."""

from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.codec import Message

FULL = 50
"""Bytes of a chunk that another follows."""


@dataclass(slots=True)
class JoinedTexts:
    """One sender's texts that have not ended yet, by their number."""

    _begun: dict[int, list[str]] = field(default_factory=dict)

    def take(self, message: Message) -> str | None:
        """The text that ends with this message; None: more of it is to come. A chunk that was lost
        is `...`.
        """
        if message.id == 0:
            return message.text.strip()
        chunks = self._begun.setdefault(message.id, [])
        if message.chunk_seq < len(chunks):  # the number is used again: the old one never ended
            chunks.clear()
        chunks += ["..."] * (message.chunk_seq - len(chunks))
        chunks.append(message.text)
        if len(message.text) >= FULL:
            return None
        return "".join(self._begun.pop(message.id)).strip()
