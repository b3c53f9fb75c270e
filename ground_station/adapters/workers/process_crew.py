"""Worker processes of this machine, each with its own pipe, so that a death is detected at once."""

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

from ground_station.adapters.workers.answers import (
    WorkerTerminated,
    WorkOutcome,
    run_item_catching_errors,
    unpicklable_result_outcome,
)

Work = TypeVar("Work")
Result = TypeVar("Result")

THREAD_COUNT_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
TERMINATE_TIMEOUT_S = 15.0
"""Time after SIGTERM for a worker to end its own child processes; then it is killed."""


@dataclass(slots=True)
class _WorkerProcess:
    process: SpawnProcess
    pipe: Any
    """A `Connection`, whose class differs by platform."""


class ProcessPool(Generic[Work, Result]):
    """Worker processes, started on demand and replaced when they die."""

    def __init__(self, do: Callable[[Work], Result], jobs: int) -> None:
        self._do, self._jobs = do, jobs
        self._idle: list[_WorkerProcess] = []
        self._active: dict[int, _WorkerProcess] = {}

    @property
    def max_concurrent_items(self) -> int:
        """Maximum number of processes."""
        return self._jobs

    def start_item(self, index: int, item: Work) -> None:
        """Send a work item to a worker."""
        while self._idle:
            member = self._idle.pop()
            try:
                member.pipe.send(item)
            except ConnectionError:  # killed while idle: no work item is lost
                self._close_worker(member)
            else:
                self._active[index] = member
                return
        member = self._start_worker()
        self._active[index] = member
        with contextlib.suppress(ConnectionError):  # `wait_outcomes` detects its death
            member.pipe.send(item)

    def wait_outcomes(self) -> list[tuple[int, WorkOutcome[Result]]]:
        """Wait for outcomes and deaths."""
        ready = set(wait([member.pipe for member in self._active.values()]))
        answered = [index for index, member in self._active.items() if member.pipe in ready]
        return [
            (index, self._receive_outcome_and_free_worker(self._active.pop(index)))
            for index in answered
        ]

    def close(self) -> None:
        """End all workers: idle ones at once, busy ones by SIGTERM, then by SIGKILL."""
        for member in self._idle:
            member.pipe.close()
        for member in self._active.values():
            member.process.terminate()
        for member in (*self._idle, *self._active.values()):
            member.process.join(TERMINATE_TIMEOUT_S)
            member.process.kill()
            self._close_worker(member)
        self._idle, self._active = [], {}

    def _receive_outcome_and_free_worker(self, member: _WorkerProcess) -> WorkOutcome[Result]:
        try:
            outcome = member.pipe.recv()
        except (EOFError, OSError):
            self._close_worker(member)
            return WorkerTerminated(f"a worker {_exit_text(member.process.exitcode)}")
        self._idle.append(member)
        return outcome

    def _start_worker(self) -> _WorkerProcess:
        spawn = get_context("spawn")  # a fork would copy threads in an undefined state
        parent_pipe, worker_pipe = Pipe()
        process = spawn.Process(target=_run_worker_loop, args=(worker_pipe, self._do), daemon=True)
        with _block_sigint(), _limit_child_threads_to_one():
            process.start()
        worker_pipe.close()  # otherwise its end is not detected
        return _WorkerProcess(process, parent_pipe)

    def _close_worker(self, member: _WorkerProcess) -> None:
        member.pipe.close()
        member.process.join()


@contextlib.contextmanager
def _block_sigint() -> Iterator[None]:
    """Block SIGINT in processes started inside: Ctrl-C is for the parent only."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _limit_child_threads_to_one() -> Iterator[None]:
    """Limit matrix routines to one thread in processes started inside.

    There are as many workers as processors: additional threads busy-wait (a third more CPU in a
    drag fit on two). Results are then also independent of the number of processors.
    """
    before = {name: os.environ.get(name) for name in THREAD_COUNT_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_COUNT_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _exit_text(code: int | None) -> str:
    if code is not None and code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


def _run_worker_loop(pipe: Connection, work_function: Callable[[Any], Any]) -> None:
    """Main function of a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, _exit_on_sigterm)
    threading.Thread(target=wait_for_parent_end_and_exit, name="parent", daemon=True).start()
    while True:
        try:
            item = pipe.recv()
        except EOFError:
            return
        outcome = run_item_catching_errors(work_function, item)
        try:
            pipe.send(outcome)
        except (TypeError, AttributeError, PicklingError) as error:
            pipe.send(unpicklable_result_outcome(error))


def _exit_on_sigterm(number: int, frame: FrameType | None) -> None:
    signal.signal(number, signal.SIG_IGN)
    raise SystemExit(128 + number)


def wait_for_parent_end_and_exit() -> None:
    """End this process when the parent ends, even if the parent was killed."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(TERMINATE_TIMEOUT_S)
    os._exit(1)
