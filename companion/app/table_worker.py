"""Value tables made in a process of their own, and handed over at a time that is known before.

A process for each table: its memory goes with it, and numpy's sweep, which keeps Python's lock most
of the time, does not hold up the loop. It is this module, run: request in, table out, as pickles.
The next one is started beforehand, because its imports take longer than a table.
"""

import os
import pickle
import select
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from typing import Protocol

from companion.adapters.clock import wall_s
from companion.core.actions import MakeTable
from companion.core.events import TableMade
from companion.core.value_gate import TableRequest, ValueTable, make_table

COMMAND = (sys.executable, "-m", "companion.app.table_worker")

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
    process: "subprocess.Popen[bytes]"
    asked_s: float
    due_s: float
    said: list[bytes] = field(default_factory=list)


LOCKSTEP_WAIT_S = 15.0
"""Less than what a simulated world waits for its companions."""


class TableWorker:
    """Works on one request at a time; a new one puts an end to the old."""

    def __init__(self, wait_s: float = 0.0, command: tuple[str, ...] = COMMAND) -> None:
        """`wait_s`: how long a late answer is waited for (wall clock), with the loop at a stand."""
        self._wait_s = wait_s
        self._command = (*command, str(NICE if wait_s == 0.0 else 0))
        self._work: _Work | None = None
        self._next: subprocess.Popen[bytes] | None = self._started()

    def order(self, action: MakeTable, t_s: float) -> None:
        """Start on a table."""
        self._drop()
        process, self._next = self._next or self._started(), None
        self._work = _Work(process, t_s, t_s + action.allowed_s)
        assert process.stdin is not None
        try:
            process.stdin.write(pickle.dumps(action.request))
            process.stdin.close()
        except OSError:
            return  # it has died: `due` says so at its time

    def due(self, t_s: float) -> TableMade | None:
        """The answer, once its time has come by the autopilot's clock; asked at every tick."""
        work = self._work
        if work is None:
            return None
        if work.asked_s <= t_s < work.due_s:
            _listen(work, 0.0)  # a pipe holds less than a table
            return None
        if t_s < work.asked_s:
            made: ValueTable | str = "the autopilot's clock went back"
        else:
            made = _answer(work, self._wait_s)
        self._drop()
        self._next = self._started()
        return TableMade(t_s, None, made) if isinstance(made, str) else TableMade(t_s, made)

    def stop(self) -> None:
        """End the workers, whatever they are doing."""
        self._drop()
        if self._next is not None:
            _end(self._next)
            self._next = None

    def _drop(self) -> None:
        work, self._work = self._work, None
        if work is not None:
            _end(work.process)

    def _started(self) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )


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


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()


def _listen(work: _Work, patience_s: float) -> bool:
    """Take what the worker says, waiting so long; tells whether it has ended."""
    if work.said and not work.said[-1]:
        return True
    assert work.process.stdout is not None
    pipe, until_s = work.process.stdout.fileno(), wall_s() + patience_s
    while select.select([pipe], [], [], max(0.0, until_s - wall_s()))[0]:
        work.said.append(os.read(pipe, 1 << 20))
        if not work.said[-1]:
            return True
    return False


def _answer(work: _Work, patience_s: float) -> ValueTable | str:
    """What the worker made, waited for so long, or why there is none."""
    if not _listen(work, patience_s):
        return "the worker took too long"
    try:
        made = pickle.loads(b"".join(work.said))
    except (EOFError, pickle.UnpicklingError):
        return "the worker died"
    return made if isinstance(made, ValueTable | str) else "the worker talks nonsense"


def answer_to(request: TableRequest) -> ValueTable | str:
    """One table, or the words for why there is none."""
    try:
        return make_table(request)
    except (ArithmeticError, LookupError, MemoryError, ValueError) as error:
        return f"{type(error).__name__}: {error}"


def main() -> None:
    """The worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the companion's to handle
    os.nice(int(sys.argv[1]))
    sys.stdout.buffer.write(pickle.dumps(answer_to(pickle.load(sys.stdin.buffer)), protocol=5))


if __name__ == "__main__":
    main()
