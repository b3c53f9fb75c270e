"""The latest picture for many clients, as server-sent events (WHATWG HTML, 9.2).

A new client gets the whole picture, then patches relative to the picture that it received last. A
client that does not read accumulates no queue: it costs its socket's buffer, one task and one old
picture.
"""

import asyncio
from collections.abc import AsyncIterator
from functools import cached_property
from typing import Any

import msgspec

from ground_station.adapters.web.merge_patch import merge_patch

MAX_CLIENTS = 32
"""Maximum concurrent browser windows: a desk has a handful."""

RECONNECT_DELAY_MS = 1000
"""Reconnect interval of a page that lost its server."""


class Frame:
    """An immutable picture with its patch from the previous frame."""

    def __init__(self, number: int, t_us: int, picture: dict[str, Any], patch: dict[str, Any]):
        """`patch`: difference from the previous frame."""
        self.number, self.t_us, self.picture = number, t_us, picture
        self._patch = patch

    @cached_property
    def full_event(self) -> bytes:
        """The event for a new client; encoded once, on first use."""
        return self._encode_event("picture", self.picture)

    @cached_property
    def _patch_event(self) -> bytes:
        return self._encode_event("patch", self._patch)

    def patch_event_since(self, last_sent_frame: "Frame") -> bytes:
        """Return the event for a client at `last_sent_frame`; encoded once for the previous."""
        if last_sent_frame.number == self.number - 1:
            return self._patch_event
        return self._encode_event("patch", merge_patch(last_sent_frame.picture, self.picture))

    def _encode_event(self, kind: str, content: dict[str, Any]) -> bytes:
        data = msgspec.json.encode({"t_us": self.t_us, "content": content})
        return b"event: %b\nid: %d\ndata: %b\n\n" % (kind.encode(), self.number, data)


class LiveStream:
    """`publish` may be called from any thread; `stream_client_events` runs in the server's loop."""

    def __init__(self) -> None:
        self.clients = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._frame: Frame | None = None
        self._frame_event = asyncio.Event()
        self._closed = False

    @property
    def latest_frame(self) -> Frame | None:
        """The latest frame, None before the first."""
        return self._frame

    def set_event_loop(self, loop: asyncio.AbstractEventLoop) -> None:
        """Set the event loop that serves the clients."""
        self._loop = loop

    def publish(self, picture: dict[str, Any], t_us: int) -> None:
        """Publish this picture to all clients."""
        before = self._frame
        patch = {} if before is None else merge_patch(before.picture, picture)
        number = 1 if before is None else before.number + 1
        self._frame = Frame(number, t_us, picture, patch)
        self._schedule_client_notification()

    def close(self) -> None:
        """End every client's stream."""
        self._closed = True
        self._schedule_client_notification()

    def _schedule_client_notification(self) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._notify_clients)

    def _notify_clients(self) -> None:
        self._frame_event.set()
        self._frame_event = asyncio.Event()

    async def stream_client_events(self) -> AsyncIterator[bytes]:
        """Yield the events of one client, as fast as it reads."""
        self.clients += 1
        try:
            yield b"retry: %d\n\n" % RECONNECT_DELAY_MS
            seen: Frame | None = None
            while not self._closed:
                frame_event, frame = self._frame_event, self._frame
                if frame is None or frame is seen:
                    await frame_event.wait()
                    continue
                yield frame.full_event if seen is None else frame.patch_event_since(seen)
                seen = frame
        finally:
            self.clients -= 1
