"""The whole messages of a dataflash log, before DFReader sees it.

Of bytes that are no message DFReader's indexer prints a line each, past Python and straight to the
terminal (34,000 lines of one torn sector, seen), and it stops at the first message of a type that
it does not know. So what is damaged is left out here, and told as a finding.

Format: ardupilot.org, "Log File Structure", and the FMT messages that every log begins with.
"""

import struct
from dataclasses import dataclass

MAGIC = b"\xa3\x95"
HEADER_BYTES = 3
FMT_TYPE, FMT_BYTES = 128, 89
FMT = struct.Struct("<3xBB4s16s64s")
PADDING_BYTES = 528
"""At the end of a log from a board's flash chip, to the end of its page: no damage."""

ITEM_BYTES = {"a": 64, "b": 1, "B": 1, "g": 2, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "n": 4,
              "N": 16, "Z": 64, "c": 2, "C": 2, "e": 4, "E": 4, "L": 4, "d": 8, "M": 1, "q": 8,
              "Q": 8}  # fmt: skip
"""By the letter of a format."""


@dataclass(frozen=True, slots=True)
class WholeMessages:
    """`data`: the log without what is no message; `None` where all of it is. `first_at`, `places`
    and `left_out`: the first such byte, in how many places, and how many bytes.
    """

    data: bytes | None
    first_at: int
    places: int
    left_out: int


def whole_messages(raw: bytes) -> WholeMessages:
    """Walk from message to message; where there is none, look for the next."""
    sizes = {FMT_TYPE: FMT_BYTES}
    parts: list[bytes] = []
    at, kept_from, size = 0, 0, len(raw)
    first_at = places = left_out = 0
    while at < size:
        end = _end_of_message(raw, at, sizes)
        if end is not None:
            at = end
            continue
        following = _next_message(raw, at + 1, sizes)
        if following < size or size - at >= PADDING_BYTES:
            first_at = at if not places else first_at
            places, left_out = places + 1, left_out + following - at
        parts.append(raw[kept_from:at])
        at = kept_from = following
    parts.append(raw[kept_from:])
    data = b"".join(parts) if len(parts) > 1 else None
    return WholeMessages(data, first_at, places, left_out)


def _next_message(raw: bytes, begin: int, sizes: dict[int, int]) -> int:
    at = raw.find(MAGIC, begin)
    while at >= 0 and _end_of_message(raw, at, sizes) is None:
        at = raw.find(MAGIC, at + 1)
    return at if at >= 0 else len(raw)


def _end_of_message(raw: bytes, at: int, sizes: dict[int, int]) -> int | None:
    """Where the message here ends; `None` where none begins that is whole.

    One that is cut is followed by no other; what it has swallowed of the next is looked at again.
    """
    if raw[at : at + 2] != MAGIC or at + HEADER_BYTES > len(raw):
        return None
    kind = raw[at + 2]
    end = at + sizes.get(kind, len(raw) + 1)
    if end > len(raw):
        return None
    if raw[end : end + 2] != MAGIC[: len(raw) - end] and raw.find(MAGIC, end) >= 0:
        return None
    return end if kind != FMT_TYPE or _learn(raw, at, sizes) else None


def _learn(raw: bytes, at: int, sizes: dict[int, int]) -> bool:
    """Note the size of a type; `False` for a format that contradicts itself."""
    kind, length, _, letters, _ = FMT.unpack_from(raw, at)
    items = letters.rstrip(b"\0").decode("latin-1")
    if any(item not in ITEM_BYTES for item in items):
        return False
    if length != HEADER_BYTES + sum(ITEM_BYTES[item] for item in items):
        return False
    sizes[kind] = length
    return True
