"""A way as a short text: Google's encoded polyline algorithm format, five decimals of a degree.

developers.google.com/maps/documentation/utilities/polylinealgorithm: differences of 1e-5 degrees
(1.1 m), zigzag, five bits a character.
"""

from collections.abc import Iterable, Iterator

from companion.core.base.errors import LeewayError

Point = tuple[float, float]
"""Latitude and longitude, degrees."""

PER_DEG = 1e5
FIRST, MORE, BITS = 63, 0x20, 5
MOST_BITS = 30
"""Of one number: 180 degrees there and back take 26 and a sign."""


def encoded(points: Iterable[Point]) -> str:
    """The text of a way; empty for none."""
    found, before = list[str](), (0, 0)
    for lat_deg, lon_deg in points:
        here = round(lat_deg * PER_DEG), round(lon_deg * PER_DEG)
        found += [_number(now - then) for now, then in zip(here, before, strict=True)]
        before = here
    return "".join(found)


def decoded(text: str) -> tuple[Point, ...]:
    """The way of a text. Raises LeewayError for one that is none, or leaves the earth."""
    numbers = list(_numbers(text))
    if len(numbers) % 2:
        raise LeewayError("a polyline: a latitude without its longitude")
    found, here = list[Point](), (0, 0)
    for north, east in zip(numbers[::2], numbers[1::2], strict=True):
        here = here[0] + north, here[1] + east
        lat_deg, lon_deg = here[0] / PER_DEG, here[1] / PER_DEG
        if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
            raise LeewayError(f"a polyline: {lat_deg}, {lon_deg} is no place")
        found.append((lat_deg, lon_deg))
    return tuple(found)


def _number(value: int) -> str:
    left = ~(value << 1) if value < 0 else value << 1
    found = ""
    while left >= MORE:
        found += chr((MORE | (left & (MORE - 1))) + FIRST)
        left >>= BITS
    return found + chr(left + FIRST)


def _numbers(text: str) -> Iterator[int]:
    value, shift = 0, 0
    for letter in text:
        part = ord(letter) - FIRST
        if not 0 <= part < 2 * MORE or shift >= MOST_BITS:
            raise LeewayError(f"a polyline: {letter!r} does not belong there")
        value |= (part & (MORE - 1)) << shift
        shift += BITS
        if part < MORE:
            yield ~(value >> 1) if value & 1 else value >> 1
            value, shift = 0, 0
    if shift:
        raise LeewayError("a polyline: cut off")
