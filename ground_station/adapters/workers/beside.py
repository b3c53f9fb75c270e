"""One piece of work at a time in a process of its own, asked for by who cannot wait.

What the process holds up, or takes down with it, is only itself: a library that crashes or a file
that never ends is an answer, too.
"""

import multiprocessing
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Generic, Protocol, TypeVar

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.answers import Answer, WorkerDied, WorkRaised, WorkReturned
from ground_station.adapters.workers.process_crew import end_with_the_parent
from ground_station.core.fleet.fleet_link import Clock

Work = TypeVar("Work")
Result = TypeVar("Result")
_Sent = TypeVar("_Sent", covariant=True)

END_S = 5.0


class Readable(Protocol[_Sent]):
    """Our end of the pipe."""

    def poll(self) -> bool:
        """Whether there is something to read, or the end."""
        ...

    def recv(self) -> _Sent:
        """What was sent. EOFError at the end."""
        ...

    def close(self) -> None:
        """Close this end."""
        ...


@dataclass(slots=True)
class Beside(Generic[Work, Result]):
    """Does `do` in a new process for each piece; both have to be picklable.

    Its death is noticed at once, and it is killed `limit_s` after it was asked.
    """

    do: Callable[[Work], Result]
    clock: Clock
    limit_s: float
    process: SpawnProcess | None = None
    _pipe: Readable[Answer[Result]] | None = None
    _asked_s: float = 0.0

    def ask(self, piece: Work) -> None:
        """Begin a piece; the one before is given up."""
        self.close()
        spawn = multiprocessing.get_context("spawn")  # a fork would copy zenoh's threads
        ours, theirs = spawn.Pipe(duplex=False)
        self._pipe = ours
        self.process = spawn.Process(target=_answer, args=(theirs, self.do, piece), daemon=True)
        self.process.start()
        theirs.close()  # else the end of the process would not be noticed
        self._asked_s = self.clock.monotonic_s()

    def answer(self) -> Answer[Result] | None:
        """The answer, once; None: nothing was asked, or it is being worked on.

        Raised is only a LeewayError. Any other mistake ends the process: `WorkerDied`.
        """
        if self._pipe is None or self.process is None:
            return None
        alive = self.process.is_alive()  # first: what it sent before its end is in the pipe then
        if alive and not self._pipe.poll():
            if self.clock.monotonic_s() - self._asked_s < self.limit_s:
                return None
            self.close()
            return WorkerDied(f"not done within {self.limit_s:.0f} s")
        try:
            return self._pipe.recv()
        except EOFError:
            return WorkerDied("its process died")
        finally:
            self.close()

    def close(self) -> None:
        """End the process, whatever it is doing."""
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        if self.process is not None:
            self.process.kill()
            self.process.join(END_S)
            self.process = None


def _answer(pipe: Connection, do: Callable[[Work], Result], piece: Work) -> None:
    """The life of the process: one answer into the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends this one
    threading.Thread(target=end_with_the_parent, name="parent", daemon=True).start()
    try:
        answer: Answer[Result] = WorkReturned(do(piece))
    except LeewayError as error:
        answer = WorkRaised(LeewayError(str(error)))
    pipe.send(answer)
