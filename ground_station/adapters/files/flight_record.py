"""Reads what the map shows of a flight's decision record (MCAP of JSON rows), damaged or not."""

import struct
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
from mcap.exceptions import McapError
from mcap.records import Channel, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader

from ground_station.core.fleet.route_aboard import RouteAboard

TOPICS = {
    "decision": (),
    "wind": ("to_n_mps", "to_e_mps"),
    "energy": ("left_wh",),
    "assessment": ("p_home", "margin_wh"),
    "phase": (),
    "said": (),
    "heard_state": (),
    "heard_position": ("lat_deg", "lon_deg"),
    "foxglove_route": (),
}
"""What is kept, and the numbers that a row of it must have; no map shows the rest."""

UNDECODABLE = (McapError, struct.error, ValueError, EOFError, RuntimeError, OverflowError, KeyError)
"""What damaged bytes raise in `mcap` and under it."""

FORMER = {"n": "to_n_mps", "e": "to_e_mps"}
"""Keys of the wind in records of before, and what they are called since."""

WALL_CLOCK_S = 1e9
"""A stamp of more is a wall clock's (2001 and later); an autopilot's counts from its start."""

ROUTE = "foxglove_route"
"""Its rows have the route itself, and their stamp's time: the file has no other for them."""

METADATA, UTC_AT_ZERO = "leeway", "utc_at_t_s_0_ns"
"""Where a record says what its autopilot's zero was by the wall clock."""

Row = dict[str, Any]


class _Geometry(msgspec.Struct):
    type: str
    coordinates: Any


class _Properties(msgspec.Struct):
    name: str = ""
    kind: str = ""


class _Feature(msgspec.Struct):
    geometry: _Geometry
    properties: _Properties


class _Mission(msgspec.Struct):
    """A mission as GeoJSON (RFC 7946), as far as it is shown."""

    features: list[_Feature]


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
    routes: list[tuple[float, RouteAboard]] = []
    try:
        for found in _contents(path):
            _take(record, routes, found)
    except OSError as error:
        record.damage = error.strerror or str(error)
    except UNDECODABLE as error:
        record.damage = f"cut off or damaged ({type(error).__name__})"
    offset_s = record.wall_offset_s or 0.0
    record.rows[ROUTE] = [{"t_s": stamp_s - offset_s, "route": route} for stamp_s, route in routes]
    for rows in record.rows.values():
        rows.sort(key=_time)
    return record


def _take(
    record: FlightRecord,
    routes: list[tuple[float, RouteAboard]],
    found: tuple[str, float, Row],
) -> None:
    """Take one message, or the wall clock's offset."""
    topic, stamp_s, row = found
    if topic == METADATA:
        record.wall_offset_s = stamp_s
        return
    if topic == ROUTE:
        routes.append((stamp_s, _route(row)))
        return
    needed = ("t_s", *TOPICS[topic])
    if not all(isinstance(row.get(name), int | float) for name in needed):
        record.damage = record.damage or f"a row of {topic} without {', '.join(needed)}"
        return
    record.rows[topic].append(row)
    if record.wall_offset_s is None and stamp_s > WALL_CLOCK_S:
        record.wall_offset_s = stamp_s - row["t_s"]


def _route(row: Row) -> RouteAboard:
    """Raises what `UNDECODABLE` has, where it is no mission."""
    mission = msgspec.json.decode(row["geojson"], type=_Mission)
    lines: dict[str, tuple[tuple[float, float], ...]] = {}
    places: dict[str, tuple[float, float]] = {}
    for feature in mission.features:
        about, geometry = feature.properties, feature.geometry
        if geometry.type == "LineString" and about.kind == "route":
            points = msgspec.convert(geometry.coordinates, list[list[float]])
            lines[about.name] = tuple(_lat_lon(point) for point in points)
        elif geometry.type == "Point":
            places[about.name] = _lat_lon(msgspec.convert(geometry.coordinates, list[float]))
    return RouteAboard(lines.get("outbound", ()), lines.get("homeward", ()), places)


def _lat_lon(position: list[float]) -> tuple[float, float]:
    lon_deg, lat_deg, *_ = position
    return lat_deg, lon_deg


def _contents(path: Path) -> Iterator[tuple[str, float, Row]]:
    """(topic, stamp, row) of each message; of the metadata the stamp of the autopilot's zero."""
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        for record in _records(StreamReader(file)):
            if isinstance(record, Channel):
                topics[record.id] = record.topic.removeprefix("/")
            elif isinstance(record, Metadata) and record.name == METADATA:
                yield METADATA, int(record.metadata[UTC_AT_ZERO]) / 1e9, {}
            elif isinstance(record, Message) and topics.get(record.channel_id) in TOPICS:
                row = msgspec.json.decode(record.data, type=dict[str, Any])
                if topics[record.channel_id] == "wind":
                    row = {FORMER.get(key, key): value for key, value in row.items()}
                yield topics[record.channel_id], record.log_time / 1e9, row


def _records(reader: StreamReader) -> Iterator[McapRecord]:
    return reader.records


def _time(row: Row) -> float:
    return row["t_s"]
