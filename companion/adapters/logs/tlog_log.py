"""Read a .tlog (MAVLink telemetry log) with the decoder that the companion uses in flight.

Frames are selected by their headers before decoding: most messages of a ground station's log are
not used, and the others come faster than the estimators need.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, MavlinkCodec, mavlink
from companion.adapters.autopilots.parameters import decode_bytewise
from companion.adapters.autopilots.port import PROFILES
from companion.adapters.autopilots.telemetry import (
    AutopilotProfile,
    events_from_message,
    message_time_since_boot_s,
    vehicle_kind,
)
from companion.adapters.logs.log_time import LogClock, summarise_rows_as_issue
from companion.analysis.replay.recorded_flight import LogIssue, RecordedFlight
from companion.core.base.documents import byte_location
from companion.core.base.errors import LeewayError
from companion.core.mission.events import Event

STAMP_BYTES = 8
V1, V2 = mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2
SIGNED = 0x01

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
PARAM_VALUE = mavlink.MAVLINK_MSG_ID_PARAM_VALUE
AUTOPILOT_VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
MIN_INTERVAL_S = {
    HEARTBEAT: 0.0,
    436: 0.0,  # CURRENT_MODE
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 0.045,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.09,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 0.19,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 0.19,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 0.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 0.19,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 0.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.0,
    mavlink.MAVLINK_MSG_ID_WIND: 0.0,
    mavlink.MAVLINK_MSG_ID_WIND_COV: 0.0,
    PARAM_VALUE: 0.0,
    AUTOPILOT_VERSION: 0.0,
}
"""The message types used, and their minimum interval: about the stream rates requested in flight.
"""


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame by its header. `at` is the byte position of its stamp in the file."""

    at: int
    wall_s: float
    system: int
    component: int
    kind: int
    data: bytes


def is_tlog(head: bytes) -> bool:
    """Return True if the bytes begin with a stamp and a frame marker."""
    return len(head) > STAMP_BYTES and head[STAMP_BYTES] in (V1, V2) and _is_whole_frame_at(head, 0)


def read_tlog(path: Path) -> RecordedFlight:
    """Read the first autopilot's telemetry; LeewayError if there is none."""
    damaged_at: list[int] = []
    raw = path.read_bytes()
    frames = [f for f in _iterate_frames(raw, damaged_at) if f.kind in MIN_INTERVAL_S]
    codec = MavlinkCodec(datagrams=True)
    system, heartbeat = _find_autopilot(path, frames, codec)
    reader = _TlogReader(PROFILES[heartbeat.autopilot](), codec)
    for frame in frames:
        if frame.system == system and frame.component == AUTOPILOT:
            reader.decode_frame_unless_too_frequent(frame)
    findings = reader.clock.clock_issues()
    if damaged_at:
        findings.append(
            summarise_rows_as_issue(
                damaged_at,
                lambda offset: byte_location(offset, len(raw)),
                "bytes of no whole frame (truncated?)",
                "discarded",
            )
        )
    others = sorted({f.system for f in frames if f.component == AUTOPILOT} - {system})
    if others:
        description = f"other systems in the log: {', '.join(map(str, others))}"
        findings.append(LogIssue("log", description, f"only system {system} is read"))
    return RecordedFlight(
        source="tlog",
        events=tuple(reader.events),
        findings=tuple(findings),
        autopilot_kind=reader.profile.autopilot_kind,
        vehicle=vehicle_kind(heartbeat.type),
        firmware=reader.firmware,
    )


class _TlogReader:
    """Decodes frames of one autopilot, on the autopilot's clock."""

    def __init__(self, profile: AutopilotProfile, codec: MavlinkCodec) -> None:
        self.profile = profile
        self.events: list[Event] = []
        self.firmware: str | None = None
        self._codec = codec
        self.clock = LogClock()
        self._values: dict[str, float | None] = {}
        self._last_used_s: dict[int, float] = {}

    def decode_frame_unless_too_frequent(self, frame: Frame) -> None:
        """Decode one frame, unless one of its type was used within its minimum interval."""
        last_s = self._last_used_s.get(frame.kind)
        if last_s is not None and 0.0 <= frame.wall_s - last_s < MIN_INTERVAL_S[frame.kind]:
            return
        self._last_used_s[frame.kind] = frame.wall_s
        for message in self._codec.parse_valid_messages(frame.data):
            self._append_events_or_store_value(message)

    def _append_events_or_store_value(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "PARAM_VALUE":
            value = float(message.param_value)
            if self.profile.bytewise_parameters:
                value = decode_bytewise(value, message.param_type)
            self._values[message.param_id] = value
            return
        if kind == "AUTOPILOT_VERSION":
            raw = message.flight_sw_version
            self.firmware = f"{raw >> 24 & 255}.{raw >> 16 & 255}.{raw >> 8 & 255}"
            return
        stamp_s = message_time_since_boot_s(message)
        t_s = self.clock.t_s if stamp_s is None else self.clock.update_from_stamp(kind, stamp_s)
        if t_s is not None:
            self.events += events_from_message(message, self.profile, self._values, t_s)


def _find_autopilot(path: Path, frames: list[Frame], codec: MavlinkCodec) -> tuple[int, Any]:
    """Return the known autopilot's system with most heartbeats, and one of these."""
    heartbeats: Counter[int] = Counter()
    found: dict[int, Any] = {}
    for frame in frames:
        if frame.kind != HEARTBEAT or frame.component != AUTOPILOT:
            continue
        heartbeats[frame.system] += 1
        if frame.system not in found:
            for message in codec.parse_valid_messages(frame.data):
                if message.get_type() == "HEARTBEAT" and message.autopilot in PROFILES:
                    found[frame.system] = message
    if not found:
        raise LeewayError(f"{path}: no heartbeat of a PX4 or ArduPilot autopilot in this .tlog")
    system = max(found, key=lambda s: heartbeats[s])
    return system, found[system]


def _iterate_frames(raw: bytes, damaged_byte_offsets: list[int]) -> Iterator[Frame]:
    """Yield whole frames by their headers; at invalid bytes, search for the next frame."""
    at = 0
    while at + STAMP_BYTES + 8 <= len(raw):
        length = _frame_length(raw, at + STAMP_BYTES)
        end = at + STAMP_BYTES + length
        if not length or end > len(raw) or not _is_frame_next(raw, end):
            damaged_byte_offsets.append(at)
            at = _next_frame_start(raw, at + 1)
            continue
        yield _parse_frame(raw, at, end)
        at = end
    if at < len(raw):
        damaged_byte_offsets.append(at)


def _parse_frame(raw: bytes, at: int, end: int) -> Frame:
    start = at + STAMP_BYTES
    wall_s = int.from_bytes(raw[at:start], "big") / 1e6
    if raw[start] == V2:
        kind = int.from_bytes(raw[start + 7 : start + 10], "little")
        return Frame(at, wall_s, raw[start + 5], raw[start + 6], kind, raw[start:end])
    return Frame(at, wall_s, raw[start + 3], raw[start + 4], raw[start + 5], raw[start:end])


def _frame_length(raw: bytes, start: int) -> int:
    """Return the length of the frame that begins here; 0 if none does."""
    if raw[start] == V1:
        return 8 + raw[start + 1]
    if raw[start] == V2:
        return 12 + raw[start + 1] + (13 if raw[start + 2] & SIGNED else 0)
    return 0


def _is_frame_next(raw: bytes, end: int) -> bool:
    """Return True if a frame that ends here is followed by another, or by the end."""
    return end + STAMP_BYTES >= len(raw) or raw[end + STAMP_BYTES] in (V1, V2)


def _is_whole_frame_at(raw: bytes, stamp_offset: int) -> bool:
    length = (
        _frame_length(raw, stamp_offset + STAMP_BYTES)
        if stamp_offset + STAMP_BYTES + 3 <= len(raw)
        else 0
    )
    return length > 0 and _is_frame_next(raw, stamp_offset + STAMP_BYTES + length)


def _next_frame_start(raw: bytes, at: int) -> int:
    """Return the position of the next frame's stamp, or the end."""
    while at + STAMP_BYTES + 8 <= len(raw):
        if raw[at + STAMP_BYTES] in (V1, V2) and _is_whole_frame_at(raw, at):
            return at
        at += 1
    return len(raw)
