"""Write the decision log: telemetry, estimates and decisions as MCAP with JSON schemas.

Foxglove and PlotJuggler open it. Messages are stamped in UTC by the computer's clock as it was at
the first of them; `t_s` in each is the autopilot's. Beside our rows stand Foxglove's own messages
for its Map and Log panels (`foxglove_rows`); our readers skip them.

Chunks are off and every message is handed to the system at once, so that after `kill -9` the file
lacks only its index: readers that stream it, and `mcap recover`, get every message.
"""

import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
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

from companion.adapters.clock import epoch_us
from companion.adapters.logs.foxglove_rows import FOXGLOVE, ROUTE, foxglove_row
from companion.core.mission.events import (
    AirPressure,
    Airspeed,
    Attitude,
    AutopilotWind,
    Battery,
    Event,
    GnssFix,
    GroundState,
    Home,
    Identified,
    MissionProgress,
    Position,
    Throttle,
    VehicleState,
)
from companion.core.pilot.telemetry_state import TelemetryState

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""What every record begins with: its kind, and the length of what follows."""

CHUNK_LIMIT_BYTES = 1 << 28
"""Writers make chunks of some megabytes; a damaged size would ask for any memory."""

UNDECODABLE = (McapError, struct.error, ValueError, EOFError, RuntimeError, OverflowError)
"""What damaged bytes raise in `mcap` and under it: UnicodeDecodeError and msgspec's are
ValueErrors, lz4 raises RuntimeError."""

FORMAT = "decision-log/2"
METADATA = "leeway"
UTC_AT_ZERO = "utc_at_t_s_0_ns"
"""Nanoseconds since 1970 when the autopilot's clock was at zero."""

NUMBER = {"type": "number"}
TEXT = {"type": "string"}
MAYBE = {"type": ["number", "null"]}
COUNT = {"type": ["integer", "null"]}
FLAG = {"type": "boolean"}

SCHEMAS: dict[str, dict[str, Any]] = {
    "decision": {
        "t_s": NUMBER,
        "kind": TEXT,
        "reason": TEXT,
        "p_home": MAYBE,
        "p_home_now": MAYBE,
        "p_success": MAYBE,
        "margin_wh": MAYBE,
    },
    "wind": {
        "t_s": NUMBER,
        "to_n_mps": NUMBER,
        "to_e_mps": NUMBER,
        "nn_m2ps2": NUMBER,
        "ne_m2ps2": NUMBER,
        "ee_m2ps2": NUMBER,
    },
    "energy": {
        "t_s": NUMBER,
        "left_wh": NUMBER,
        "std_wh": NUMBER,
        "source": TEXT,
        "used_wh": NUMBER,
    },
    "assessment": {
        "t_s": NUMBER,
        "p_home": NUMBER,
        "p_home_now": NUMBER,
        "p_success": NUMBER,
        "margin_wh": NUMBER,
        "energy_left_wh": NUMBER,
        "energy_need_wh": NUMBER,
        "p_home_unattended": MAYBE,
    },
    "phase": {"t_s": NUMBER, "before": TEXT, "now": TEXT, "why": TEXT},
    "said": {"t_s": NUMBER, "severity": NUMBER, "text": TEXT},
    "heard_autopilot": {"t_s": NUMBER, "flavour": TEXT, "system_id": NUMBER},
    "heard_state": {
        "t_s": NUMBER,
        "mode": TEXT,
        "mode_name": TEXT,
        "armed": FLAG,
        "failsafe": FLAG,
        "ready_state": FLAG,
    },
    "heard_ground": {"t_s": NUMBER, "ground": TEXT},
    "heard_attitude": {
        "t_s": NUMBER,
        "roll_rad": NUMBER,
        "pitch_rad": NUMBER,
        "yaw_rad": NUMBER,
        "yaw_rate_rps": MAYBE,
    },
    "heard_position": {
        "t_s": NUMBER,
        "lat_deg": NUMBER,
        "lon_deg": NUMBER,
        "alt_amsl_m": NUMBER,
        "height_rel_m": NUMBER,
        "vel_n_mps": NUMBER,
        "vel_e_mps": NUMBER,
        "vel_d_mps": NUMBER,
    },
    "heard_gnss": {"t_s": NUMBER, "usable": FLAG, "satellites": COUNT},
    "heard_home": {"t_s": NUMBER, "lat_deg": NUMBER, "lon_deg": NUMBER, "alt_amsl_m": NUMBER},
    "heard_battery": {
        "t_s": NUMBER,
        "voltage_v": MAYBE,
        "current_a": MAYBE,
        "consumed_ah": MAYBE,
        "consumed_j": MAYBE,
        "remaining_frac": MAYBE,
        "temperature_c": MAYBE,
        "pack": {"type": ["integer", "null"]},
    },
    "heard_throttle": {"t_s": NUMBER, "throttle_frac": NUMBER},
    "heard_airspeed": {"t_s": NUMBER, "forward_mps": NUMBER, "is_magnitude": FLAG},
    "heard_pressure": {"t_s": NUMBER, "pressure_pa": NUMBER, "board_temperature_c": MAYBE},
    "heard_wind": {"t_s": NUMBER, "to_n_mps": NUMBER, "to_e_mps": NUMBER, "std_mps": MAYBE},
    "heard_progress": {
        "t_s": NUMBER,
        "index": COUNT,
        "total": COUNT,
        "in_mission": {"type": ["boolean", "null"]},
    },
}

HEARD: dict[str, tuple[str, type[Event]]] = {
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
"""Part of the situation: the topic that it is recorded on, and its event."""

IDENTIFIED = "heard_autopilot"
KINDS = dict(HEARD.values()) | {IDENTIFIED: Identified}


def as_event_fields(topic: str, row: dict[str, Any]) -> dict[str, Any]:
    """A row by the names of its event's fields: on disk an autopilot's kind is its `flavour`."""
    if topic != IDENTIFIED or "flavour" not in row:
        return row
    return {**row, "autopilot_kind": row["flavour"]}


class HeardRows:
    """Tells what is new in the situation since the last time, as rows for the decision log."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, int | None], Event] = {}

    def new(self, now: TelemetryState) -> list[tuple[str, dict[str, Any]]]:
        """Return (topic, row) of every sample that came since the last call."""
        rows: list[tuple[str, dict[str, Any]]] = []
        for name, (topic, _) in HEARD.items():
            for sample in _samples(now, name):
                key = name, sample.pack if isinstance(sample, Battery) else None
                if sample is not self._last.get(key):
                    self._last[key] = sample
                    rows.append((topic, msgspec.to_builtins(sample)))
        return rows


def _samples(now: TelemetryState, name: str) -> list[Event]:
    """The newest of this part of the situation: of batteries, one message of each source."""
    if name == "battery":
        return list(now.batteries.values())
    sample: Event | None = getattr(now, name)
    return [] if sample is None else [sample]


class DecisionLog:
    """One MCAP file; a run that goes on in the same folder gets a file of its own."""

    def __init__(self, path: Path, wall_clock_us: Callable[[], int] = epoch_us) -> None:
        """`wall_clock_us`: microseconds since 1970, read once, with the first message."""
        self._file = path.open("wb")
        self._writer = Writer(
            self._file, use_chunking=False, compression=CompressionType.NONE, use_statistics=True
        )
        self._writer.start(profile="", library="leeway")
        self._wall_clock_us = wall_clock_us
        self._utc_at_zero_ns: int | None = None
        self._sequence = 0
        self._channels: dict[str, int] = {}
        for name, fields in SCHEMAS.items():
            self._add_channel(name, f"leeway.{name}", fields)
        for name, (schema, fields) in FOXGLOVE.items():
            self._add_channel(name, schema, fields)

    def _add_channel(self, name: str, title: str, fields: dict[str, Any]) -> None:
        schema = {"title": title, "type": "object", "properties": fields, "required": list(fields)}
        schema_id = self._writer.register_schema(title, "jsonschema", json.dumps(schema).encode())
        self._channels[name] = self._writer.register_channel(f"/{name}", "json", schema_id)

    def write(self, kind: str, row: dict[str, Any]) -> None:
        """Append one message of ours, and what it is for Foxglove."""
        stamp_ns = self._stamp_ns(row["t_s"])
        self._add(kind, row, stamp_ns)
        topic, message = foxglove_row(kind, row, stamp_ns)
        if topic:
            self._add(topic, message, stamp_ns)
        self._file.flush()

    def write_route(self, t_s: float, document: dict[str, Any]) -> None:
        """Append a GeoJSON document for Foxglove's map."""
        text = json.dumps(document, allow_nan=False)
        self._add(ROUTE, {"geojson": text}, self._stamp_ns(t_s))
        self._file.flush()

    def _stamp_ns(self, t_s: float) -> int:
        t_ns = round(float(t_s) * 1e9)
        if self._utc_at_zero_ns is None:
            self._utc_at_zero_ns = self._wall_clock_us() * 1000 - t_ns
            self._describe(self._utc_at_zero_ns)
        return max(0, self._utc_at_zero_ns + t_ns)

    def _describe(self, utc_at_zero_ns: int) -> None:
        self._writer.add_metadata(
            METADATA,
            {
                "format": FORMAT,
                "log_time": "UTC, by the companion computer's clock at the first message",
                "t_s": "seconds on the autopilot's clock",
                UTC_AT_ZERO: str(utc_at_zero_ns),
                "wind": "where the air moves to, north and east",
                "heights": "alt_amsl_m above mean sea level, height_rel_m above the home position",
            },
        )

    def _add(self, topic: str, row: dict[str, Any], stamp_ns: int) -> None:
        self._sequence += 1
        self._writer.add_message(
            self._channels[topic],
            log_time=stamp_ns,
            data=json.dumps(row, allow_nan=False).encode(),
            publish_time=stamp_ns,
            sequence=self._sequence,
        )

    def close(self) -> None:
        """Write the index and end the file."""
        self._writer.finish()
        self._file.close()


def free_name(path: Path) -> Path:
    """Return the path, or the next free one beside it (`decisions-2.mcap`)."""
    number, candidate = 1, path
    while candidate.exists():
        number += 1
        candidate = path.with_stem(f"{path.stem}-{number}")
    return candidate


def aside_name(path: Path) -> Path:
    """Return a free name beside a damaged file (`decisions.mcap.torn-1`)."""
    number = 1
    while (candidate := path.with_name(f"{path.name}.torn-{number}")).exists():
        number += 1
    return candidate


@dataclass(frozen=True, slots=True)
class LogRows:
    """(topic, row) of every whole message; `damage` is the first place that is none, in words.

    A file that was merely cut off (a killed companion's) is not damaged. `utc_at_zero_s`: seconds
    since 1970 when `t_s` was 0, where the file tells.
    """

    rows: list[tuple[str, dict[str, Any]]]
    damage: str | None = None
    utc_at_zero_s: float | None = None


def read_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (topic, row) of every whole message, of a file that may have been cut off anywhere."""
    yield from read_log(path).rows


def read_log(path: Path) -> LogRows:
    """Read an MCAP of JSON messages as far as it goes; a damaged message is left out."""
    raw = path.read_bytes()
    if not raw.startswith(MAGIC):
        return LogRows([], "byte 0: not the beginning of an MCAP")
    rows = _Rows()
    at = len(MAGIC)
    while at + RECORD.size <= len(raw):
        opcode, length = RECORD.unpack_from(raw, at)
        if not 0 < opcode <= Opcode.DATA_END:
            rows.damaged(at, "no record begins here")
            break
        body = at + RECORD.size
        if length > CHUNK_LIMIT_BYTES:  # no record that was cut off ever had so much to say
            rows.damaged(at, f"a record of {length} bytes")
            break
        if length > len(raw) - body:
            break  # cut off
        rows.take(at, opcode, raw[body : body + length])
        at = body + length
        if opcode == Opcode.FOOTER:
            break
    return LogRows(rows.found, rows.damage, rows.utc_at_zero_s)


class _Rows:
    """Takes the records of an MCAP in order. A record that cannot be decoded costs only itself."""

    def __init__(self) -> None:
        self.found: list[tuple[str, dict[str, Any]]] = []
        self.damage: str | None = None
        self.utc_at_zero_s: float | None = None
        self._topics: dict[int, str] = {}

    def damaged(self, at: int, what: str) -> None:
        self.damage = self.damage or f"byte {at}: {what}"

    def take(self, at: int, opcode: int, body: bytes) -> None:
        """Take the record of `body` that begins at byte `at`."""
        try:
            for record in _decoded(opcode, body):
                self._keep(record)
        except UNDECODABLE as error:
            self.damaged(at, f"damaged record ({error})")

    def _keep(self, record: McapRecord) -> None:
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


def _decoded(opcode: int, body: bytes) -> list[McapRecord]:
    """Channels, messages and metadata of one record's bytes: itself, or a chunk's."""
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
