"""`ground-station` as a person starts it: a process, whose words are read as they come."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ground_station.adapters.clock import monotonic_s

PATIENCE_S = 30.0


class Program:
    """One process. `words`: all that it has written, both ways out."""

    def __init__(self, *arguments: str | Path) -> None:
        command = [sys.executable, "-m", "ground_station.app.cli.main", *map(str, arguments)]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
        )
        self.words = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                self.words += line

    def said(self, words: str) -> str:
        """The first line with these words, once it is there."""
        limit_s = monotonic_s() + PATIENCE_S
        while True:
            found = [x for x in self.words.decode(errors="replace").splitlines() if words in x]
            if found:
                return found[0]
            assert monotonic_s() < limit_s, f"expected {words!r} in: {self.words!r}"
            time.sleep(0.05)

    def end(self, with_signal: int = signal.SIGTERM) -> int:
        """Its exit code, once all that it wrote is read."""
        self.process.send_signal(with_signal)  # to one that has ended: nothing
        code = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        return code


@contextmanager
def program(*arguments: str | Path) -> Iterator[Program]:
    """One that is killed at the end, if it still runs."""
    started = Program(*arguments)
    try:
        yield started
    finally:
        started.process.kill()
        started.end()
