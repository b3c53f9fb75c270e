"""A service of `Type=notify`: notifications to systemd, and stop signals for its loop to check."""

import contextlib
import os
import signal
import socket
from collections.abc import Iterator
from typing import Any

from companion.adapters.clock import is_due

SOCKET = "NOTIFY_SOCKET"


def notify_systemd(state: str) -> None:
    """Send `READY=1`, `WATCHDOG=1` or `STATUS=...`; no effect without systemd."""
    path = os.environ.get(SOCKET)
    if not path:
        return
    address = "\0" + path[1:] if path.startswith("@") else path
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.setblocking(False)
        line.sendto(state.encode(), address)


class Watchdog:
    """A loop calls `notify_systemd_if_due` in each cycle; systemd restarts it if it hangs."""

    def __init__(self, interval_s: float = 5.0) -> None:
        self._interval_s = interval_s
        self._last_notification_s: float | None = None

    def notify_systemd_if_due(self, now_s: float) -> None:
        """Send READY at the first call, then WATCHDOG at the interval."""
        if not is_due(self._last_notification_s, self._interval_s, now_s):
            return
        notify_systemd(
            "WATCHDOG=1" if self._last_notification_s is not None else "READY=1\nWATCHDOG=1"
        )
        self._last_notification_s = now_s


@contextlib.contextmanager
def record_stop_signals() -> Iterator[list[int]]:
    """Record SIGINT and SIGTERM inside the block, so that each cycle completes."""
    received: list[int] = []

    def record_signal(number: int, frame: Any) -> None:
        received.append(number)

    previous_handlers = {
        s: signal.signal(s, record_signal) for s in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield received
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
