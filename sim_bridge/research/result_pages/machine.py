"""Where and from what a result was made: commit, machine, date. Nothing names the host."""

import os
import platform
import subprocess
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from companion.adapters.clock import epoch_us

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = ("companion", "ground_station", "sim_bridge", "params", "pyproject.toml")
"""What decides a result: documents and tests may differ from the commit."""


@dataclass(frozen=True, slots=True)
class Commit:
    """The program's commit, and whether it has been changed since."""

    name: str
    is_changed: bool

    def __str__(self) -> str:
        return f"{self.name}, changed since" if self.is_changed else self.name


def commit() -> Commit:
    """The checkout's; "unknown" where the program does not lie in one."""
    name = _git("rev-parse", "--short", "HEAD")
    if name is None:
        return Commit("unknown", True)
    return Commit(name, bool(_git("status", "--porcelain", "--untracked-files=no", "--", *PROGRAM)))


def machine() -> str:
    """The processor, the cores that may be used, and the interpreter."""
    cores = len(os.sched_getaffinity(0))
    return f"{_processor()}, {cores} cores, Python {platform.python_version()}"


def today() -> str:
    """The date, UTC."""
    return datetime.fromtimestamp(epoch_us() / 1e6, UTC).date().isoformat()


def _git(*words: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False
        )
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names and names[0] else platform.machine()
