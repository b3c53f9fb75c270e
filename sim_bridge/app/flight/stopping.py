"""SIGTERM ends the program in order: the stack unwinds, and started processes end with it."""

import signal
import threading
from types import FrameType

LEAVES_AT_ONCE = threading.Event()
"""Set by what opens zenoh sessions: their threads can keep an interpreter from ending."""


def stop_by_signal(number: int) -> None:
    """From now on this signal raises SystemExit(128 + number) once; later ones change nothing."""

    def stop(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_IGN)
        raise SystemExit(128 + number)

    signal.signal(number, stop)
