"""Write the decision log: telemetry, estimates and decisions as MCAP with JSON schemas.

Foxglove opens it.

Chunks are off and every message is handed to the system at once, so that after `kill -9` the file
lacks only its index: readers that stream it, and `mcap recover`, get every message.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from companion.core.mission.events import (
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
        "n": NUMBER,
        "e": NUMBER,
        "nn": NUMBER,
        "ne": NUMBER,
        "ee": NUMBER,
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
    "heard_attitude": {"t_s": NUMBER, "roll_rad": NUMBER, "pitch_rad": NUMBER, "yaw_rad": NUMBER},
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
    "wind": ("heard_wind", AutopilotWind),
    "progress": ("heard_progress", MissionProgress),
}
"""Part of the situation: the topic that it is recorded on, and its event."""

IDENTIFIED = "heard_autopilot"
KINDS = dict(HEARD.values()) | {IDENTIFIED: Identified}


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

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._writer = Writer(
            self._file, use_chunking=False, compression=CompressionType.NONE, use_statistics=True
        )
        self._writer.start(profile="", library="leeway")
        self._sequence = 0
        self._channels: dict[str, int] = {}
        for name, fields in SCHEMAS.items():
            schema = {
                "title": f"leeway.{name}",
                "type": "object",
                "properties": fields,
                "required": list(fields),
            }
            schema_id = self._writer.register_schema(
                f"leeway.{name}", "jsonschema", json.dumps(schema).encode()
            )
            self._channels[name] = self._writer.register_channel(f"/{name}", "json", schema_id)

    def write(self, kind: str, row: dict[str, Any]) -> None:
        """Append one message; its time is the autopilot's."""
        stamp_ns = max(0, round(float(row["t_s"]) * 1e9))
        self._sequence += 1
        self._writer.add_message(
            self._channels[kind],
            log_time=stamp_ns,
            data=json.dumps(row, allow_nan=False).encode(),
            publish_time=stamp_ns,
            sequence=self._sequence,
        )
        self._file.flush()

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


def read_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (topic, row) of every whole message, of a file that may have been cut off anywhere."""
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic.removeprefix("/")
                elif isinstance(record, Message) and record.channel_id in topics:
                    yield topics[record.channel_id], json.loads(record.data)
        except (McapError, struct.error, json.JSONDecodeError):
            return  # the end of what was written
