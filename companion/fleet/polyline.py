"""A route as a short text: Google's encoded polyline algorithm format, five decimals of a degree.

developers.google.com/maps/documentation/utilities/polylinealgorithm: differences of 1e-5 degrees
(1.1 m), zigzag, five bits per character.
"""

from collections.abc import Iterable, Iterator

from companion.core.base.errors import LeewayError

Point = tuple[float, float]
"""Latitude and longitude, degrees."""

PER_DEG = 1e5
CHAR_OFFSET, CONTINUATION_BIT, BITS = 63, 0x20, 5
MAX_BITS = 30
"""Maximum bits of one number: a difference of 360 degrees needs 26 bits and a sign."""


def encode_polyline(points: Iterable[Point]) -> str:
    """Encode a route; empty for no points."""
    found, previous = list[str](), (0, 0)
    for lat_deg, lon_deg in points:
        position = round(lat_deg * PER_DEG), round(lon_deg * PER_DEG)
        found += [_encode_number(now - then) for now, then in zip(position, previous, strict=True)]
        previous = position
    return "".join(found)


def decode_polyline(text: str) -> tuple[Point, ...]:
    """Decode a route. Raises LeewayError for invalid text, or coordinates out of range."""
    numbers = list(_iterate_decoded_numbers(text))
    if len(numbers) % 2:
        raise LeewayError("a polyline: a latitude without its longitude")
    found, position = list[Point](), (0, 0)
    for north, east in zip(numbers[::2], numbers[1::2], strict=True):
        position = position[0] + north, position[1] + east
        lat_deg, lon_deg = position[0] / PER_DEG, position[1] / PER_DEG
        if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
            raise LeewayError(f"a polyline: {lat_deg}, {lon_deg} is not a valid position")
        found.append((lat_deg, lon_deg))
    return tuple(found)


def _encode_number(value: int) -> str:
    remaining = ~(value << 1) if value < 0 else value << 1
    found = ""
    while remaining >= CONTINUATION_BIT:
        found += chr((CONTINUATION_BIT | (remaining & (CONTINUATION_BIT - 1))) + CHAR_OFFSET)
        remaining >>= BITS
    return found + chr(remaining + CHAR_OFFSET)


def _iterate_decoded_numbers(text: str) -> Iterator[int]:
    value, shift = 0, 0
    for symbol in text:
        part = ord(symbol) - CHAR_OFFSET
        if not 0 <= part < 2 * CONTINUATION_BIT or shift >= MAX_BITS:
            raise LeewayError(f"a polyline: invalid character {symbol!r}")
        value |= (part & (CONTINUATION_BIT - 1)) << shift
        shift += BITS
        if part < CONTINUATION_BIT:
            yield ~(value >> 1) if value & 1 else value >> 1
            value, shift = 0, 0
    if shift:
        raise LeewayError("a polyline: truncated")
