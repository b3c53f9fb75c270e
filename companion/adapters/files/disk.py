"""Work for the disk that no flight waits for, and that no full or broken disk stops.

A card that is busy holds a writer for seconds (fsync of 0.5 to 10 s were seen). In flight the work
is done in order by one thread; in a world that waits for us it is done at once, so that what a
killed companion leaves is the same in every run.
"""

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

WAITING_LIMIT = 20_000
"""Deeds that wait: minutes of a flight's record, at some 100 rows and turns' frames a second."""

CLOSE_LIMIT_S = 30.0
"""How long the end of a flight waits for the disk: three times the slowest fsync that was seen."""

Deed = Callable[[], None]


class Disk(Protocol):
    """Takes deeds, each for a named record, and does them in order.

    A record is given up at its first fault, since what follows a torn row cannot be read; a `whole`
    one, replaced at every write, is tried again. `on_trouble` hears of each record's fault once.
    """

    def do(
        self, record: str, deed: Deed, *, whole: bool = False, newest_only: bool = False
    ) -> bool:
        """Do it, now or later. `newest_only`: in place of the last such deed that still waits.

        False: it was not taken, and will not be done.
        """
        ...

    def settle(self) -> None:
        """Return once all that was asked for is done."""
        ...

    def close(self) -> None:
        """Settle, and take no more."""
        ...


class _Faults:
    """Does deeds, and gives up the records that fail."""

    def __init__(self, on_trouble: Callable[[str], None]) -> None:
        self._on_trouble = on_trouble
        self._given_up: set[str] = set()
        self._told: set[str] = set()

    def attempt(self, record: str, deed: Deed, *, whole: bool) -> None:
        if record in self._given_up:
            return
        try:
            deed()
        except Exception as error:  # noqa: BLE001 - whatever a record breaks on, the flight goes on
            if not whole:
                self._given_up.add(record)
            words = getattr(error, "strerror", None) or repr(error)
            self.tell(record, f"{record}: {words}")

    def tell(self, record: str, words: str) -> None:
        if record not in self._told:
            self._told.add(record)
            with contextlib.suppress(Exception):
                self._on_trouble(words)


class DiskAtOnce:
    """Does every deed before it returns."""

    def __init__(self, on_trouble: Callable[[str], None]) -> None:
        self._faults = _Faults(on_trouble)

    def do(
        self, record: str, deed: Deed, *, whole: bool = False, newest_only: bool = False
    ) -> bool:
        """See `Disk`."""
        self._faults.attempt(record, deed, whole=whole)
        return True

    def settle(self) -> None:
        """Nothing ever waits."""

    def close(self) -> None:
        """Nothing ever waits."""


@dataclass(slots=True)
class _Waiting:
    record: str
    deed: Deed
    whole: bool


class DiskThread:
    """Does deeds on a thread of its own. Where too many wait, new ones are lost, and that is told.

    Where no thread can be had, every record is given up.
    """

    def __init__(
        self, on_trouble: Callable[[str], None], *, waiting_limit: int = WAITING_LIMIT
    ) -> None:
        self._faults = _Faults(on_trouble)
        self._limit = waiting_limit
        self._waiting: deque[_Waiting] = deque()
        self._newest: dict[str, _Waiting] = {}
        self._busy = False
        self._closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="disk", daemon=True)
        try:
            self._thread.start()
        except RuntimeError as error:  # no memory, or too many processes
            self._closed = True
            self._faults.tell("records", f"records: {error}")

    def do(
        self, record: str, deed: Deed, *, whole: bool = False, newest_only: bool = False
    ) -> bool:
        """See `Disk`."""
        with self._changed:
            if self._closed:
                return False
            older = self._newest.get(record) if newest_only else self._newest.pop(record, None)
            if newest_only and older is not None:
                older.deed = deed
            elif len(self._waiting) >= self._limit:
                self._faults.tell("speed", "records: the disk is too slow, rows are lost")
                return False
            else:
                self._queue(_Waiting(record, deed, whole), newest_only=newest_only)
            return True

    def _queue(self, entry: _Waiting, *, newest_only: bool) -> None:
        self._waiting.append(entry)
        if newest_only:
            self._newest[entry.record] = entry
        self._changed.notify_all()

    def settle(self) -> None:
        """See `Disk`; a disk that hangs is not waited for without end."""
        with self._changed:
            self._changed.wait_for(self._is_idle, CLOSE_LIMIT_S)

    def _is_idle(self) -> bool:
        return self._closed or (not self._waiting and not self._busy)

    def close(self) -> None:
        """See `Disk`."""
        self.settle()
        with self._changed:
            if not self._is_idle():
                self._faults.tell("speed", "records: the disk hangs, the end of the record is lost")
            self._closed = True
            self._changed.notify_all()

    def _run(self) -> None:
        while (entry := self._next()) is not None:
            self._faults.attempt(entry.record, entry.deed, whole=entry.whole)

    def _next(self) -> _Waiting | None:
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if not self._waiting:
                return None
            self._busy = True
            entry = self._waiting.popleft()
            if self._newest.get(entry.record) is entry:
                del self._newest[entry.record]
            return entry
