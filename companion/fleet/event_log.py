"""Events of a fleet member, kept on disk until a dispatcher has asked for them.

One JSON line an event, flushed as it happens; outcomes also wait for the disk. The newest are kept
(`KEPT`), so that a vehicle without a ground never fills its disk.
"""

import os
import secrets
from bisect import bisect_right
from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import settle_folder
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


class EventLog:
    """Appends events and hands them out again. `trouble` says why the disk does not take them."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        self.trouble = ""
        self._events = _read(path)
        self.log = self._events[-1].log if self._events else secrets.token_hex(6)
        self._events = [event for event in self._events if event.log == self.log]
        self._next = self.last_seq + LEAP if self._events else 1
        self._rewrite()

    @property
    def last_seq(self) -> int:
        """The newest event's number; 0: none yet."""
        return self._events[-1].seq if self._events else 0

    def append(self, event: FleetEvent) -> FleetEvent:
        """Keep an event under the next number; returns it with log and number."""
        event = msgspec.structs.replace(event, log=self.log, seq=self._next)
        self._next += 1
        self._events.append(event)
        try:
            self._file.write(encode(event) + b"\n")
            self._file.flush()
            if event.kind in SETTLED:
                os.fsync(self._file.fileno())
            self.trouble = ""
        except OSError as error:
            self.trouble = f"events are only kept in memory: {error.strerror}"
        if len(self._events) > KEPT + SLACK:
            self._file.close()
            self._rewrite()
        return event

    def after(self, seq: int) -> list[FleetEvent]:
        """The next events after this number, oldest first, at most `BATCH`."""
        skip = bisect_right(self._events, seq, key=lambda event: event.seq)
        return self._events[skip : skip + BATCH]

    def has_outcome(self, assignment: str) -> bool:
        """Tell whether the end of this assignment has been written down."""
        return any(e.kind is EventKind.OUTCOME and e.assignment == assignment for e in self._events)

    def close(self) -> None:
        """End the file."""
        self._file.close()

    def _rewrite(self) -> None:
        """Only the newest; from a file beside, so that a cut leaves the old one."""
        self._events = self._events[-KEPT:]
        fresh = self._path.with_name(f"{self._path.name}.new")
        try:
            with fresh.open("wb") as file:
                file.writelines(encode(event) + b"\n" for event in self._events)
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
