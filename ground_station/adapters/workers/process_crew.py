"""Worker processes of this machine, each at a pipe of its own: who dies is known at once."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, Pipe, wait
from multiprocessing.context import SpawnProcess
from pickle import PicklingError
from types import FrameType
from typing import Any, Generic, TypeVar

from ground_station.adapters.workers.answers import Answer, WorkerDied, answer_of, not_sent

Work = TypeVar("Work")
Result = TypeVar("Result")

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
GRACE_S = 15.0
"""After SIGTERM a worker has so long to end what it started itself; then it is killed."""


@dataclass(slots=True)
class _Member:
    process: SpawnProcess
    pipe: Any
    """A `Connection`, as each system has its own."""


class ProcessCrew(Generic[Work, Result]):
    """Processes that are started when they are needed first, and replaced where they die."""

    def __init__(self, do: Callable[[Work], Result], jobs: int) -> None:
        self._do, self._jobs = do, jobs
        self._idle: list[_Member] = []
        self._busy: dict[int, _Member] = {}

    @property
    def size(self) -> int:
        """So many at most."""
        return self._jobs

    def begin(self, index: int, piece: Work) -> None:
        """Send a piece to a worker."""
        while self._idle:
            member = self._idle.pop()
            try:
                member.pipe.send(piece)
            except ConnectionError:  # killed while it waited: it had no piece that could be lost
                self._bury(member)
            else:
                self._busy[index] = member
                return
        member = self._hired()
        self._busy[index] = member
        with contextlib.suppress(ConnectionError):  # `ended` sees its death
            member.pipe.send(piece)

    def ended(self) -> list[tuple[int, Answer[Result]]]:
        """Wait for answers and deaths."""
        ready = set(wait([member.pipe for member in self._busy.values()]))
        answered = [index for index, member in self._busy.items() if member.pipe in ready]
        return [(index, self._answer(self._busy.pop(index))) for index in answered]

    def close(self) -> None:
        """End all: who waits at once, who works by SIGTERM, who stays on by SIGKILL."""
        for member in self._idle:
            member.pipe.close()
        for member in self._busy.values():
            member.process.terminate()
        for member in (*self._idle, *self._busy.values()):
            member.process.join(GRACE_S)
            member.process.kill()
            self._bury(member)
        self._idle, self._busy = [], {}

    def _answer(self, member: _Member) -> Answer[Result]:
        try:
            answer = member.pipe.recv()
        except (EOFError, OSError):
            self._bury(member)
            return WorkerDied(f"a worker {_end_in_words(member.process.exitcode)}")
        self._idle.append(member)
        return answer

    def _hired(self) -> _Member:
        spawn = get_context("spawn")  # a fork would copy threads half way
        ours, theirs = Pipe()
        process = spawn.Process(target=_work, args=(theirs, self._do), daemon=True)
        with _without_ctrl_c(), _one_thread_each():
            process.start()
        theirs.close()  # else nobody would notice its end
        return _Member(process, ours)

    def _bury(self, member: _Member) -> None:
        member.pipe.close()
        member.process.join()


@contextlib.contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """What is started inside is born deaf to Ctrl-C, which is for the parent alone."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """What is started inside runs matrix routines on one thread.

    There are as many workers as processors: threads beside them wait in a loop (a third more CPU in
    a drag fit on two). What is computed is then the same on any number of processors, too.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _end_in_words(code: int | None) -> str:
    if code is not None and code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


def _work(pipe: Connection, do: Callable[[Any], Any]) -> None:
    """A worker's life."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, _stop)
    threading.Thread(target=end_with_the_parent, name="parent", daemon=True).start()
    while True:
        try:
            piece = pipe.recv()
        except EOFError:
            return
        answer = answer_of(do, piece)
        try:
            pipe.send(answer)
        except (TypeError, AttributeError, PicklingError) as error:
            pipe.send(not_sent(error))


def _stop(number: int, frame: FrameType | None) -> None:
    signal.signal(number, signal.SIG_IGN)
    raise SystemExit(128 + number)


def end_with_the_parent() -> None:
    """End with it also where it is killed: nobody would take the result."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(GRACE_S)
    os._exit(1)
