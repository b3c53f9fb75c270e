"""A `companion run` process beside a simulated vehicle: started, killed, restarted, ended."""

import atexit
import contextlib
import functools
import json
import os
import resource
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from sim_bridge.adapters.fork_server import ForkedProcess, ForkServer
from sim_bridge.adapters.lifeline import entry

ENTRY = "from companion.app.cli.main import main; main()"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@functools.cache
def suite_forks() -> ForkServer:
    """Of this process, for suites of short flights: their companions are imported once."""
    forks = ForkServer(("companion.app.cli.main", "companion.app.cli.flying"), ENTRY, ONE_THREAD)
    atexit.register(forks.close)
    return forks


@dataclass(slots=True)
class CompanionProcess:
    """One companion that knows its vehicle only by the MAVLink link in `arguments`."""

    run_dir: Path
    arguments: list[str]
    before: str = ""
    """Python that the process runs before its `main`, and before its imports."""
    forks: ForkServer | None = None
    """Where it is forked instead of started anew, unless something runs before its imports."""
    starts: int = 0
    stalled: bool = False
    _process: subprocess.Popen[bytes] | ForkedProcess | None = None
    _output: IO[bytes] | None = field(default=None, repr=False)
    _read_bytes: int = 0
    """Of what it printed, given out by `new_lines`."""

    def start(self) -> None:
        """Start it; its standard output and errors are appended to `companion.out`."""
        self.run_dir.mkdir(parents=True, exist_ok=True)
        self._close_output()
        self._output = (self.run_dir / "companion.out").open("ab")
        arguments = ["run", *self.arguments, "--run-dir", str(self.run_dir)]
        if self.forks is not None and not self.before:
            self._process = self.forks.start(arguments, self._output)
        else:
            self._process = self._start_anew(arguments, self._output)
        self.starts += 1

    def _start_anew(self, arguments: list[str], output: IO[bytes]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-c", entry(f"{self.before}\n{ENTRY}"), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=os.environ | ONE_THREAD,
            start_new_session=True,  # Ctrl-C reaches the bridge alone, which ends it in order
        )

    @property
    def pid(self) -> int | None:
        """Process id while it runs."""
        return self._process.pid if self.running else None  # type: ignore[union-attr]

    @property
    def running(self) -> bool:
        """True while the process lives."""
        return self._process is not None and self._process.poll() is None

    @property
    def exit_code(self) -> int | None:
        """Its exit code once it has ended."""
        return None if self._process is None else self._process.poll()

    def wait(self, limit_s: float) -> None:
        """Wait for its end, no longer than `limit_s`."""
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(limit_s)

    def kill(self) -> None:
        """SIGKILL, as a companion computer that loses its power."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def stall(self) -> None:
        """SIGSTOP, as a computer that waits for its card or swaps."""
        self._signal(signal.SIGSTOP)
        self.stalled = True

    def go_on(self) -> None:
        """SIGCONT."""
        self._signal(signal.SIGCONT)
        self.stalled = False

    def fill_disk(self) -> None:
        """From now on no file of its can grow: each write fails, as on a full disk."""
        self._limit_files(0)

    def empty_disk(self) -> None:
        """Its files can grow again."""
        self._limit_files(resource.RLIM_INFINITY)

    def _limit_files(self, size_bytes: int) -> None:
        if self.pid is not None:
            with contextlib.suppress(ProcessLookupError):  # it ends just now
                _, most = resource.prlimit(self.pid, resource.RLIMIT_FSIZE)
                resource.prlimit(self.pid, resource.RLIMIT_FSIZE, (size_bytes, most))

    def _signal(self, number: signal.Signals) -> None:
        if self._process is not None and self.running:
            self._process.send_signal(number)

    def end(self, grace_s: float = 10.0) -> None:
        """SIGTERM, then SIGKILL after `grace_s`; always leaves no process behind."""
        if self._process is not None and self.running:
            self._process.terminate()
            self.go_on()
            try:
                self._process.wait(grace_s)
            except subprocess.TimeoutExpired:
                self.kill()
        self._close_output()

    def result(self) -> dict[str, Any]:
        """The companion's own record, `{}` where it left none."""
        path = self.run_dir / "result.json"
        if not path.exists():
            return {}
        try:
            return json.loads(path.read_text())
        except json.JSONDecodeError:
            return {}

    @property
    def phase(self) -> str:
        """The phase that it last said it is in, empty before the first."""
        path = self.run_dir / "companion.out"
        text = path.read_text(errors="replace") if path.exists() else ""
        changes = [line for line in text.splitlines() if " -> " in line]
        return changes[-1].rsplit(" -> ", 1)[1] if changes else ""

    def new_lines(self) -> list[str]:
        """Whole lines that it printed since this was asked last."""
        path = self.run_dir / "companion.out"
        if not path.exists():
            return []
        with path.open("rb") as file:
            file.seek(self._read_bytes)
            whole = file.read().rpartition(b"\n")
        self._read_bytes += len(whole[0]) + len(whole[1])
        return whole[0].decode(errors="replace").splitlines()

    def last_words(self, lines: int = 5) -> str:
        """The end of what it printed, for an error message."""
        path = self.run_dir / "companion.out"
        text = path.read_text(errors="replace").strip() if path.exists() else ""
        return "\n".join(text.splitlines()[-lines:])

    def _close_output(self) -> None:
        if self._output is not None:
            self._output.close()
            self._output = None
