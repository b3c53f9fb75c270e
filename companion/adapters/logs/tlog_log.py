"""Read a .tlog (MAVLink telemetry log) with the same decoding that the companion uses in flight.

Frames are sorted by their headers before they are decoded: most messages of a ground station's log
are not used here, and the others come faster than the estimators need them.
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
    boot_s,
    translate,
    vehicle_kind,
)
from companion.adapters.logs.log_time import LogClock, told
from companion.core.base.errors import LeewayError
from companion.core.mission.events import Event
from companion.core.replay.recorded_flight import LogFinding, RecordedFlight

STAMP_BYTES = 8
V1, V2 = mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2
SIGNED = 0x01

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
PARAM_VALUE = mavlink.MAVLINK_MSG_ID_PARAM_VALUE
AUTOPILOT_VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
LEAST_STEP_S = {
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
"""What is listened to, and the least time between two of a kind: about what we ask for in
flight."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame by its header. `at` is the byte in the file where its stamp stands."""

    at: int
    wall_s: float
    system: int
    component: int
    kind: int
    data: bytes


def looks_like_tlog(head: bytes) -> bool:
    """Tell whether bytes begin with a stamp and a frame's marker."""
    return len(head) > STAMP_BYTES and head[STAMP_BYTES] in (V1, V2) and _plausible(head, 0)


def read_tlog(path: Path) -> RecordedFlight:
    """Read the first autopilot's telemetry; LeewayError where there is none."""
    torn: list[int] = []
    frames = [f for f in _frames(path.read_bytes(), torn) if f.kind in LEAST_STEP_S]
    codec = MavlinkCodec(datagrams=True)
    system, beat = _autopilot(path, frames, codec)
    reader = _Reader(PROFILES[beat.autopilot](), codec)
    for frame in frames:
        if frame.system == system and frame.component == AUTOPILOT:
            reader.take(frame)
    findings = reader.clock.findings()
    if torn:
        findings.append(told(torn, _byte, "bytes that are no whole frame (cut off?)", "left out"))
    others = sorted({f.system for f in frames if f.component == AUTOPILOT} - {system})
    if others:
        what = f"other systems speak too: {', '.join(map(str, others))}"
        findings.append(LogFinding("log", what, f"only system {system} is read"))
    return RecordedFlight(
        source="tlog",
        events=tuple(reader.events),
        findings=tuple(findings),
        autopilot_kind=reader.profile.autopilot_kind,
        vehicle=vehicle_kind(beat.type),
        firmware=reader.firmware,
    )


class _Reader:
    """Decodes what passes, on the autopilot's clock."""

    def __init__(self, profile: AutopilotProfile, codec: MavlinkCodec) -> None:
        self.profile = profile
        self.events: list[Event] = []
        self.firmware: str | None = None
        self._codec = codec
        self.clock = LogClock()
        self._values: dict[str, float | None] = {}
        self._heard_s: dict[int, float] = {}

    def take(self, frame: Frame) -> None:
        """Decode one frame, unless one of its kind was just heard."""
        last_s = self._heard_s.get(frame.kind)
        if last_s is not None and 0.0 <= frame.wall_s - last_s < LEAST_STEP_S[frame.kind]:
            return
        self._heard_s[frame.kind] = frame.wall_s
        for message in self._codec.parse(frame.data):
            self._hear(message)

    def _hear(self, message: Any) -> None:
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
        t_s = self._time(message)
        if t_s is not None:
            self.events += translate(message, self.profile, self._values, t_s)

    def _time(self, message: Any) -> float | None:
        stamp_s = boot_s(message)
        if stamp_s is None:
            return self.clock.t_s
        return self.clock.stamp(message.get_type(), stamp_s)


def _autopilot(path: Path, frames: list[Frame], codec: MavlinkCodec) -> tuple[int, Any]:
    """Return the system that beats most among autopilots that we know, and its heartbeat."""
    beats: Counter[int] = Counter()
    found: dict[int, Any] = {}
    for frame in frames:
        if frame.kind != HEARTBEAT or frame.component != AUTOPILOT:
            continue
        beats[frame.system] += 1
        if frame.system not in found:
            for message in codec.parse(frame.data):
                if message.get_type() == "HEARTBEAT" and message.autopilot in PROFILES:
                    found[frame.system] = message
    if not found:
        raise LeewayError(f"{path}: no heartbeat of a PX4 or ArduPilot autopilot in this .tlog")
    system = max(found, key=lambda s: beats[s])
    return system, found[system]


def _frames(raw: bytes, torn: list[int]) -> Iterator[Frame]:
    """Yield whole frames by their headers; where bytes are no frame, look for the next."""
    at = 0
    while at + STAMP_BYTES + 8 <= len(raw):
        length = _length(raw, at + STAMP_BYTES)
        end = at + STAMP_BYTES + length
        if not length or end > len(raw) or not _followed(raw, end):
            torn.append(at)
            at = _next(raw, at + 1)
            continue
        yield _frame(raw, at, end)
        at = end
    if at < len(raw):
        torn.append(at)


def _frame(raw: bytes, at: int, end: int) -> Frame:
    start = at + STAMP_BYTES
    wall_s = int.from_bytes(raw[at:start], "big") / 1e6
    if raw[start] == V2:
        kind = int.from_bytes(raw[start + 7 : start + 10], "little")
        return Frame(at, wall_s, raw[start + 5], raw[start + 6], kind, raw[start:end])
    return Frame(at, wall_s, raw[start + 3], raw[start + 4], raw[start + 5], raw[start:end])


def _length(raw: bytes, start: int) -> int:
    """Length of the frame that begins here; 0 where none does."""
    if raw[start] == V1:
        return 8 + raw[start + 1]
    if raw[start] == V2:
        return 12 + raw[start + 1] + (13 if raw[start + 2] & SIGNED else 0)
    return 0


def _followed(raw: bytes, end: int) -> bool:
    """Tell whether a frame that ends here is followed by another, or by the end."""
    return end + STAMP_BYTES >= len(raw) or raw[end + STAMP_BYTES] in (V1, V2)


def _plausible(raw: bytes, at: int) -> bool:
    length = _length(raw, at + STAMP_BYTES) if at + STAMP_BYTES + 3 <= len(raw) else 0
    return length > 0 and _followed(raw, at + STAMP_BYTES + length)


def _next(raw: bytes, at: int) -> int:
    """Return where the next frame's stamp stands, or the end."""
    while at + STAMP_BYTES + 8 <= len(raw):
        if raw[at + STAMP_BYTES] in (V1, V2) and _plausible(raw, at):
            return at
        at += 1
    return len(raw)


def _byte(at: int) -> str:
    return f"byte {at}"
