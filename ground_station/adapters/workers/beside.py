"""Runs one work item at a time for a caller that cannot wait: in its own process, or inline.

A library that crashes or never returns affects only that process; the caller receives this as a
result.
"""

import multiprocessing
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, Generic, TypeVar

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.answers import (
    WorkerTerminated,
    WorkOutcome,
    WorkRaised,
    WorkReturned,
)
from ground_station.adapters.workers.process_crew import wait_for_parent_end_and_exit
from ground_station.core.fleet.fleet_link import Clock

Work = TypeVar("Work")
Result = TypeVar("Result")

JOIN_TIMEOUT_S = 5.0


@dataclass(slots=True)
class InlineWorker(Generic[Work, Result]):
    """Runs each work item at once in the caller's thread: for simulated days, where time does not
    advance meanwhile.
    """

    do: Callable[[Work], Result]
    _outcome: WorkOutcome[Result] | None = None

    def start_item(self, item: Work) -> None:
        """Run the work item now."""
        try:
            self._outcome = WorkReturned(self.do(item))
        except LeewayError as error:
            self._outcome = WorkRaised(error)

    def take_outcome(self) -> WorkOutcome[Result] | None:
        """Return the outcome, once."""
        outcome, self._outcome = self._outcome, None
        return outcome

    def close(self) -> None:
        """Do nothing: no work item is running."""


@dataclass(slots=True)
class ProcessWorker(Generic[Work, Result]):
    """Runs `do` in a new process for each work item; both must be picklable.

    Detects when the process dies, and kills it `timeout_s` after its start.
    """

    do: Callable[[Work], Result]
    clock: Clock
    timeout_s: float
    process: SpawnProcess | None = None
    _pipe: Any = None
    """This process's end: a Connection, whose class differs by platform."""
    _start_s: float = 0.0

    def start_item(self, item: Work) -> None:
        """Start a work item; a previous one is cancelled."""
        self.close()
        spawn = multiprocessing.get_context("spawn")  # a fork would copy zenoh's threads
        receiver, sender = spawn.Pipe(duplex=False)
        self._pipe = receiver
        self.process = spawn.Process(
            target=_run_item_and_send_outcome, args=(sender, self.do, item), daemon=True
        )
        self.process.start()
        sender.close()  # otherwise the end of the process is not detected
        self._start_s = self.clock.monotonic_s()

    def take_outcome(self) -> WorkOutcome[Result] | None:
        """Return the outcome once; None without a work item or while it runs.

        Only a LeewayError becomes `WorkRaised`. Other exceptions end the process:
        `WorkerTerminated`.
        """
        if self._pipe is None or self.process is None:
            return None
        alive = (
            self.process.is_alive()
        )  # before the poll: a result sent before its end is then in the pipe
        if alive and not self._pipe.poll():
            if self.clock.monotonic_s() - self._start_s < self.timeout_s:
                return None
            self.close()
            return WorkerTerminated(f"not done within {self.timeout_s:.0f} s")
        try:
            return self._pipe.recv()
        except EOFError:
            return WorkerTerminated("its process died")
        finally:
            self.close()

    def close(self) -> None:
        """Kill the process."""
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        if self.process is not None:
            self.process.kill()
            self.process.join(JOIN_TIMEOUT_S)
            self.process = None


ItemWorker = InlineWorker[Work, Result] | ProcessWorker[Work, Result]
"""Runs one work item at a time."""


def _run_item_and_send_outcome(
    pipe: Connection, work_function: Callable[[Work], Result], item: Work
) -> None:
    """Main function of the process: run the work item and send one outcome."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends this one
    threading.Thread(target=wait_for_parent_end_and_exit, name="parent", daemon=True).start()
    try:
        outcome: WorkOutcome[Result] = WorkReturned(work_function(item))
    except LeewayError as error:
        outcome = WorkRaised(LeewayError(str(error)))
    pipe.send(outcome)
