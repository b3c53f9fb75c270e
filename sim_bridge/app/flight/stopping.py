"""Orderly exit on SIGTERM: the stack unwinds and child processes are ended."""

import signal
import threading
from types import FrameType

FORCE_EXIT = threading.Event()
"""Set by code that opens zenoh sessions: their threads can prevent interpreter exit."""


def exit_on_signal(signal_number: int) -> None:
    """Make this signal raise SystemExit(128 + number) once and ignore later ones."""

    def ignore_further_and_exit(received_signal: int, frame: FrameType | None) -> None:
        signal.signal(received_signal, signal.SIG_IGN)
        raise SystemExit(128 + received_signal)

    signal.signal(signal_number, ignore_further_and_exit)
