"""Trial of `companion replay` with damaged logs: each is partly replayed or refused in one line.

A child process, replaced periodically, reads the logs within limits of memory and CPU time. A
reader that exceeds them is detected and affects no other case.
"""

import contextlib
import io
import os
import resource
import signal
import tempfile
import traceback
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec
import numpy as np

from companion.adapters.logs.decision_log import DecisionLog, TelemetryRows
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.app.cli.replay_log import ReplayRequest, replay_log_and_write_outputs
from companion.core.base.errors import LeewayError
from companion.core.pilot.telemetry_state import TelemetryState
from sim_bridge.app.trials.damage import Edit, apply_edits, draw_random_edits
from sim_bridge.app.trials.log_writers import (
    battery_csv_columns,
    telemetry_csv_columns,
    write_csv,
    write_dataflash,
    write_tlog,
    write_ulog,
)
from sim_bridge.app.trials.synthetic_flight import build_square_flight
from sim_bridge.app.trials.trial import TrialRow

SUFFIXES = {"csv": "csv", "ulog": "ulg", "dataflash": "bin", "tlog": "tlog", "mcap": "mcap"}
SAMPLE_S = 20.0
"""Includes ground and flight; about 100 kB in each format."""

MAX_EXTRA_MEMORY_MB = 512
"""Memory limit above the child's initial size; a complete 50 MB log needs less."""

CPU_LIMIT_S = 20
"""CPU time limit of one log; an undamaged sample takes 0.1 s."""

RESPONSE_LIMIT_S = 300.0
"""Wall-clock limit for a child's result, also on a busy machine."""

LOGS_PER_PROCESS = 100
"""Number of logs that one child reads."""

REPLAY_INTERVAL_S = 30.0
MAX_OUTPUT_BYTES = 4096


class LogCase(msgspec.Struct, frozen=True, kw_only=True):
    """One damaged log: format of the sample and the edits in order."""

    kind: str
    seed: int
    edits: tuple[Edit, ...]

    @property
    def name(self) -> str:
        """Name of the case and its file."""
        return f"logs-{self.kind}-seed{self.seed}"


def draw_case(seed: int, case_number: int) -> LogCase:
    """Draw case `case_number` of the trial with this seed; the formats alternate."""
    rng = np.random.default_rng([seed, case_number])
    kind = tuple(SUFFIXES)[case_number % len(SUFFIXES)]
    return LogCase(kind=kind, seed=100_000 * seed + case_number, edits=draw_random_edits(rng))


def write_undamaged_sample_logs(folder: Path) -> dict[str, Path]:
    """Write an undamaged log of each format from one synthetic flight; reproducible bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = {kind: folder / f"sample.{suffix}" for kind, suffix in SUFFIXES.items()}
    whole = build_square_flight()
    short = whole.select_rows(whole.t_s < SAMPLE_S)
    write_csv(paths["csv"], telemetry_csv_columns(short) | battery_csv_columns(short))
    write_ulog(paths["ulog"], short, with_wind_estimate=True)
    write_dataflash(paths["dataflash"], short)
    write_tlog(paths["tlog"], short)
    _write_companion_log_from_tlog(paths["mcap"], paths["tlog"])
    return paths


def _write_companion_log_from_tlog(path: Path, tlog_path: Path) -> None:
    """Write the log that a companion would record for the same flight."""
    log, rows, now = DecisionLog(path), TelemetryRows(), TelemetryState()
    for event in read_log_of_any_format(tlog_path).events:
        now.store_event(event)
        for topic, row in rows.take_new_rows(now):
            log.write(topic, row)
    log.close()


class _TooLongError(BaseException):
    """CPU time exceeded; a BaseException, so that no `except Exception` of a reader catches it."""


def replay_and_find_violation(log_path: Path) -> str:
    """Return the violation, empty if the log was replayed or refused in one line."""
    request = ReplayRequest(
        log_path, None, None, 0.0, None, None, REPLAY_INTERVAL_S, None, None, None
    )
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            replay_log_and_write_outputs(request, None, None, None)
    except LeewayError as error:
        return _refusal_message_violation(str(error), log_path)
    except _TooLongError:
        return f"more than {CPU_LIMIT_S} s of CPU"
    except Exception as error:  # noqa: BLE001 - the trial looks for any exception
        frame = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(frame.filename).name}:{frame.lineno}"
        return f"{type(error).__name__} at {where}: {str(error)[:120]}"
    return ""


def _refusal_message_violation(text: str, path: Path) -> str:
    if len(text.splitlines()) != 1:
        return f"{len(text.splitlines())} lines: {text[:120]!r}"
    return "" if str(path) in text else f"no file name in the message: {text[:120]}"


@dataclass(frozen=True, slots=True)
class ReadingResult:
    """Result of a child for one log."""

    violation: str
    cpu_s: float
    memory_increase_mb: float
    """Increase of the child's peak memory since before its first log."""


def _replay_and_check_output(log_path: Path) -> str:
    """Return the violation by this log; output of C libraries is one, too."""
    before = [os.dup(number) for number in (1, 2)]
    with tempfile.TemporaryFile() as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
        try:
            violation = replay_and_find_violation(log_path)
        finally:
            for number, saved_fd in zip((1, 2), before, strict=True):
                os.dup2(saved_fd, number)
                os.close(saved_fd)
        file.seek(0)
        printed = file.read(MAX_OUTPUT_BYTES).decode(errors="replace").splitlines()
    return violation or (f"library output: {printed[0][:120]}" if printed else "")


def _read_logs_until_pipe_closed(pipe: Connection) -> None:
    """Run in the child: read logs within the limits until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # only the parent handles Ctrl-C
    signal.signal(signal.SIGVTALRM, _raise_too_long)
    before_mb = _peak_memory_mb()
    _limit_memory()
    with contextlib.suppress(EOFError):
        while True:
            path = pipe.recv()
            signal.setitimer(signal.ITIMER_VIRTUAL, CPU_LIMIT_S)
            begun_s = resource.getrusage(resource.RUSAGE_SELF).ru_utime
            violation = _replay_and_check_output(path)
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            cpu_s = resource.getrusage(resource.RUSAGE_SELF).ru_utime - begun_s
            pipe.send(ReadingResult(violation, cpu_s, _peak_memory_mb() - before_mb))


def _raise_too_long(number: int, frame: FrameType | None) -> None:
    raise _TooLongError


def _peak_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _limit_memory() -> None:
    """Limit the address space to its current size plus MEMORY_MB (Linux)."""
    with contextlib.suppress(OSError, ValueError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        max_bytes = pages * resource.getpagesize() + MAX_EXTRA_MEMORY_MB * 1024 * 1024
        resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))


class LogReaderProcess:
    """Process that reads logs; replaced after FRESH_AFTER logs or a missing result."""

    def __init__(self) -> None:
        self._process: BaseProcess | None = None
        self._pipe: Any = None
        self._read_count = 0

    def __enter__(self) -> "LogReaderProcess":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.kill_process()

    def start_reading(self, path: Path) -> None:
        """Start reading a log; call `wait_for_result` before the next one."""
        if self._process is None or self._read_count >= LOGS_PER_PROCESS:
            self._restart_process()
        self._read_count += 1
        self._pipe.send(path)

    def wait_for_result(self) -> ReadingResult:
        """Wait for the result of the log."""
        assert self._process is not None
        try:
            if self._pipe.poll(RESPONSE_LIMIT_S):
                return self._pipe.recv()
            violation = f"no result within {RESPONSE_LIMIT_S:g} s"
        except (EOFError, ConnectionError):
            self._process.join(RESPONSE_LIMIT_S)
            violation = f"the reader process exited with {self._process.exitcode}"
        self.kill_process()
        return ReadingResult(violation, 0.0, 0.0)

    def _restart_process(self) -> None:
        self.kill_process()
        context = get_context("spawn")
        self._pipe, child_pipe = context.Pipe()
        self._process = context.Process(
            target=_read_logs_until_pipe_closed, args=(child_pipe,), daemon=True
        )
        self._process.start()
        child_pipe.close()
        self._read_count = 0

    def kill_process(self) -> None:
        """Kill the process and close the pipe."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None


def read_damaged_logs_in_parallel(
    cases: Iterable[LogCase], folder: Path, process_count: int = 1
) -> Iterator[TrialRow]:
    """Damage, read and evaluate the cases, in parallel; yield rows in order.

    The damaged file of a failed case stays in `folder`, under the name of the case.
    """
    samples = {
        kind: path.read_bytes() for kind, path in write_undamaged_sample_logs(folder).items()
    }
    with contextlib.ExitStack() as stack:
        idle = [stack.enter_context(LogReaderProcess()) for _ in range(process_count)]
        pending: deque[tuple[LogReaderProcess, LogCase, Path]] = deque()
        for case in cases:
            if not idle:
                done = pending.popleft()
                yield _wait_for_row_and_delete_passed_file(*done)
                idle.append(done[0])
            path = folder / f"{case.name}.{SUFFIXES[case.kind]}"
            path.write_bytes(apply_edits(case.kind, samples[case.kind], case.edits))
            child = idle.pop()
            child.start_reading(path)
            pending.append((child, case, path))
        for waited_for in pending:
            yield _wait_for_row_and_delete_passed_file(*waited_for)


def _wait_for_row_and_delete_passed_file(
    reader_process: LogReaderProcess, case: LogCase, path: Path
) -> TrialRow:
    result = reader_process.wait_for_result()
    if not result.violation:
        path.unlink()
    metrics = {"cpu_s": round(result.cpu_s, 2), "grown_mb": round(result.memory_increase_mb, 1)}
    return TrialRow.for_case(case, result.violation, metrics)
