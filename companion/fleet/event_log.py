"""Events of a fleet member, kept on disk until a dispatcher has asked for them.

One JSON line an event, flushed as it happens; outcomes are also settled on the disk. Nobody is told
an event that does not lie there yet. The newest are kept (`KEPT`), so that a vehicle without a
ground never fills its disk.
"""

import os
import secrets
from bisect import bisect_right
from pathlib import Path
from typing import BinaryIO

import msgspec

from companion.adapters.files.atomic_file import settle_folder
from companion.adapters.files.disk import Disk, DiskAtOnce
from companion.fleet.messages import EventKind, FleetEvent, Refused, decode_event, encode

KEPT = 2000
"""A flight has some 50 events; in bytes, at most about 1 MB."""

SLACK = 1000
"""So many more lie in the file before it is written anew."""

LEAP = 1000
"""Numbers left out at each start: a power cut may have taken events that had been told already, and
what comes must not bear their numbers, or the desk would take it for known.
"""

BATCH = 200
"""Events handed out at one asking; who wants more asks again."""

SETTLED = (EventKind.OUTCOME, EventKind.PLACED, EventKind.RECOVERED, EventKind.CANNOT)
"""What the desk must hear even after a power cut; the rest is for people."""


RECORD = "events"


class EventLog:
    """Appends events and hands them out again. `trouble` says why the disk does not take them.

    What `_write` and `_rewrite` change is the disk's own while it works; the rest is the caller's.
    """

    def __init__(self, path: Path, disk: Disk | None = None) -> None:
        """`disk` writes in its own time; None: at once."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        self._file: BinaryIO | None = None
        self._disk = disk or DiskAtOnce(lambda words: None)
        self.trouble = ""
        self._events = _read(path)
        self.log = self._events[-1].log if self._events else secrets.token_hex(6)
        self._events = [event for event in self._events if event.log == self.log][-KEPT:]
        newest = self._events[-1].seq if self._events else 0
        self._next = newest + LEAP if self._events else 1
        self._written = self._told = newest
        self._rewrite(list(self._events))

    @property
    def last_seq(self) -> int:
        """The newest written event's number; 0: none yet."""
        written = self._written
        last = self._after(written) - 1
        return self._events[last].seq if last >= 0 else 0

    def append(self, event: FleetEvent) -> FleetEvent:
        """Keep an event under the next number; returns it with log and number."""
        event = msgspec.structs.replace(event, log=self.log, seq=self._next)
        self._next += 1
        self._events.append(event)
        if not self._disk.do(RECORD, lambda: self._write(event), whole=True):
            self._keep_in_memory("the disk takes no more", event.seq)
        if len(self._events) > KEPT + SLACK:
            self._events = self._events[-KEPT:]
            kept = list(self._events)
            self._disk.do(RECORD, lambda: self._rewrite(kept), whole=True)
        return event

    def newly_written(self) -> list[FleetEvent]:
        """What has come to lie on the disk since the last call, oldest first."""
        written = self._written
        new = self._events[self._after(self._told) : self._after(written)]
        self._told = max(written, self._told)
        return new

    def after(self, seq: int) -> list[FleetEvent]:
        """The next written events after this number, oldest first, at most `BATCH`."""
        skip = self._after(seq)
        return self._events[skip : min(skip + BATCH, self._after(self._written))]

    def _after(self, seq: int) -> int:
        """Where the events after this number begin."""
        return bisect_right(self._events, seq, key=lambda event: event.seq)

    def has_outcome(self, assignment: str) -> bool:
        """Tell whether the end of this assignment has been noted."""
        return any(e.kind is EventKind.OUTCOME and e.assignment == assignment for e in self._events)

    def close(self) -> None:
        """End the file; the disk is closed first."""
        if self._file is not None:
            self._file.close()

    # --- on the disk's thread ------------------------------------------------------------------

    def _write(self, event: FleetEvent) -> None:
        assert self._file is not None
        try:
            self._file.write(encode(event) + b"\n")
            self._file.flush()
            if event.kind in SETTLED:
                os.fsync(self._file.fileno())
            self.trouble = ""
            self._written = event.seq
        except OSError as error:
            self._keep_in_memory(error.strerror or str(error), event.seq)

    def _keep_in_memory(self, why: str, seq: int) -> None:
        """It is told all the same: an outcome that nobody hears is worse than one that is lost."""
        self.trouble = f"events are only kept in memory: {why}"
        self._written = seq

    def _rewrite(self, events: list[FleetEvent]) -> None:
        """Only these; from a file beside, so that a cut leaves the old one."""
        if self._file is not None:
            self._file.close()
        fresh = self._path.with_name(f"{self._path.name}.new")
        try:
            with fresh.open("wb") as file:
                file.writelines(encode(event) + b"\n" for event in events)
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(self._path)
            settle_folder(self._path.parent)
        except OSError as error:
            self.trouble = f"events are only kept in memory: {error.strerror}"
        self._file = self._path.open("ab")


def _read(path: Path) -> list[FleetEvent]:
    """Every whole line; a torn last one was never acknowledged to anybody."""
    if not path.exists():
        return []
    found = [decode_event(line) for line in path.read_bytes().splitlines()]
    return [event for event in found if not isinstance(event, Refused)]
