"""Child processes that end with their parent, however it ends."""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that a process gets when the thread that started it is gone."""


def entry(main: str) -> str:
    """Python code for `-c`: ties itself to the process that starts it, then runs `main`."""
    return f"from sim_bridge.adapters.lifeline import hold; hold({os.getpid()}); {main}"


def hold(parent: int) -> None:
    """End with `parent`, even if it is killed and cannot clean up (Linux only)."""
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it had ended before prctl took effect
        os._exit(1)
