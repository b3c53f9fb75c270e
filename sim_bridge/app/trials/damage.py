"""Logs damaged as disks, cards and cables damage them: edits of a file's bytes, drawn by seed.

Lengths are found by each format's own layout, for a wrong length is what makes readers stumble.
"""

import struct
from collections.abc import Callable, Iterator

import msgspec
import numpy as np

DEEDS = ("torn", "flipped", "zeroed", "swapped", "repeated", "cut", "put", "wild-length")
MOST_EDITS = 6
BLOCKS = (1, 8, 64, 512, 4096)
"""Bytes of a block: a field, a message, a sector, a page of flash."""

MOST_REPEATS = 20
NASTY = (
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
LENGTHS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1)


class Edit(msgspec.Struct, frozen=True):
    """One deed at a share of the length that is left, on so many bytes."""

    deed: str
    at: float
    size: int
    draw: int
    """What else the deed needs drawn: another place, a bit, a value."""


def drawn_edits(rng: np.random.Generator) -> tuple[Edit, ...]:
    """Between one and some edits."""
    return tuple(
        Edit(
            str(rng.choice(DEEDS)),
            round(float(rng.random()), 6),
            int(rng.choice(BLOCKS)),
            int(rng.integers(1 << 31)),
        )
        for _ in range(rng.integers(1, MOST_EDITS + 1))
    )


def damaged(kind: str, raw: bytes, edits: tuple[Edit, ...]) -> bytes:
    """`raw`, a log of this kind, after these edits."""
    for edit in edits:
        raw = _edited(kind, raw, edit)
    return raw


def _edited(kind: str, raw: bytes, edit: Edit) -> bytes:
    at, size = int(edit.at * len(raw)), edit.size
    block = raw[at : at + size]
    match edit.deed:
        case "torn":
            return raw[:at]
        case "flipped":
            return raw[:at] + bytes(byte ^ 1 << edit.draw % 8 for byte in block) + raw[at + size :]
        case "zeroed":
            return raw[:at] + bytes(len(block)) + raw[at + size :]
        case "swapped":
            return _swapped(raw, at, edit.draw % max(len(raw), 1), size)
        case "repeated":
            return raw[:at] + block * (1 + edit.draw % MOST_REPEATS) + raw[at + size :]
        case "cut":
            return raw[:at] + raw[at + size :]
        case "put":
            piece = NASTY[edit.draw % len(NASTY)]
            return raw[:at] + piece + raw[at + len(piece) :]
        case _:
            return _with_wild_length(kind, raw, edit)


def _swapped(raw: bytes, one: int, other: int, size: int) -> bytes:
    first, second = min(one, other), max(one, other)
    size = min(size, second - first, len(raw) - second)
    if size <= 0:
        return raw
    middle = raw[first + size : second]
    return (
        raw[:first]
        + raw[second : second + size]
        + middle
        + raw[first : first + size]
        + raw[second + size :]
    )


def _with_wild_length(kind: str, raw: bytes, edit: Edit) -> bytes:
    """One of the lengths that lie in the file is another; in text a cell becomes a long one."""
    if kind == "csv":
        at = max(raw.rfind(b",", 0, int(edit.at * len(raw))), 0)
        return raw[:at] + b"9" * (edit.draw % 10_000) + raw[at:]
    places = list(PLACES[kind](raw))
    if not places:
        return raw
    at, width = places[int(edit.at * len(places))]
    value = LENGTHS[edit.draw % len(LENGTHS)] % (1 << 8 * width)
    return raw[:at] + value.to_bytes(width, "little") + raw[at + width :]


def _ulog_lengths(raw: bytes) -> Iterator[tuple[int, int]]:
    """Two bytes before each message (ULog: header of 16 bytes, then size, kind, body)."""
    at = 16
    while at + 3 <= len(raw):
        yield at, 2
        at += 3 + int.from_bytes(raw[at : at + 2], "little")


def _mcap_lengths(raw: bytes) -> Iterator[tuple[int, int]]:
    """Eight bytes of each record, and four of the first text or map in it."""
    at = 8
    while at + 9 <= len(raw):
        yield at + 1, 8
        yield at + 9, 4
        at += 9 + int.from_bytes(raw[at + 1 : at + 9], "little")


def _dataflash_lengths(raw: bytes) -> Iterator[tuple[int, int]]:
    """A byte in each format message (type 128)."""
    at = raw.find(b"\xa3\x95\x80")
    while at >= 0:
        yield at + 4, 1
        at = raw.find(b"\xa3\x95\x80", at + 1)


def _tlog_lengths(raw: bytes) -> Iterator[tuple[int, int]]:
    """A byte after each frame's magic."""
    at = raw.find(b"\xfd")
    while at >= 0:
        yield at + 1, 1
        at = raw.find(b"\xfd", at + 1)


PLACES: dict[str, Callable[[bytes], Iterator[tuple[int, int]]]] = {
    "ulog": _ulog_lengths,
    "mcap": _mcap_lengths,
    "dataflash": _dataflash_lengths,
    "tlog": _tlog_lengths,
}
"""Where lengths lie, and in how many bytes; by format."""
