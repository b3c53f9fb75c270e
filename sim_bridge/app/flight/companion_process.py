"""The `companion run` process of a simulated vehicle: start, kill, restart, end."""

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

import psutil

from sim_bridge.adapters.fork_server import ForkedProcess, ForkServer
from sim_bridge.adapters.lifeline import code_tied_to_parent_process

COMPANION_CODE = "from companion.app.cli.main import main; main()"
TERMINATION_LIMIT_S = 10.0
SINGLE_THREAD_ENV = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@functools.cache
def suite_fork_server() -> ForkServer:
    """Return the fork server of this process, which imports the companion only once."""
    fork_server = ForkServer(
        ("companion.app.cli.main", "companion.app.cli.flying"), COMPANION_CODE, SINGLE_THREAD_ENV
    )
    atexit.register(fork_server.close)
    return fork_server


def spawn_python(code: str, arguments: list[str], output: IO[bytes]) -> subprocess.Popen[bytes]:
    """Run Python code with arguments in a process that ends with this process."""
    return subprocess.Popen(
        [sys.executable, "-c", code_tied_to_parent_process(code), *arguments],
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        env=os.environ | SINGLE_THREAD_ENV,
        start_new_session=True,  # only the bridge receives Ctrl-C; it then ends the child
    )


@dataclass(slots=True)
class CompanionProcess:
    """One companion process; the MAVLink link in `arguments` is its only source of vehicle data."""

    run_dir: Path
    arguments: list[str]
    startup_code: str = ""
    """Python code that runs before the imports and `main` of the process."""
    fork_server: ForkServer | None = None
    """Server that forks the process; unused if `startup_code` is set (runs before imports)."""
    start_count: int = 0
    stalled: bool = False
    was_killed: bool = False
    """True from SIGKILL to the next start."""
    _process: subprocess.Popen[bytes] | ForkedProcess | None = None
    _output: IO[bytes] | None = field(default=None, repr=False)
    _consumed_bytes: int = 0
    """Bytes of the output that `read_new_output_lines` has returned."""

    def start(self) -> None:
        """Start the process; append its standard output and errors to `companion.out`."""
        with contextlib.suppress(FileExistsError):  # a file of this name: a fault's
            self.run_dir.mkdir(parents=True, exist_ok=True)
        self._close_output()
        path = self.run_dir / "companion.out" if self.run_dir.is_dir() else Path(os.devnull)
        self._output = path.open("ab")
        arguments = ["run", *self.arguments, "--run-dir", str(self.run_dir)]
        if self.fork_server is not None and not self.startup_code:
            self._process = self.fork_server.start(arguments, self._output)
        else:
            self._process = spawn_python(
                f"{self.startup_code}\n{COMPANION_CODE}", arguments, self._output
            )
        self.start_count += 1
        self.was_killed = False

    @property
    def pid(self) -> int | None:
        """Process id while the process runs."""
        return self._process.pid if self.is_running else None  # type: ignore[union-attr]

    @property
    def is_running(self) -> bool:
        """True while the process runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def is_stopped(self) -> bool:
        """True while the operating system holds the process stopped (SIGSTOP)."""
        pid = self.pid
        if pid is None:
            return False
        with contextlib.suppress(psutil.Error):
            return psutil.Process(pid).status() == psutil.STATUS_STOPPED
        return False

    @property
    def exit_code(self) -> int | None:
        """Exit code after the process has ended, else None."""
        return None if self._process is None else self._process.poll()

    def wait(self, limit_s: float) -> None:
        """Wait up to `limit_s` for the process to end."""
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(limit_s)

    def kill(self) -> None:
        """Send SIGKILL: simulates power loss of the companion computer."""
        self.was_killed = True
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def suspend(self) -> None:
        """Send SIGSTOP: simulates a computer that waits for its storage or swaps."""
        self._send_signal_if_running(signal.SIGSTOP)
        self.stalled = True

    def continue_after_suspend(self) -> None:
        """Resume with SIGCONT."""
        self._send_signal_if_running(signal.SIGCONT)
        self.stalled = False

    def simulate_full_disk(self) -> None:
        """Make each write that extends a file fail, as on a full disk."""
        self._limit_file_size(0)

    def end_simulated_full_disk(self) -> None:
        """Remove the file size limit."""
        self._limit_file_size(resource.RLIM_INFINITY)

    def _limit_file_size(self, size_bytes: int) -> None:
        if self.pid is not None:
            with contextlib.suppress(ProcessLookupError):  # the process ended meanwhile
                _, max_size_bytes = resource.prlimit(self.pid, resource.RLIMIT_FSIZE)
                resource.prlimit(self.pid, resource.RLIMIT_FSIZE, (size_bytes, max_size_bytes))

    def _send_signal_if_running(self, number: signal.Signals) -> None:
        if self._process is not None and self.is_running:
            self._process.send_signal(number)

    def terminate_or_kill(self) -> None:
        """Send SIGTERM, then SIGKILL after 10 s; the process never survives this call."""
        if self._process is not None and self.is_running:
            self._process.terminate()
            self.continue_after_suspend()
            try:
                self._process.wait(TERMINATION_LIMIT_S)
            except subprocess.TimeoutExpired:
                self.kill()
        self._close_output()

    def read_result_json_or_empty(self) -> dict[str, Any]:
        """Return the companion's `result.json`, `{}` if missing or invalid."""
        path = self.run_dir / "result.json"
        if not path.exists():
            return {}
        try:
            return json.loads(path.read_text())
        except json.JSONDecodeError:
            return {}

    @property
    def last_reported_phase(self) -> str:
        """Last phase reported in the output, empty before the first report."""
        changes = [line for line in self.read_output().splitlines() if " -> " in line]
        return changes[-1].rsplit(" -> ", 1)[1] if changes else ""

    def read_new_output_lines(self) -> list[str]:
        """Return the complete output lines since the previous call."""
        path = self.run_dir / "companion.out"
        if not path.exists():
            return []
        with path.open("rb") as file:
            file.seek(self._consumed_bytes)
            whole = file.read().rpartition(b"\n")
        self._consumed_bytes += len(whole[0]) + len(whole[1])
        return whole[0].decode(errors="replace").splitlines()

    def last_output_lines(self, line_count: int = 5) -> str:
        """Return the last lines of the output, for an error message."""
        return "\n".join(self.read_output().strip().splitlines()[-line_count:])

    def read_output(self) -> str:
        """Return all standard output and errors of the process."""
        path = self.run_dir / "companion.out"
        return path.read_text(errors="replace") if path.exists() else ""

    def _close_output(self) -> None:
        if self._output is not None:
            self._output.close()
            self._output = None
