"""Long work that survives Ctrl-C: finished pieces are kept, one JSON line each.

The journal lies beside the result until the result is complete. The same command continues from
it. A different command does not mix with it and starts from the beginning.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import PieceLost, Workers, side_by_side

Work = TypeVar("Work")
Result = TypeVar("Result")


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


class PiecesLost(LeewayError):
    """Pieces whose workers died twice; all others are done, and kept."""

    def __init__(self, lost: Sequence[PieceLost[Any]], kept: int) -> None:
        self.lost, self.kept = lost, kept
        super().__init__(f"{len(lost)} pieces of work lost, {kept} kept")


def journaled_map(
    work: Sequence[Work],
    do: Callable[[Work], Result],
    workers: Workers,
    journal: Journal[Result],
    progress: Callable[[int, int], None] = lambda done, total: None,
    say: Callable[[str], None] = lambda words: None,
) -> list[Result]:
    """`do` of every piece, in order, by these workers; takes up what the journal has.

    The journal is left to the caller to remove, once the result is written.
    Raises: PiecesLost where workers were killed, when all other pieces are done.
    """
    done = journal.read()
    progress(len(done), len(work))
    pending = [i for i in range(len(work)) if i not in done]
    lost: list[PieceLost[Work]] = []
    with journal.writing(done) as keep:
        for ended in side_by_side((work[i] for i in pending), do, workers, say):
            index = pending[ended.index]
            if isinstance(ended, PieceLost):
                lost.append(PieceLost(index, ended.piece, ended.why))
                continue
            keep(index, ended.result)
            done[index] = ended.result
            progress(len(done), len(work))
    if lost:
        raise PiecesLost(lost, len(done))
    return [done[i] for i in range(len(work))]


def digest_of(*things: object) -> str:
    """A digest that identifies the work, from values whose `repr` is complete."""
    return hashlib.sha256(repr(things).encode()).hexdigest()
