"""One picture for many clients, as server-sent events (WHATWG HTML, 9.2).

A client that joins gets the whole, then what changed since the picture that it was sent last. So
nothing queues up for a client that does not read: it costs its socket's buffer, one task and one
old picture.
"""

import asyncio
from collections.abc import AsyncIterator
from functools import cached_property
from typing import Any

import msgspec

from ground_station.adapters.web.merge_patch import merge_patch

MOST_CLIENTS = 32
"""Browser windows at once: a desk has a handful."""

BACK_MS = 1000
"""After so long a page that lost its server tries again."""


class Frame:
    """A picture, and how to get there. None of it is changed afterwards."""

    def __init__(self, number: int, t_us: int, picture: dict[str, Any], patch: dict[str, Any]):
        """`patch`: from the frame before."""
        self.number, self.t_us, self.picture = number, t_us, picture
        self._patch = patch

    @cached_property
    def whole(self) -> bytes:
        """The event for who has nothing yet; made once, and only if somebody needs it."""
        return self._event("picture", self.picture)

    @cached_property
    def _step(self) -> bytes:
        return self._event("patch", self._patch)

    def since(self, seen: "Frame") -> bytes:
        """The event for who has `seen`; for all who have the one before it is made once."""
        if seen.number == self.number - 1:
            return self._step
        return self._event("patch", merge_patch(seen.picture, self.picture))

    def _event(self, kind: str, content: dict[str, Any]) -> bytes:
        data = msgspec.json.encode({"t_us": self.t_us, "content": content})
        return b"event: %b\nid: %d\ndata: %b\n\n" % (kind.encode(), self.number, data)


class LiveStream:
    """`publish` from any thread; `events` in the server's loop."""

    def __init__(self) -> None:
        self.clients = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._frame: Frame | None = None
        self._news = asyncio.Event()
        self._closed = False

    @property
    def frame(self) -> Frame | None:
        """The newest; None: there is none yet."""
        return self._frame

    def attach(self, loop: asyncio.AbstractEventLoop) -> None:
        """The loop that the clients are served in."""
        self._loop = loop

    def publish(self, picture: dict[str, Any], t_us: int) -> None:
        """Show this picture to everybody."""
        before = self._frame
        patch = {} if before is None else merge_patch(before.picture, picture)
        number = 1 if before is None else before.number + 1
        self._frame = Frame(number, t_us, picture, patch)
        self._tell()

    def close(self) -> None:
        """End every client's stream."""
        self._closed = True
        self._tell()

    def _tell(self) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    async def events(self) -> AsyncIterator[bytes]:
        """What one client is sent, as fast as it reads."""
        self.clients += 1
        try:
            yield b"retry: %d\n\n" % BACK_MS
            seen: Frame | None = None
            while not self._closed:
                news, frame = self._news, self._frame
                if frame is None or frame is seen:
                    await news.wait()
                    continue
                yield frame.whole if seen is None else frame.since(seen)
                seen = frame
        finally:
            self.clients -= 1
