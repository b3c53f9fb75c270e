"""Persistent progress of long work that survives Ctrl-C: one JSON line per finished work item.

The journal is next to the result until the result is complete. The same command resumes from it. A
different command ignores it and starts from the beginning.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

Item = TypeVar("Item")
Result = TypeVar("Result")


class ProgressLog(Generic[Result]):
    """Finished work items on disk, one line each, after a line with the digest of the work.

    Without a path nothing is kept.
    """

    def __init__(self, path: Path | None, digest: str, kind: type[Result]) -> None:
        self.path, self._digest, self._kind = path, digest, kind

    def read_finished_results(self) -> dict[int, Result]:
        """Return finished items of this work; none if the journal belongs to other work."""
        if self.path is None or not self.path.exists():
            return {}
        lines = self.path.read_bytes().splitlines()
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
    def rewrite_and_open_writer(
        self, finished_results: dict[int, Result]
    ) -> Iterator[Callable[[int, Result], None]]:
        """Rewrite the journal with the finished items and yield a function that appends more."""
        if self.path is None:
            yield lambda index, result: None
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w", encoding="utf-8") as file:
            file.write(self._digest + "\n")

            def append_result(index: int, result: Result) -> None:
                file.write(msgspec.json.encode((index, result)).decode() + "\n")
                file.flush()

            for index, result in finished_results.items():
                append_result(index, result)
            yield append_result

    def results(self, items: Sequence[Item], compute: Callable[[Item], Result]) -> Iterator[Result]:
        """Yield the result of each item, read or computed and appended."""
        done = self.read_finished_results()
        with self.rewrite_and_open_writer(done) as keep:
            for index, item in enumerate(items):
                if index not in done:
                    done[index] = compute(item)
                    keep(index, done[index])
                yield done[index]

    def remove_file(self) -> None:
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def work_digest(*values: object) -> str:
    """Return a digest that identifies the work, from values whose `repr` is complete."""
    return hashlib.sha256(repr(values).encode()).hexdigest()
