"""Events of a fleet member, stored on disk until a dispatcher requests them.

One JSON line per event, flushed immediately; outcomes are also synced to the disk. An event is
published only after it is stored. The newest are kept (`MAX_EVENTS`), so that a vehicle without a
ground station never fills its disk.
"""

import os
import secrets
from bisect import bisect_right
from pathlib import Path
from typing import BinaryIO

import msgspec

from companion.adapters.files.atomic_file import fsync_folder
from companion.adapters.files.disk import ImmediateRecordWriter, RecordWriter
from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.core.base.wire_message import VERSION
from companion.fleet.messages import (
    EventKind,
    FleetEvent,
    Refused,
    encode_message,
    with_sanitized_texts,
)

MAX_EVENTS = 2000
"""A flight has some 50 events; these are at most about 1 MB."""

REWRITE_SURPLUS = 1000
"""Surplus events in the file that trigger a rewrite."""

SEQ_GAP_AT_RESTART = 1000
"""Gap in the numbers at each start: a power cut may have erased events that were already published,
and new events must not reuse their numbers, or the desk would discard them.
"""

MAX_EVENTS_PER_REPLY = 200
"""Maximum events per reply; a client requests the rest with further requests."""

FSYNC_KINDS = (
    EventKind.OUTCOME,
    EventKind.DRONE_ON_PAD,
    EventKind.RECOVERED,
    EventKind.TASK_FAILED,
)
"""Kinds that the desk must receive even after a power cut; the others are for people."""


RECORD_NAME = "events"

_decoder = msgspec.json.Decoder(FleetEvent)


class EventLog:
    """Stores events and returns them on request. `error_text` describes a disk error.

    `_append_event_to_file` and `_replace_event_file` run on the disk thread, and their attributes
    belong to it meanwhile.
    """

    def __init__(self, path: Path, disk: RecordWriter | None = None) -> None:
        """`disk` writes asynchronously; None: synchronously."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        self._file: BinaryIO | None = None
        self._disk = disk or ImmediateRecordWriter(lambda words: None)
        self.error_text = ""
        self._events = _read_complete_event_lines(path)
        self.log = self._events[-1].log if self._events else secrets.token_hex(6)
        self._events = [event for event in self._events if event.log == self.log][-MAX_EVENTS:]
        newest = self._events[-1].seq if self._events else 0
        self._next_seq = newest + SEQ_GAP_AT_RESTART if self._events else 1
        self._stored_seq = self._announced_seq = newest
        self._replace_event_file(list(self._events))

    @property
    def last_stored_seq(self) -> int:
        """Number of the newest stored event; 0 for none."""
        stored_seq = self._stored_seq
        last = self._first_event_index_after(stored_seq) - 1
        return self._events[last].seq if last >= 0 else 0

    def number_and_store_event(self, event: FleetEvent) -> FleetEvent:
        """Store an event under the next number; return it with log and number."""
        event = msgspec.structs.replace(event, log=self.log, seq=self._next_seq)
        self._next_seq += 1
        self._events.append(event)
        if not self._disk.submit_write_job(
            RECORD_NAME, lambda: self._append_event_to_file(event), is_replaced_at_each_write=True
        ):
            self._record_error_and_release_event("the disk queue is full", event.seq)
        if len(self._events) > MAX_EVENTS + REWRITE_SURPLUS:
            self._events = self._events[-MAX_EVENTS:]
            recent = list(self._events)
            self._disk.submit_write_job(
                RECORD_NAME,
                lambda: self._replace_event_file(recent),
                is_replaced_at_each_write=True,
            )
        return event

    def drain_newly_stored_events(self) -> list[FleetEvent]:
        """Return the events stored since the last call, oldest first."""
        stored_seq = self._stored_seq
        new = self._events[
            self._first_event_index_after(self._announced_seq) : self._first_event_index_after(
                stored_seq
            )
        ]
        self._announced_seq = max(stored_seq, self._announced_seq)
        return new

    def next_stored_events_after(self, event_number: int) -> list[FleetEvent]:
        """Return the next stored events after this number, oldest first, at most
        `MAX_EVENTS_PER_REPLY`.
        """
        first_index = self._first_event_index_after(event_number)
        return self._events[
            first_index : min(
                first_index + MAX_EVENTS_PER_REPLY, self._first_event_index_after(self._stored_seq)
            )
        ]

    def _first_event_index_after(self, event_number: int) -> int:
        """Return the index of the first event after this number."""
        return bisect_right(self._events, event_number, key=lambda event: event.seq)

    def has_stored_outcome(self, assignment: str) -> bool:
        """Return True if the outcome of this assignment has been stored."""
        return any(e.kind is EventKind.OUTCOME and e.assignment == assignment for e in self._events)

    def close(self) -> None:
        """Close the file; the disk must be closed first."""
        if self._file is not None:
            self._file.close()

    # --- on the disk's thread ------------------------------------------------------------------

    def _append_event_to_file(self, event: FleetEvent) -> None:
        assert self._file is not None
        try:
            self._file.write(encode_message(event) + b"\n")
            self._file.flush()
            if event.kind in FSYNC_KINDS:
                os.fsync(self._file.fileno())
            self.error_text = ""
            self._stored_seq = event.seq
        except OSError as error:
            self._record_error_and_release_event(error.strerror or str(error), event.seq)

    def _record_error_and_release_event(self, reason: str, seq: int) -> None:
        """Publish an event that is not stored: better lost at a restart than unreported."""
        self.error_text = f"events are in memory only: {reason}"
        self._stored_seq = seq

    def _replace_event_file(self, events: list[FleetEvent]) -> None:
        """Replace the file by these events, atomically."""
        if self._file is not None:
            self._file.close()
        temporary_file = self._path.with_name(f"{self._path.name}.new")
        try:
            with temporary_file.open("wb") as file:
                file.writelines(encode_message(event) + b"\n" for event in events)
                file.flush()
                os.fsync(file.fileno())
            temporary_file.replace(self._path)
            fsync_folder(self._path.parent)
        except OSError as error:
            self.error_text = f"events are in memory only: {error.strerror}"
        self._file = self._path.open("ab")


def decode_stored_event(line: bytes) -> FleetEvent | Refused:
    """Decode an event that this or an earlier version has stored; it is sent as this version."""
    try:
        event = _decoder.decode(line)
    except (msgspec.DecodeError, LeewayError, UnicodeDecodeError, RecursionError) as error:
        return Refused(safe_text(f"event: {error}"[:300]))
    return with_sanitized_texts(msgspec.structs.replace(event, v=VERSION))


def _read_complete_event_lines(path: Path) -> list[FleetEvent]:
    """Read every whole line; an incomplete last line was never published."""
    if not path.exists():
        return []
    found = [decode_stored_event(line) for line in path.read_bytes().splitlines()]
    return [event for event in found if not isinstance(event, Refused)]
