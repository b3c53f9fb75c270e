"""Children that do not outlive their parent, however that ends."""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that a process gets when the thread that started it is gone."""


def entry(main: str) -> str:
    """Python for `-c`: first tied to the process that starts it, then `main`."""
    return f"from sim_bridge.adapters.lifeline import hold; hold({os.getpid()}); {main}"


def hold(parent: int) -> None:
    """Die with `parent`, also where that is killed and can put nothing in order (Linux only)."""
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it was gone before we could say so
        os._exit(1)
