"""Log files damaged as by disks, memory cards and cables: byte edits drawn from a seed.

Length fields are located by the layout of each format, because wrong lengths often break readers.
"""

import re
import struct
from collections.abc import Callable, Iterator
from functools import partial

import msgspec
import numpy as np

EDIT_KINDS = ("torn", "flipped", "zeroed", "swapped", "repeated", "cut", "put", "wild-length")
MAX_EDITS = 6
BLOCK_SIZES_BYTES = (1, 8, 64, 512, 4096)
"""Block sizes in bytes: a field, a message, a sector, a flash page."""

MAX_REPEATS = 20
INVALID_VALUES = (
    b"\x00" * 8,
    b"\xff" * 8,
    struct.pack("<d", float("nan")),
    struct.pack("<d", float("inf")),
    struct.pack("<f", float("nan")),
    struct.pack("<f", -3e38),
    struct.pack("<Q", 1 << 62),
    b"1e308,",
    b"-1e300",
    b"nan,",
    b"\n\n\n",
    b'"',
    b"\xc3",
    b",",
)
INVALID_LENGTHS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1)


class Edit(msgspec.Struct, frozen=True):
    """One edit at a fraction of the current length, of `size` bytes."""

    kind: str = msgspec.field(name="deed")
    position_frac: float = msgspec.field(name="at")
    size: int
    random_value: int = msgspec.field(name="draw")
    """Random number for the edit: a second position, a bit or a value."""


def draw_random_edits(rng: np.random.Generator) -> tuple[Edit, ...]:
    """Draw between 1 and MOST_EDITS edits."""
    return tuple(
        Edit(
            str(rng.choice(EDIT_KINDS)),
            round(float(rng.random()), 6),
            int(rng.choice(BLOCK_SIZES_BYTES)),
            int(rng.integers(1 << 31)),
        )
        for _ in range(rng.integers(1, MAX_EDITS + 1))
    )


def apply_edits(log_format: str, log_bytes: bytes, edits: tuple[Edit, ...]) -> bytes:
    """Return `log_bytes`, a log of this kind, after these edits."""
    for edit in edits:
        log_bytes = _apply_edit(log_format, log_bytes, edit)
    return log_bytes


def _apply_edit(log_format: str, log_bytes: bytes, edit: Edit) -> bytes:
    at, size = int(edit.position_frac * len(log_bytes)), edit.size
    block = log_bytes[at : at + size]
    match edit.kind:
        case "torn":
            return log_bytes[:at]
        case "flipped":
            new = bytes(byte ^ 1 << edit.random_value % 8 for byte in block)
        case "zeroed":
            new = bytes(len(block))
        case "swapped":
            return _swap_blocks(log_bytes, at, edit.random_value % max(len(log_bytes), 1), size)
        case "repeated":
            new = block * (1 + edit.random_value % MAX_REPEATS)
        case "cut":
            new = b""
        case "put":
            new = INVALID_VALUES[edit.random_value % len(INVALID_VALUES)]
            size = len(new)
        case _:
            return _corrupt_length_field(log_format, log_bytes, edit)
    return log_bytes[:at] + new + log_bytes[at + size :]


def _swap_blocks(
    log_bytes: bytes, block_offset: int, other_block_offset: int, block_bytes: int
) -> bytes:
    first, second = sorted((block_offset, other_block_offset))
    block_bytes = min(block_bytes, second - first, len(log_bytes) - second)
    a, b = slice(first, first + block_bytes), slice(second, second + block_bytes)
    swapped = bytearray(log_bytes)
    swapped[a], swapped[b] = swapped[b], swapped[a]
    return bytes(swapped)


def _corrupt_length_field(log_format: str, log_bytes: bytes, edit: Edit) -> bytes:
    """Replace one length field of the file; in CSV, lengthen one cell."""
    if log_format == "csv":
        at = max(log_bytes.rfind(b",", 0, int(edit.position_frac * len(log_bytes))), 0)
        return log_bytes[:at] + b"9" * (edit.random_value % 10_000) + log_bytes[at:]
    length_fields = list(LENGTH_FINDERS[log_format](log_bytes))
    if not length_fields:
        return log_bytes
    at, width = length_fields[int(edit.position_frac * len(length_fields))]
    value = INVALID_LENGTHS[edit.random_value % len(INVALID_LENGTHS)] % (1 << 8 * width)
    return log_bytes[:at] + value.to_bytes(width, "little") + log_bytes[at + width :]


def _ulog_length_field_offsets_and_widths(raw: bytes) -> Iterator[tuple[int, int]]:
    """Yield 2 bytes of each message (ULog: header of 16 bytes, then size, kind, body)."""
    at = 16
    while at + 3 <= len(raw):
        yield at, 2
        at += 3 + int.from_bytes(raw[at : at + 2], "little")


def _mcap_length_field_offsets_and_widths(raw: bytes) -> Iterator[tuple[int, int]]:
    """Yield 8 bytes of each record, and 4 of its first string or map."""
    at = 8
    while at + 9 <= len(raw):
        yield at + 1, 8
        yield at + 9, 4
        at += 9 + int.from_bytes(raw[at + 1 : at + 9], "little")


def _bytes_after_marker(marker: bytes, offset: int, raw: bytes) -> Iterator[tuple[int, int]]:
    """Yield the byte at this offset from the start of each marker."""
    return ((found.start() + offset, 1) for found in re.finditer(re.escape(marker), raw))


LENGTH_FINDERS: dict[str, Callable[[bytes], Iterator[tuple[int, int]]]] = {
    "ulog": _ulog_length_field_offsets_and_widths,
    "mcap": _mcap_length_field_offsets_and_widths,
    "dataflash": partial(_bytes_after_marker, b"\xa3\x95\x80", 4),  # of a format message (128)
    "tlog": partial(_bytes_after_marker, b"\xfd", 1),
}
"""Generators of the position and width of length fields, by format."""
