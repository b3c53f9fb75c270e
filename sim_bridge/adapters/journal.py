"""Long work that survives Ctrl-C: finished pieces are kept, one JSON line each.

The journal lies beside the result until the result is complete. The same command continues from
it. A different command does not mix with it and starts from the beginning.
"""

import hashlib
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

Work = TypeVar("Work")
Result = TypeVar("Result")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class Journal(Generic[Result]):
    """Finished pieces on disk, one line each, after a line with the digest of the work."""

    def __init__(self, path: Path, digest: str, kind: type[Result]) -> None:
        self.path, self._digest, self._kind = path, digest, kind

    def read(self) -> dict[int, Result]:
        """Finished pieces of this work; none where the journal belongs to other work."""
        try:
            lines = self.path.read_bytes().splitlines()
        except FileNotFoundError:
            return {}
        if not lines or lines[0] != self._digest.encode():
            return {}
        done = {}
        for line in lines[1:]:
            try:
                index, result = msgspec.json.decode(line, type=tuple[int, self._kind])
            except msgspec.DecodeError:
                break  # cut off in the middle of a line
            done[index] = result
        return done

    @contextmanager
    def writing(self, done: dict[int, Result]) -> Iterator[Callable[[int, Result], None]]:
        """A journal that begins with what is done and takes what follows."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w", encoding="utf-8") as file:
            file.write(self._digest + "\n")

            def add(index: int, result: Result) -> None:
                file.write(msgspec.json.encode((index, result)).decode() + "\n")
                file.flush()

            for index, result in done.items():
                add(index, result)
            yield add

    def remove(self) -> None:
        self.path.unlink(missing_ok=True)


def journaled_map(
    work: Sequence[Work],
    do: Callable[[Work], Result],
    jobs: int,
    journal: Journal[Result],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Result]:
    """`do` of every piece, in order, on `jobs` processes; takes up what the journal has.

    The journal is left to the caller to remove, once the result is written.
    """
    done = journal.read()
    progress(len(done), len(work))
    pending = [i for i in range(len(work)) if i not in done]
    with journal.writing(done) as keep:
        for index, result in _in_any_order(work, do, pending, jobs):
            keep(index, result)
            done[index] = result
            progress(len(done), len(work))
    return [done[i] for i in range(len(work))]


def _in_any_order(
    work: Sequence[Work], do: Callable[[Work], Result], pending: list[int], jobs: int
) -> Iterator[tuple[int, Result]]:
    if jobs == 1:
        for index in pending:
            yield index, do(work[index])
        return
    pool = ProcessPoolExecutor(
        jobs, mp_context=get_context("spawn"), initializer=leave_ctrl_c_to_the_parent
    )
    try:
        with one_thread_a_process():
            waiting = {pool.submit(do, work[index]): index for index in pending}
        for future in as_completed(waiting):
            yield waiting[future], future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def one_thread_a_process() -> Iterator[None]:
    """Processes that are started meanwhile run matrix routines on one thread each.

    There are as many processes as cores: threads beside them wait in a loop (a third more CPU in a
    drag fit on two cores). What is computed is then the same on any number of cores, too.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def digest_of(*things: object) -> str:
    """A digest that identifies the work, from values whose `repr` is complete."""
    return hashlib.sha256(repr(things).encode()).hexdigest()


def leave_ctrl_c_to_the_parent() -> None:
    """What a worker process does first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
