"""Damaged logs to `companion replay`: each is replayed as far as it goes, or refused in one line.

A child process reads them, a fresh one every so often, within bounds of memory and of CPU time, so
that a reader that asks for everything or never ends is found and stops nothing else.
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

from companion.adapters.logs.decision_log import DecisionLog, HeardRows
from companion.adapters.logs.open_log import open_log
from companion.app.cli.replay_log import ReplayRequest, replay_log
from companion.core.base.errors import LeewayError
from companion.core.pilot.telemetry_state import TelemetryState
from sim_bridge.app.trials.damage import Edit, damaged, drawn_edits
from sim_bridge.app.trials.log_writers import (
    battery_columns,
    csv_columns,
    write_csv,
    write_dataflash,
    write_tlog,
    write_ulog,
)
from sim_bridge.app.trials.made_flight import square_flight
from sim_bridge.app.trials.trial import TrialRow

SUFFIX = {"csv": "csv", "ulog": "ulg", "dataflash": "bin", "tlog": "tlog", "mcap": "mcap"}
SAMPLE_S = 20.0
"""On the ground and in the air, some hundred kilobytes in each format."""

MEMORY_MB = 512
"""More than the child had before it read: a whole flight's log of 50 MB takes less."""

CPU_S = 20
"""Of one log; a sound sample takes 0.1 s."""

PATIENCE_S = 300.0
"""Of a machine on which others work too, before a child that says nothing is given up."""

FRESH_AFTER = 100
"""Logs by one child."""

EVERY_S = 30.0
PRINTED_BYTES = 4096


class LogCase(msgspec.Struct, frozen=True, kw_only=True):
    """One damaged log: the sample's format, and what is done to it in order."""

    kind: str
    seed: int
    edits: tuple[Edit, ...]

    @property
    def name(self) -> str:
        """Names the case and its file."""
        return f"logs-{self.kind}-seed{self.seed}"


def drawn(seed: int, number: int) -> LogCase:
    """The case of this number, of a trial with this seed; the formats take turns."""
    rng = np.random.default_rng([seed, number])
    kind = tuple(SUFFIX)[number % len(SUFFIX)]
    return LogCase(kind=kind, seed=100_000 * seed + number, edits=drawn_edits(rng))


def write_samples(folder: Path) -> dict[str, Path]:
    """A sound log of each format, of one made flight; the same bytes each time."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = {kind: folder / f"sample.{suffix}" for kind, suffix in SUFFIX.items()}
    whole = square_flight()
    short = whole.rows(whole.t_s < SAMPLE_S)
    write_csv(paths["csv"], csv_columns(short) | battery_columns(short))
    write_ulog(paths["ulog"], short, wind=True)
    write_dataflash(paths["dataflash"], short)
    write_tlog(paths["tlog"], short)
    _write_mcap(paths["mcap"], paths["tlog"])
    return paths


def _write_mcap(path: Path, tlog: Path) -> None:
    """What a companion would have recorded of the same flight."""
    log, rows, now = DecisionLog(path), HeardRows(), TelemetryState()
    for event in open_log(tlog).events:
        now.update(event)
        for topic, row in rows.new(now):
            log.write(topic, row)
    log.close()


class _TooLongError(BaseException):
    """No reader's own `except` catches it."""


def read_one(path: Path) -> str:
    """What is wrong with how a log was taken; empty where it was replayed or refused in a line."""
    asked = ReplayRequest(path, None, None, 0.0, None, None, EVERY_S, None, None, None)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            replay_log(asked, None, None, None)
    except LeewayError as error:
        return _wrong_words(str(error), path)
    except _TooLongError:
        return f"more than {CPU_S} s of CPU"
    except Exception as error:  # noqa: BLE001 - whatever leaves the reader is what is looked for
        frame = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(frame.filename).name}:{frame.lineno}"
        return f"{type(error).__name__} at {where}: {str(error)[:120]}"
    return ""


def _wrong_words(words: str, path: Path) -> str:
    if len(words.splitlines()) != 1:
        return f"{len(words.splitlines())} lines: {words[:120]!r}"
    return "" if str(path) in words else f"the file is not named: {words[:120]}"


@dataclass(frozen=True, slots=True)
class ReadingAnswer:
    """What a child says of one log."""

    why: str
    cpu_s: float
    grown_mb: float
    """The child's peak of memory over what it had before its first log."""


@contextlib.contextmanager
def _overheard() -> Iterator[list[bytes]]:
    """What is printed past Python, by a library in C: the beginning of it, once it is over."""
    heard: list[bytes] = []
    before = [os.dup(number) for number in (1, 2)]
    with tempfile.TemporaryFile() as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
        try:
            yield heard
        finally:
            for number, kept in zip((1, 2), before, strict=True):
                os.dup2(kept, number)
                os.close(kept)
            file.seek(0)
            heard.append(file.read(PRINTED_BYTES))


def _wrong_prints(printed: list[bytes]) -> str:
    words = b"".join(printed).decode(errors="replace").splitlines()
    return f"printed past the command: {words[0][:120]}" if words else ""


def _serve(pipe: Connection) -> None:
    """In the child: read logs within bounds until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's is for the parent
    signal.signal(signal.SIGVTALRM, _too_long)
    before_mb = _peak_mb()
    _limit_memory()
    with contextlib.suppress(EOFError):
        while True:
            path = pipe.recv()
            signal.setitimer(signal.ITIMER_VIRTUAL, CPU_S)
            begun_s = resource.getrusage(resource.RUSAGE_SELF).ru_utime
            with _overheard() as printed:
                why = read_one(path)
            why = why or _wrong_prints(printed)
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            cpu_s = resource.getrusage(resource.RUSAGE_SELF).ru_utime - begun_s
            pipe.send(ReadingAnswer(why, cpu_s, _peak_mb() - before_mb))


def _too_long(number: int, frame: FrameType | None) -> None:
    raise _TooLongError


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _limit_memory() -> None:
    """No more address space than some over what the program has now (Linux)."""
    with contextlib.suppress(OSError, ValueError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + MEMORY_MB * 1024 * 1024
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


class ReadingChild:
    """A process that reads logs; replaced after some, and when it does not answer."""

    def __init__(self) -> None:
        self._process: BaseProcess | None = None
        self._pipe: Any = None
        self._read = 0

    def __enter__(self) -> "ReadingChild":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.end()

    def begin(self, path: Path) -> None:
        """Have a log read; its `answer` is to be asked for before the next."""
        if self._process is None or self._read >= FRESH_AFTER:
            self._start()
        self._read += 1
        self._pipe.send(path)

    def answer(self) -> ReadingAnswer:
        """What came of it."""
        assert self._process is not None
        try:
            if self._pipe.poll(PATIENCE_S):
                return self._pipe.recv()
            why = f"no answer within {PATIENCE_S:g} s"
        except (EOFError, ConnectionError):
            self._process.join(PATIENCE_S)
            why = f"the reader's process ended with {self._process.exitcode}"
        self.end()
        return ReadingAnswer(why, 0.0, 0.0)

    def _start(self) -> None:
        self.end()
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self._read = 0

    def end(self) -> None:
        """Leave no process behind."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None


def attempts(cases: Iterable[LogCase], folder: Path, jobs: int = 1) -> Iterator[TrialRow]:
    """Damage, read and judge, some side by side; in their order.

    Of a log that was not taken well its damaged file stays in `folder`, under the case's name.
    """
    samples = {kind: path.read_bytes() for kind, path in write_samples(folder).items()}
    with contextlib.ExitStack() as stack:
        idle = [stack.enter_context(ReadingChild()) for _ in range(jobs)]
        busy: deque[tuple[ReadingChild, LogCase, Path]] = deque()
        for case in cases:
            if not idle:
                done = busy.popleft()
                yield _row(*done)
                idle.append(done[0])
            path = folder / f"{case.name}.{SUFFIX[case.kind]}"
            path.write_bytes(damaged(case.kind, samples[case.kind], case.edits))
            child = idle.pop()
            child.begin(path)
            busy.append((child, case, path))
        for waited_for in busy:
            yield _row(*waited_for)


def _row(child: ReadingChild, case: LogCase, path: Path) -> TrialRow:
    answer = child.answer()
    if not answer.why:
        path.unlink()
    told = {"cpu_s": round(answer.cpu_s, 2), "grown_mb": round(answer.grown_mb, 1)}
    return TrialRow(name=case.name, held=not answer.why, why=answer.why, told=told, case=case)
