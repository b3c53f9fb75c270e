"""Value tables made in a process of their own, and handed over at a time that is known before.

Numpy's sweep keeps Python's lock most of the time and would hold up the loop. The process is this
module, run: its imports take longer than a table, so it is started beforehand and forks for each
request; a table's memory goes with its fork. Requests and answers are pickles behind their length.
"""

import os
import pickle
import select
import signal
import struct
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, Protocol

from companion.adapters.clock import wall_s
from companion.core.mission.actions import MakeTable
from companion.core.mission.events import TableMade
from companion.core.return_budget.value_table.mission_value import (
    TableRequest,
    ValueTable,
    make_table,
)

LENGTH = struct.Struct("<Q")

COMMAND = (sys.executable, "-m", "companion.app.flight.value_table_worker")

NICE = 5
"""The worker yields to the loop, to MAVLink and to whatever else flies; not where they wait."""


class Tables(Protocol):
    """Who makes value tables for a loop."""

    def order(self, action: MakeTable, t_s: float) -> None:
        """Start on a table."""
        ...

    def due(self, t_s: float) -> TableMade | None:
        """The answer, once its time has come by the autopilot's clock; asked at every tick."""
        ...

    def stop(self) -> None:
        """There is no more to be made."""
        ...


@dataclass(frozen=True, slots=True)
class _Work:
    asked_s: float
    due_s: float
    said: bytearray = field(default_factory=bytearray)

    @property
    def is_answered(self) -> bool:
        """Whether the whole answer is there."""
        if len(self.said) < LENGTH.size:
            return False
        return len(self.said) >= LENGTH.size + LENGTH.unpack_from(self.said)[0]


LOCKSTEP_WAIT_S = 15.0
"""Less than what a simulated world waits for its companions."""


class TableWorker:
    """Works on one request at a time; a new one puts an end to the old."""

    def __init__(self, wait_s: float = 0.0, command: tuple[str, ...] = COMMAND) -> None:
        """`wait_s`: how long a late answer is waited for (wall clock), with the loop at a stand."""
        self._wait_s = wait_s
        self._command = (*command, str(NICE if wait_s == 0.0 else 0))
        self._work: _Work | None = None
        self._process: subprocess.Popen[bytes] | None = self._started()

    @property
    def process_id(self) -> int | None:
        """The worker process's number, `None` while there is none."""
        return None if self._process is None else self._process.pid

    @property
    def waits(self) -> bool:
        """A table was ordered, and the worker has not answered yet."""
        return self._work is not None and not self._work.is_answered

    def order(self, action: MakeTable, t_s: float) -> None:
        """Start on a table."""
        if self._work is not None:
            self._end()
        self._process = self._process or self._started()
        self._work = _Work(t_s, t_s + action.allowed_s)
        assert self._process.stdin is not None
        try:
            write_framed(self._process.stdin, pickle.dumps(action.request))
        except OSError:
            return  # it has died: `due` says so at its time

    def due(self, t_s: float) -> TableMade | None:
        """The answer, once its time has come by the autopilot's clock; asked at every tick."""
        work = self._work
        if work is None:
            return None
        if work.asked_s <= t_s < work.due_s:
            self._listen(work, 0.0)  # a pipe holds less than a table
            return None
        if t_s < work.asked_s:
            made: ValueTable | str = "the autopilot's clock went back"
        else:
            made = self._answer(work)
        if not work.is_answered:
            self._end()  # late, hung or dead: the next one starts anew
            self._process = self._started()
        self._work = None
        return TableMade(t_s, None, made) if isinstance(made, str) else TableMade(t_s, made)

    def stop(self) -> None:
        """End the worker, whatever it is doing."""
        self._work = None
        self._end()

    def _started(self) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            process_group=0,  # it is ended with its fork
        )

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):  # what it did not read any more
                    pipe.close()

    def _listen(self, work: _Work, patience_s: float) -> bool:
        """Take what the worker says, waiting so long; tells whether no more is to come."""
        assert self._process is not None
        assert self._process.stdout is not None
        pipe, until_s = self._process.stdout.fileno(), wall_s() + patience_s
        while not work.is_answered:
            if not select.select([pipe], [], [], max(0.0, until_s - wall_s()))[0]:
                return False
            some = os.read(pipe, 1 << 20)
            if not some:
                return True
            work.said.extend(some)
        return True

    def _answer(self, work: _Work) -> ValueTable | str:
        """What the worker made, waited for as long as that is allowed, or why there is none."""
        if not self._listen(work, self._wait_s):
            return "the worker took too long"
        if not work.is_answered:
            return "the worker died"
        try:
            made = pickle.loads(memoryview(work.said)[LENGTH.size :])
        except (EOFError, pickle.UnpicklingError):
            return "the worker talks nonsense"
        return made if isinstance(made, ValueTable | str) else "the worker talks nonsense"


class TablesHere:
    """Makes them in the process of who asks, when they are due: for worlds whose time stands
    still meanwhile. The same tables at the same times as the worker's in lockstep.
    """

    def __init__(self) -> None:
        self._asked: tuple[MakeTable, float] | None = None

    def order(self, action: MakeTable, t_s: float) -> None:
        """Start on a table; an earlier one is dropped."""
        self._asked = (action, t_s)

    def due(self, t_s: float) -> TableMade | None:
        """The answer, once its time has come."""
        if self._asked is None:
            return None
        action, asked_s = self._asked
        if asked_s <= t_s < asked_s + action.allowed_s:
            return None
        self._asked = None
        if t_s < asked_s:
            return TableMade(t_s, None, "the autopilot's clock went back")
        made = answer_to(action.request)
        return TableMade(t_s, None, made) if isinstance(made, str) else TableMade(t_s, made)

    def stop(self) -> None:
        """Nothing runs."""
        self._asked = None


def answer_to(request: TableRequest) -> ValueTable | str:
    """One table, or the words for why there is none."""
    try:
        return make_table(request)
    except (ArithmeticError, LookupError, MemoryError, ValueError) as error:
        return f"{type(error).__name__}: {error}"


def write_framed(pipe: IO[bytes], what: bytes) -> None:
    """One message, behind its length."""
    pipe.write(LENGTH.pack(len(what)) + what)
    pipe.flush()


def read_framed(pipe: IO[bytes]) -> bytes:
    """The next message, whole; none once the other side has gone."""
    head = pipe.read(LENGTH.size)
    return pipe.read(LENGTH.unpack(head)[0]) if len(head) == LENGTH.size else b""


def main() -> None:
    """The worker process: ends with its companion, or after a fork that died."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the companion's to handle
    os.nice(int(sys.argv[1]))
    while request := read_framed(sys.stdin.buffer):
        fork = os.fork()
        if not fork:
            write_framed(sys.stdout.buffer, pickle.dumps(answer_to(pickle.loads(request)), 5))
            os._exit(0)
        if os.waitpid(fork, 0)[1]:
            sys.exit(1)


if __name__ == "__main__":
    main()
