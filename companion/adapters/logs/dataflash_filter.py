"""Extracts the whole messages of a dataflash log before DFReader reads it.

For bytes that are no message, DFReader's indexer prints one line each directly to the terminal
(34,000 lines for one damaged sector), and it stops at the first message of an unknown type. So
damaged bytes are removed here and reported as a finding.

Format: ardupilot.org, "Log File Structure", and the FMT messages at the start of every log.
"""

import struct
from dataclasses import dataclass

MAGIC = b"\xa3\x95"
HEADER_BYTES = 3
FMT_TYPE, FMT_BYTES = 128, 89
FMT = struct.Struct("<3xBB4s16s64s")
PADDING_BYTES = 528
"""Padding at the end of a log from a flash chip, up to the end of its page: no damage."""

ITEM_BYTES = {"a": 64, "b": 1, "B": 1, "g": 2, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "n": 4,
              "N": 16, "Z": 64, "c": 2, "C": 2, "e": 4, "E": 4, "L": 4, "d": 8, "M": 1, "q": 8,
              "Q": 8}  # fmt: skip
"""Sizes of items by their format letter."""


@dataclass(frozen=True, slots=True)
class WholeMessages:
    """`data`: the log without damaged bytes; `None` if unchanged. `first_damaged_at`,
    `damaged_sections`, `damaged_bytes`: position of the first damaged byte, number of damaged
    sections and bytes.
    """

    data: bytes | None
    first_damaged_at: int
    damaged_sections: int
    damaged_bytes: int


def extract_undamaged_messages(raw: bytes) -> WholeMessages:
    """Read message by message; at a damaged byte, search for the next message."""
    sizes = {FMT_TYPE: FMT_BYTES}
    parts: list[bytes] = []
    at, kept_from, size = 0, 0, len(raw)
    first_at = damaged_sections = damaged_bytes = 0
    while at < size:
        end = _message_end_storing_size(raw, at, sizes)
        if end is not None:
            at = end
            continue
        next_start = _next_message_start(raw, at + 1, sizes)
        if next_start < size or size - at >= PADDING_BYTES:
            first_at = at if not damaged_sections else first_at
            damaged_sections, damaged_bytes = damaged_sections + 1, damaged_bytes + next_start - at
        parts.append(raw[kept_from:at])
        at = kept_from = next_start
    parts.append(raw[kept_from:])
    data = b"".join(parts) if len(parts) > 1 else None
    return WholeMessages(data, first_at, damaged_sections, damaged_bytes)


def _next_message_start(raw: bytes, begin: int, size_by_message_type: dict[int, int]) -> int:
    at = raw.find(MAGIC, begin)
    while at >= 0 and _message_end_storing_size(raw, at, size_by_message_type) is None:
        at = raw.find(MAGIC, at + 1)
    return at if at >= 0 else len(raw)


def _message_end_storing_size(
    raw: bytes, at: int, size_by_message_type: dict[int, int]
) -> int | None:
    """Return the end of the message at this position; `None` if no whole message starts here.

    A truncated message is not followed by another; the bytes it covers are searched again.
    """
    if raw[at : at + 2] != MAGIC or at + HEADER_BYTES > len(raw):
        return None
    kind = raw[at + 2]
    end = at + size_by_message_type.get(kind, len(raw) + 1)
    if end > len(raw):
        return None
    if raw[end : end + 2] != MAGIC[: len(raw) - end] and raw.find(MAGIC, end) >= 0:
        return None
    return (
        end
        if kind != FMT_TYPE or _store_message_size_if_consistent(raw, at, size_by_message_type)
        else None
    )


def _store_message_size_if_consistent(
    raw: bytes, at: int, size_by_message_type: dict[int, int]
) -> bool:
    """Store the size of a message type; `False` for an inconsistent format."""
    kind, length, _, format_codes, _ = FMT.unpack_from(raw, at)
    items = format_codes.rstrip(b"\0").decode("latin-1")
    if any(item not in ITEM_BYTES for item in items):
        return False
    if length != HEADER_BYTES + sum(ITEM_BYTES[item] for item in items):
        return False
    size_by_message_type[kind] = length
    return True
