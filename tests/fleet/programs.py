"""`ground-station` as a process on a terminal, whose output is read continuously."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from companion.adapters.files.params import params_dir
from ground_station.adapters.clock import monotonic_s

PATIENCE_S = 120.0
"""A desk loads for 2 s on an idle machine."""


MAIN = "from ground_station.app.cli.main import main; main()"


class Program:
    """One process on a terminal of its own. `words`: its output so far. `before`: Python code that
    it runs first, to remove a guard.
    """

    def __init__(self, *arguments: str | Path, before: str = "") -> None:
        command = [sys.executable, "-c", f"{before}\n{MAIN}", *map(str, arguments)]
        self._terminal, inside = os.openpty()
        self.process = subprocess.Popen(
            command, stdout=inside, stderr=inside, stdin=subprocess.DEVNULL
        )
        os.close(inside)
        self.words = b""
        self._reader_by_file_content = threading.Thread(target=self._read, daemon=True)
        self._reader_by_file_content.start()

    def _read(self) -> None:
        try:
            while part := os.read(self._terminal, 65536):
                self.words += part
        except OSError:  # the other end is closed
            pass
        os.close(self._terminal)

    def said(self, words: str) -> str:
        """Wait for the first output line that contains this text, and return it."""
        limit_s = monotonic_s() + PATIENCE_S
        while True:
            found = [x for x in self.words.decode(errors="replace").splitlines() if words in x]
            if found:
                return found[0]
            assert monotonic_s() < limit_s, f"expected {words!r} in: {self.words!r}"
            time.sleep(0.05)

    def end(self, with_signal: int = signal.SIGTERM) -> int:
        """Signal the process; return its exit code after all output is read."""
        self.process.send_signal(with_signal)  # no effect if it has already exited
        code = self.process.wait(PATIENCE_S)
        self._reader_by_file_content.join(PATIENCE_S)
        return code


@contextmanager
def program(*arguments: str | Path, before: str = "") -> Iterator[Program]:
    """Run a process and kill it at the end if it still runs."""
    started = Program(*arguments, before=before)
    try:
        yield started
    finally:
        started.process.kill()
        started.end()


DAYS = params_dir() / "days"


def short_day(folder: Path) -> Path:
    """Write Harbour's day with one order only: a desk checks each order before it starts."""
    header, first, *_ = (DAYS / "harbour_orders.csv").read_text().splitlines()
    (folder / "harbour_orders.csv").write_text(f"{header}\n{first}\n")
    text = (DAYS / "harbour.toml").read_text()
    day = folder / "harbour.toml"
    day.write_text(text.replace("../sites", str(params_dir() / "sites")))
    return day
