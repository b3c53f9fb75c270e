"""What systemd is told by a service of `Type=notify`: that it is ready, and that it still turns."""

import contextlib
import os
import socket

SOCKET = "NOTIFY_SOCKET"


def tell_systemd(state: str) -> None:
    """Send `READY=1`, `WATCHDOG=1` or `STATUS=...`; without systemd nothing happens."""
    path = os.environ.get(SOCKET)
    if not path:
        return
    address = "\0" + path[1:] if path.startswith("@") else path
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.setblocking(False)
        line.sendto(state.encode(), address)


class Watchdog:
    """`turn` is called by a loop in each of its turns: a loop that hangs is started again."""

    def __init__(self, every_s: float = 5.0) -> None:
        self._every_s = every_s
        self._told_s: float | None = None

    def turn(self, now_s: float) -> None:
        """Say that we turn, a few times in each watchdog's time; the first time: that we are up."""
        if self._told_s is not None and now_s - self._told_s < self._every_s:
            return
        tell_systemd("WATCHDOG=1" if self._told_s is not None else "READY=1\nWATCHDOG=1")
        self._told_s = now_s
