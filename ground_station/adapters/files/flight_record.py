"""Reads what the map shows of a flight's decision record (MCAP of JSON rows), damaged or not."""

import struct
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
from mcap.exceptions import McapError
from mcap.records import Channel, McapRecord, Message
from mcap.stream_reader import StreamReader

TOPICS = {
    "decision": (),
    "wind": ("to_n_mps", "to_e_mps"),
    "energy": ("left_wh",),
    "assessment": ("p_home", "margin_wh"),
    "phase": (),
    "said": (),
    "heard_state": (),
    "heard_position": ("lat_deg", "lon_deg"),
}
"""What is kept, and the numbers that a row of it must have; no map shows the rest."""

UNDECODABLE = (McapError, struct.error, ValueError, EOFError, RuntimeError, OverflowError, KeyError)
"""What damaged bytes raise in `mcap` and under it."""

FORMER = {"n": "to_n_mps", "e": "to_e_mps"}
"""Keys of the wind in records of before, and what they are called since."""

WALL_CLOCK_S = 1e9
"""A stamp of more is a wall clock's (2001 and later); an autopilot's counts from its start."""

Row = dict[str, Any]


@dataclass(slots=True)
class FlightRecord:
    """One flight's rows by topic, each in the order of its times. `damage`: where they end early.

    `wall_offset_s`: what the file itself adds to the autopilot's time for the wall clock's; None:
    it does not say.
    """

    path: Path
    rows: dict[str, list[Row]] = field(default_factory=lambda: {topic: [] for topic in TOPICS})
    damage: str | None = None
    wall_offset_s: float | None = None

    @property
    def span_s(self) -> tuple[float, float] | None:
        """First and last time, by the autopilot's clock; None: it is empty."""
        times = [
            t for rows in self.rows.values() if rows for t in (rows[0]["t_s"], rows[-1]["t_s"])
        ]
        return (min(times), max(times)) if times else None

    def at(self, topic: str, t_s: float) -> Row | None:
        """The newest row of a topic at a time."""
        rows = self.rows[topic]
        found = bisect_right(rows, t_s, key=_time)
        return rows[found - 1] if found else None

    def until(self, topic: str, t_s: float) -> list[Row]:
        """The rows of a topic up to a time."""
        rows = self.rows[topic]
        return rows[: bisect_right(rows, t_s, key=_time)]


def read_flight_record(path: Path) -> FlightRecord:
    """What can be read of a record. A file that is missing or damaged says so in `damage`."""
    record = FlightRecord(path)
    try:
        for topic, stamp_s, row in _messages(path):
            needed = ("t_s", *TOPICS[topic])
            if not all(isinstance(row.get(name), int | float) for name in needed):
                record.damage = record.damage or f"a row of {topic} without {', '.join(needed)}"
                continue
            record.rows[topic].append(row)
            if record.wall_offset_s is None and stamp_s > WALL_CLOCK_S:
                record.wall_offset_s = stamp_s - row["t_s"]
    except OSError as error:
        record.damage = error.strerror or str(error)
    except UNDECODABLE as error:
        record.damage = f"cut off or damaged ({type(error).__name__})"
    for rows in record.rows.values():
        rows.sort(key=_time)
    return record


def _messages(path: Path) -> Iterator[tuple[str, float, Row]]:
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        for record in _records(StreamReader(file)):
            if isinstance(record, Channel):
                topics[record.id] = record.topic.removeprefix("/")
            elif isinstance(record, Message) and topics.get(record.channel_id) in TOPICS:
                row = msgspec.json.decode(record.data, type=dict[str, Any])
                if topics[record.channel_id] == "wind":
                    row = {FORMER.get(key, key): value for key, value in row.items()}
                yield topics[record.channel_id], record.log_time / 1e9, row


def _records(reader: StreamReader) -> Iterator[McapRecord]:
    return reader.records


def _time(row: Row) -> float:
    return row["t_s"]
