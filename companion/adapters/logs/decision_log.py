"""Write the decision log: telemetry, estimates and decisions as MCAP with JSON schemas.

Foxglove and PlotJuggler open it. Messages are stamped in UTC from the computer's clock at the first
of them; `t_s` in each is the autopilot's time. The file also holds Foxglove messages for the Map
and Log panels (`foxglove_rows`); the readers here skip them.

Chunks are disabled and every message is flushed immediately, so that after `kill -9` the file lacks
only its index: streaming readers, and `mcap recover`, get every message.
"""

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, fields
from io import BytesIO
from pathlib import Path
from typing import Any

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import breakup_chunk
from mcap.writer import CompressionType, Writer

from companion.adapters.clock import unix_time_us
from companion.adapters.logs.foxglove_rows import FOXGLOVE, ROUTE, foxglove_row
from companion.core.base.documents import byte_location
from companion.core.mission.actions import AssessmentReport, Decision, EnergyReport, PhaseChanged
from companion.core.mission.events import (
    AirPressure,
    Airspeed,
    Attitude,
    AutopilotDetected,
    AutopilotWind,
    Battery,
    Event,
    GnssFix,
    GroundState,
    Home,
    MissionProgress,
    Position,
    Throttle,
    VehicleState,
)
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.return_budget.outcomes import SiteMargin

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEADER = struct.Struct("<BQ")
"""Header of a record: its opcode, and the length of its body."""

CHUNK_LIMIT_BYTES = 1 << 28
"""Writers create chunks of a few megabytes; a damaged size could request any amount of memory."""

UNDECODABLE = (McapError, struct.error, ValueError, EOFError, RuntimeError, OverflowError)
"""Exceptions raised for damaged bytes by `mcap` and its dependencies: UnicodeDecodeError and
msgspec's are ValueErrors, lz4 raises RuntimeError."""

FORMAT = "decision-log/2"
METADATA = "leeway"
UTC_AT_ZERO = "utc_at_t_s_0_ns"
"""Nanoseconds since 1970 when the autopilot's clock was at zero."""

NUMBER = {"type": "number"}
TEXT = {"type": "string"}

JSON_TYPES: dict[Any, dict[str, Any]] = {
    float: NUMBER,
    int: NUMBER,
    bool: {"type": "boolean"},
    float | None: {"type": ["number", "null"]},
    int | None: {"type": ["integer", "null"]},
    bool | None: {"type": ["boolean", "null"]},
    tuple[SiteMargin, ...]: {"type": "array"},
}
"""JSON type of a field; texts and enumerations are strings."""

TELEMETRY_TOPICS: dict[str, tuple[str, type[Event]]] = {
    "state": ("heard_state", VehicleState),
    "ground": ("heard_ground", GroundState),
    "attitude": ("heard_attitude", Attitude),
    "position": ("heard_position", Position),
    "gnss": ("heard_gnss", GnssFix),
    "home": ("heard_home", Home),
    "battery": ("heard_battery", Battery),
    "throttle": ("heard_throttle", Throttle),
    "airspeed": ("heard_airspeed", Airspeed),
    "pressure": ("heard_pressure", AirPressure),
    "wind": ("heard_wind", AutopilotWind),
    "progress": ("heard_progress", MissionProgress),
}
"""Attribute of the telemetry state: its topic and its event class."""

AUTOPILOT_TOPIC = "heard_autopilot"

LATER_FIELDS = ("mission_id", "mission_state", "gnss_alt_m", "gnss_alt_std_m")
"""Fields that recordings of earlier versions do not have."""


def _required_schema_fields(kind: type[Any], *unlisted: str) -> dict[str, dict[str, Any]]:
    """Return the fields of a dataclass; `unlisted` ones are allowed in a row, but not required."""
    required_fields = (field for field in fields(kind) if field.name not in unlisted)
    return {field.name: JSON_TYPES.get(field.type, TEXT) for field in required_fields}


SCHEMAS: dict[str, dict[str, Any]] = {
    "decision": _required_schema_fields(Decision),
    "wind": dict.fromkeys(
        ("t_s", "to_n_mps", "to_e_mps", "nn_m2ps2", "ne_m2ps2", "ee_m2ps2"), NUMBER
    ),
    "energy": _required_schema_fields(EnergyReport),
    "assessment": _required_schema_fields(AssessmentReport, "by_table"),
    "phase": _required_schema_fields(PhaseChanged),
    "said": {"t_s": NUMBER, "severity": NUMBER, "text": TEXT},
    AUTOPILOT_TOPIC: {"t_s": NUMBER, "flavour": TEXT, "system_id": NUMBER},
} | {
    topic: _required_schema_fields(event, *LATER_FIELDS)
    for topic, event in TELEMETRY_TOPICS.values()
}

EVENT_OF_TOPIC = dict(TELEMETRY_TOPICS.values()) | {AUTOPILOT_TOPIC: AutopilotDetected}


def as_event_fields(topic: str, row: dict[str, Any]) -> dict[str, Any]:
    """Rename a row's keys to its event's fields: on disk an autopilot's kind is its `flavour`."""
    if topic != AUTOPILOT_TOPIC or "flavour" not in row:
        return row
    return {**row, "autopilot_kind": row["flavour"]}


class TelemetryRows:
    """Finds new samples in the telemetry state, as rows for the decision log."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, int | None], Event] = {}

    def take_new_rows(self, telemetry: TelemetryState) -> list[tuple[str, dict[str, Any]]]:
        """Return (topic, row) of every sample since the last call."""
        rows: list[tuple[str, dict[str, Any]]] = []
        for name, (topic, _) in TELEMETRY_TOPICS.items():
            for sample in _newest_samples(telemetry, name):
                key = name, sample.pack if isinstance(sample, Battery) else None
                if sample is not self._last.get(key):
                    self._last[key] = sample
                    rows.append((topic, msgspec.to_builtins(sample)))
        return rows


def _newest_samples(telemetry: TelemetryState, attribute_name: str) -> list[Event]:
    """Return the newest samples of this attribute: for batteries, one of each pack."""
    if attribute_name == "battery":
        return list(telemetry.pack.messages.values())
    sample: Event | None = getattr(telemetry, attribute_name)
    return [] if sample is None else [sample]


class DecisionLog:
    """One MCAP file; a restarted run in the same folder writes a new file."""

    def __init__(self, path: Path, unix_clock_us: Callable[[], int] = unix_time_us) -> None:
        """`unix_clock_us`: microseconds since 1970, of messages without a time of their own."""
        self._file = path.open("wb")
        self._writer = Writer(
            self._file, use_chunking=False, compression=CompressionType.NONE, use_statistics=True
        )
        self._writer.start(profile="", library="leeway")
        self._wall_clock_us = unix_clock_us
        self._utc_at_zero_ns: int | None = None
        self._sequence = 0
        self._channels: dict[str, int] = {}
        for name, keys in SCHEMAS.items():
            self._add_channel(name, f"leeway.{name}", keys)
        for name, (schema, keys) in FOXGLOVE.items():
            self._add_channel(name, schema, keys)

    def _add_channel(self, name: str, title: str, keys: dict[str, Any]) -> None:
        schema = {"title": title, "type": "object", "properties": keys, "required": list(keys)}
        schema_id = self._writer.register_schema(title, "jsonschema", json.dumps(schema).encode())
        self._channels[name] = self._writer.register_channel(f"/{name}", "json", schema_id)

    def write(self, topic_name: str, row: dict[str, Any], unix_us: int | None = None) -> None:
        """Append one row, and its Foxglove message. `unix_us`: time of the row; None: now."""
        stamps_ns = self._stamps_ns(row["t_s"], unix_us)
        self._add_message(topic_name, row, stamps_ns)
        topic, message = foxglove_row(topic_name, row, stamps_ns[0])
        if topic:
            self._add_message(topic, message, stamps_ns)
        self._file.flush()

    def write_route_geojson(
        self, t_s: float, document: dict[str, Any], unix_us: int | None = None
    ) -> None:
        """Append a GeoJSON document for Foxglove's map."""
        text = json.dumps(document, allow_nan=False)
        self._add_message(ROUTE, {"geojson": text}, self._stamps_ns(t_s, unix_us))
        self._file.flush()

    def _stamps_ns(self, t_s: float, unix_us: int | None) -> tuple[int, int]:
        """Return UTC by the autopilot's clock since the first message, and by the companion's."""
        now_us = self._wall_clock_us() if unix_us is None else unix_us
        t_ns, unix_ns = round(float(t_s) * 1e9), 1000 * now_us
        if self._utc_at_zero_ns is None:
            self._utc_at_zero_ns = unix_ns - t_ns
            self._write_metadata(self._utc_at_zero_ns)
        return max(0, self._utc_at_zero_ns + t_ns), max(0, unix_ns)

    def _write_metadata(self, utc_at_zero_ns: int) -> None:
        self._writer.add_metadata(
            METADATA,
            {
                "format": FORMAT,
                "log_time": "UTC, by the companion computer's clock at the first message;"
                " publish_time: at each message",
                "t_s": "seconds on the autopilot's clock",
                UTC_AT_ZERO: str(utc_at_zero_ns),
                "wind": "where the air moves to, north and east",
                "heights": "alt_amsl_m above mean sea level, height_rel_m above the home position",
            },
        )

    def _add_message(self, topic: str, row: dict[str, Any], stamps_ns: tuple[int, int]) -> None:
        self._sequence += 1
        self._writer.add_message(
            self._channels[topic],
            log_time=stamps_ns[0],
            data=json.dumps(row, allow_nan=False).encode(),
            publish_time=stamps_ns[1],
            sequence=self._sequence,
        )

    def close(self) -> None:
        """Write the index and end the file."""
        self._writer.finish()
        self._file.close()


def next_free_path(path: Path) -> Path:
    """Return the path, or the next free one in the folder (`decisions-2.mcap`)."""
    number, candidate = 1, path
    while candidate.exists():
        number += 1
        candidate = path.with_stem(f"{path.stem}-{number}")
    return candidate


def free_path_for_damaged_file(path: Path) -> Path:
    """Return a free name for a damaged file (`decisions.mcap.torn-1`)."""
    number = 1
    while (candidate := path.with_name(f"{path.name}.torn-{number}")).exists():
        number += 1
    return candidate


@dataclass(frozen=True, slots=True)
class LogRows:
    """(topic, row) of every whole message; `error_text` describes the first damaged position.

    A truncated file (of a killed companion) is not damaged. `utc_at_zero_s`: seconds since 1970
    when `t_s` was 0, if the file records it.
    """

    rows: list[tuple[str, dict[str, Any]]]
    error_text: str | None = None
    utc_at_zero_s: float | None = None


def read_mcap_rows(path: Path) -> LogRows:
    """Read an MCAP of JSON messages to its end; a damaged message is skipped."""
    raw = path.read_bytes()
    if not raw.startswith(MAGIC):
        return LogRows([], "it does not begin as an MCAP file")
    rows = _RecordDecoder(len(raw))
    at = len(MAGIC)
    while at + RECORD_HEADER.size <= len(raw):
        opcode, length = RECORD_HEADER.unpack_from(raw, at)
        if not 0 < opcode <= Opcode.DATA_END:
            rows.record_first_error(at, "no valid record")
            break
        body = at + RECORD_HEADER.size
        if length > CHUNK_LIMIT_BYTES:  # no record is that long
            rows.record_first_error(at, f"a record of {length} bytes")
            break
        if length > len(raw) - body:
            break  # truncated
        rows.decode_record(at, opcode, raw[body : body + length])
        at = body + length
        if opcode == Opcode.FOOTER:
            break
    return LogRows(rows.found, rows.error_text, rows.utc_at_zero_s)


class _RecordDecoder:
    """Decodes the records of an MCAP in order. A damaged record does not affect others."""

    def __init__(self, size_bytes: int) -> None:
        self._size_bytes = size_bytes
        self.found: list[tuple[str, dict[str, Any]]] = []
        self.error_text: str | None = None
        self.utc_at_zero_s: float | None = None
        self._topics: dict[int, str] = {}

    def record_first_error(self, byte_offset: int, description: str) -> None:
        place = byte_location(byte_offset, self._size_bytes)
        self.error_text = self.error_text or f"{description} {place}"

    def decode_record(self, byte_offset: int, opcode: int, body: bytes) -> None:
        """Decode the record of `body` that begins at byte `byte_offset`."""
        try:
            for record in _decode_record_body(opcode, body):
                self._store_record(record)
        except UNDECODABLE as error:
            self.record_first_error(byte_offset, f"damaged record ({error})")

    def _store_record(self, record: McapRecord) -> None:
        if isinstance(record, Metadata):
            if record.name == METADATA and UTC_AT_ZERO in record.metadata:
                self.utc_at_zero_s = int(record.metadata[UTC_AT_ZERO]) / 1e9
        elif isinstance(record, Channel):
            topic = record.topic.removeprefix("/")
            if topic not in FOXGLOVE:
                self._topics[record.id] = topic
        elif isinstance(record, Message) and record.channel_id in self._topics:
            row = msgspec.json.decode(record.data, type=dict[str, Any])
            self.found.append((self._topics[record.channel_id], row))


def _decode_record_body(opcode: int, body: bytes) -> list[McapRecord]:
    """Decode channels, messages and metadata of one record: itself, or a chunk's content."""
    stream = ReadDataStream(BytesIO(body))
    match opcode:
        case Opcode.CHANNEL:
            return [Channel.read(stream)]
        case Opcode.MESSAGE:
            return [Message.read(stream, len(body))]
        case Opcode.METADATA:
            return [Metadata.read(stream)]
        case Opcode.CHUNK:
            chunk = Chunk.read(stream)
            if chunk.uncompressed_size > CHUNK_LIMIT_BYTES:
                raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
            try:
                return breakup_chunk(chunk)
            except Exception as error:  # each compression library raises its own
                raise ValueError(repr(error)) from error
        case _:
            return []
