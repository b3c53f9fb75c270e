"""Debian's Chromium by Playwright, drawn in software."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from companion.core.base.errors import LeewayError

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-background-networking"]


def chromium() -> str | None:
    """The browser's program; None: there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


@contextmanager
def browser() -> "Iterator[Browser]":
    """A headless browser. LeewayError where it or its driver is not installed."""
    program = chromium()
    if program is None:
        raise LeewayError(f"expected one of {', '.join(NAMES)} (apt-get install chromium)")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise LeewayError(f"needs playwright (pip install playwright): {error}") from error
    with sync_playwright() as driver:
        made = driver.chromium.launch(executable_path=program, args=OPTIONS)
        try:
            yield made
        finally:
            made.close()


@contextmanager
def page(address: str, **context: Any) -> "Iterator[Page]":
    """A window that shows this map, as soon as the map is live."""
    with browser() as made:
        window = made.new_context(**context).new_page()
        window.goto(address)
        window.wait_for_selector("#link.live")
        yield window
