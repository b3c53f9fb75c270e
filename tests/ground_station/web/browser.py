"""Debian's Chromium with Playwright and local network only; tests skip without it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.ground_station.web.chromium import NAMES, OPTIONS, chromium

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PATIENCE_MS = 30_000.0
POLL_MS = 50.0
SIDE = 4096
"""Extent of a tile."""

TOWN = "Made-up Town"
GONE = ("ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_INCOMPLETE_CHUNKED_ENCODING")


def needs_chromium() -> str:
    """Return the browser's program; skip the test if it or its driver is not installed."""
    pytest.importorskip("playwright.sync_api", reason="playwright: the page was not looked at")
    found = chromium()
    if found is None:
        pytest.skip(f"none of {', '.join(NAMES)} is installed: the page was not looked at")
    return found


@contextmanager
def running(program: str, *options: str) -> "Iterator[Browser]":
    """A browser for many windows: to start one costs more than a test of a page."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=[*OPTIONS, *options])
        yield browser
        browser.close()


@contextmanager
def browsing(browser: "str | Browser", **context: Any) -> "Iterator[Page]":
    """Open a window that fails its test on an error or a request to another machine.

    `browser`: a running one, or a program to start for this window.
    """
    wrong: list[str] = []
    own = running(browser) if isinstance(browser, str) else nullcontext(browser)
    with own as made, made.new_context(**context) as window:
        page = window.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda said: _note(wrong, said))
        page.on("request", lambda asked: _note_address(wrong, asked.url))
        yield page
    assert wrong == []


def wait_until(page: "Page", words: str) -> None:
    """Wait for a condition on the page; its policy forbids Playwright's own method (`eval`)."""
    for _ in range(round(PATIENCE_MS / POLL_MS)):
        if page.evaluate(words):
            return
        page.wait_for_timeout(POLL_MS)
    raise AssertionError(f"after {PATIENCE_MS / 1000.0:.0f} s still not: {words}")


def _note(wrong: list[str], said: Any) -> None:
    """Record errors and content security policy violations, except a missing server."""
    if said.type == "error" and not any(gone in said.text for gone in GONE):
        wrong.append(said.text)


OURS = ("http://127.0.0.1:", "https://localhost:")


def _note_address(wrong: list[str], address: str) -> None:
    if not address.startswith((*OURS, "data:", *(f"blob:{one}" for one in OURS))):
        wrong.append(f"asked for {address}")


PROTOMAPS, OPENMAPTILES = ("places", "name"), ("place", "name:latin")
"""The layer of places and the key of their names, in two schemas of vector tiles."""


def town_tiles(path: Path, places: tuple[str, str] = PROTOMAPS) -> None:
    """A PMTiles file (specification v3) with one vector tile (2.1) at zoom 0: water everywhere,
    and `TOWN` at 90 degrees west on the equator.
    """
    layer, key = places
    tile = _layer("water", _polygon()) + _layer(layer, _town(), key, [TOWN])
    directory = bytes([1, 0, 1]) + _varint(len(tile)) + bytes([1])
    metadata = b'{"attribution": "<b>made</b> by hand", "vector_layers": []}'
    begin = 127
    parts = [(begin, len(directory))]
    parts += [(begin + len(directory), len(metadata))]
    after = begin + len(directory) + len(metadata)
    parts += [(after, 0), (after, len(tile))]
    header = b"PMTiles\x03" + b"".join(
        at.to_bytes(8, "little") + size.to_bytes(8, "little") for at, size in parts
    )
    header += b"".join((1).to_bytes(8, "little") for _ in range(3))  # tiles, entries, contents
    header += bytes([1, 1, 1, 1, 0, 0])  # clustered, nothing compressed, MVT, zoom 0 to 0
    corners = (-1_800_000_000, -850_000_000, 1_800_000_000, 850_000_000)
    header += b"".join(v.to_bytes(4, "little", signed=True) for v in corners)
    header += bytes([0]) + bytes(8)
    path.write_bytes(header + directory + metadata + tile)


def _polygon() -> bytes:
    """A feature of one square over the whole tile."""
    zigzag = [SIDE * 2, 0, 0, SIDE * 2, SIDE * 2 - 1, 0]
    geometry = b"".join(map(_varint, [9, 0, 0, 26, *zigzag, 15]))
    return bytes([0x18, 3, 0x22]) + _varint(len(geometry)) + geometry


def _town() -> bytes:
    """A point with the first key and value of its layer as its tag."""
    geometry = b"".join(map(_varint, [9, SIDE // 4 * 2, SIDE // 2 * 2]))
    return bytes([0x12, 2, 0, 0, 0x18, 1, 0x22]) + _varint(len(geometry)) + geometry


def _layer(name: str, feature: bytes, key: str = "name", values: Sequence[str] = ()) -> bytes:
    """One layer of one feature; `values`: those of the key."""
    content = bytes([0x78, 2, 0x0A, len(name)]) + name.encode()
    content += bytes([0x12]) + _varint(len(feature)) + feature
    for value in values:
        text = bytes([0x0A, len(value)]) + value.encode()
        content += bytes([0x1A, len(key)]) + key.encode() + bytes([0x22, len(text)]) + text
    content += bytes([0x28]) + _varint(SIDE)
    return bytes([0x1A]) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    found = b""
    while value > 0x7F:
        found += bytes([value & 0x7F | 0x80])
        value >>= 7
    return found + bytes([value])
