"""Child processes that end with their parent, however it ends."""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that a process gets when the thread that started it is gone."""


def code_tied_to_parent_process(main_code: str) -> str:
    """Python code for `-c`: ties itself to the process that starts it, then runs `main_code`."""
    tie = "from sim_bridge.adapters.lifeline import end_with_parent; end_with_parent"
    return f"{tie}({os.getpid()}); {main_code}"


def end_with_parent(parent_pid: int) -> None:
    """End with `parent_pid`, even if it is killed and cannot clean up (Linux only)."""
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent_pid:  # it had ended before prctl took effect
        os._exit(1)
