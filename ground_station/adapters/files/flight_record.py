"""Reads the parts of a flight's decision record (MCAP of JSON rows) that the map shows."""

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

from ground_station.core.fleet.uploaded_route import MissionRoute

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
"""Topics to keep, and the numbers that each row must contain; the map shows no other topic."""

DECODE_ERRORS = (
    McapError,
    struct.error,
    ValueError,
    EOFError,
    RuntimeError,
    OverflowError,
    KeyError,
)
"""Exceptions that `mcap` and its dependencies raise for damaged bytes."""

ROUTE_TOPIC = "foxglove_route"
"""Rows of this topic contain the route and only the log time of their message."""

UNIX_S = "unix_s"
"""Key that a row gets: time of its message by the companion's clock, as in its events."""

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
    """The displayed part of a mission as GeoJSON (RFC 7946)."""

    features: list[_Feature]


@dataclass(slots=True)
class FlightRecord:
    """Rows of one flight by topic, in order of time (`UNIX_S`). `read_error`: why they end early,
    None if intact.
    """

    path: Path
    rows: dict[str, list[Row]] = field(default_factory=lambda: {topic: [] for topic in TOPICS})
    read_error: str | None = None

    @property
    def first_and_last_time_s(self) -> tuple[float, float] | None:
        """First and last time; None for an empty record."""
        times = [
            t for rows in self.rows.values() if rows for t in (rows[0][UNIX_S], rows[-1][UNIX_S])
        ]
        return (min(times), max(times)) if times else None

    def latest_row_at(self, topic: str, unix_s: float) -> Row | None:
        """Return the latest row of a topic at a time."""
        rows = self.rows[topic]
        found = bisect_right(rows, unix_s, key=_row_unix_s)
        return rows[found - 1] if found else None

    def rows_up_to(self, topic: str, unix_s: float) -> list[Row]:
        """Return the rows of a topic up to a time."""
        rows = self.rows[topic]
        return rows[: bisect_right(rows, unix_s, key=_row_unix_s)]


def read_flight_record(path: Path) -> FlightRecord:
    """Read as much of a record as possible. `read_error` reports a missing or damaged file."""
    record = FlightRecord(path)
    try:
        for found in _iterate_decoded_messages(path):
            _add_message(record, *found)
    except OSError as error:
        record.read_error = error.strerror or str(error)
    except DECODE_ERRORS as error:
        record.read_error = f"truncated or damaged ({type(error).__name__})"
    for rows in record.rows.values():
        rows.sort(key=_row_unix_s)
    return record


def _add_message(record: FlightRecord, topic: str, unix_s: float, row: Row) -> None:
    if topic == ROUTE_TOPIC:
        row = {"route": _decode_route(row)}
    needed = TOPICS[topic]
    if not all(isinstance(row.get(name), int | float) for name in needed):
        record.read_error = record.read_error or f"a row of {topic} without {', '.join(needed)}"
        return
    record.rows[topic].append(row | {UNIX_S: unix_s})


def _decode_route(row: Row) -> MissionRoute:
    """Decode a route. Raises an exception of `DECODE_ERRORS` if it is not a mission."""
    mission = msgspec.json.decode(row["geojson"], type=_Mission)
    lines: dict[str, tuple[tuple[float, float], ...]] = {}
    landing_positions: dict[str, tuple[float, float]] = {}
    for feature in mission.features:
        about, geometry = feature.properties, feature.geometry
        if geometry.type == "LineString" and about.kind == "route":
            points = msgspec.convert(geometry.coordinates, list[list[float]])
            lines[about.name] = tuple(_lat_lon_from_geojson_position(point) for point in points)
        elif geometry.type == "Point":
            landing_positions[about.name] = _lat_lon_from_geojson_position(
                msgspec.convert(geometry.coordinates, list[float])
            )
    return MissionRoute(lines.get("outbound", ()), lines.get("homeward", ()), landing_positions)


def _lat_lon_from_geojson_position(lon_lat_deg: list[float]) -> tuple[float, float]:
    lon_deg, lat_deg, *_ = lon_lat_deg
    return lat_deg, lon_deg


def _iterate_decoded_messages(path: Path) -> Iterator[tuple[str, float, Row]]:
    """Yield (topic, time by the companion's clock, row) of each message."""
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        for record in _mcap_records(StreamReader(file)):
            if isinstance(record, Channel):
                topics[record.id] = record.topic.removeprefix("/")
            elif isinstance(record, Message) and topics.get(record.channel_id) in TOPICS:
                row = msgspec.json.decode(record.data, type=dict[str, Any])
                yield topics[record.channel_id], record.publish_time / 1e9, row


def _mcap_records(reader: StreamReader) -> Iterator[McapRecord]:
    return reader.records


def _row_unix_s(row: Row) -> float:
    return row[UNIX_S]
