"""State of an external vehicle, read from the companion's growing stream.tlog.

Only the companion uses the link, so this file is the only source of the vehicle's state.
"""

import math
import struct
from dataclasses import dataclass, field
from pathlib import Path

from companion.core.base.geo import ne_offset_m
from sim_bridge.app.link.joined_texts import JoinedTexts
from sim_bridge.autopilot.mavlink.codec import Decoder, Message

STAMP = struct.Struct(">Q")
AUTOPILOT, COMPANION = 1, 191
AUTOPILOT_KINDS = {3: "ardupilot", 12: "px4"}  # MAV_AUTOPILOT
MAX_DISPLAYED_SEVERITY = 5


@dataclass(slots=True)
class StreamMonitor:
    """Follows a stream.tlog; `read_new_frames_and_update_state` reads what was appended."""

    path: Path
    autopilot_kind: str | None = None
    named_values: dict[str, float] = field(default_factory=dict)
    status_texts: list[tuple[float, str]] = field(default_factory=list)
    t_s: float = 0.0
    distance_m: float = 0.0
    up_m: float = 0.0
    _offset: int = 0
    _pending: bytes = b""
    _texts: JoinedTexts = field(default_factory=JoinedTexts, repr=False)
    _first_position_deg: tuple[float, float] | None = None
    _decoder: Decoder = field(default_factory=Decoder, repr=False)

    def read_new_frames_and_update_state(self) -> None:
        """Decode every complete new frame."""
        if not self.path.exists():
            return
        with self.path.open("rb") as file:
            file.seek(self._offset)
            new_bytes = file.read()
        self._offset += len(new_bytes)
        self._pending += new_bytes
        while (size := _first_complete_record_size(self._pending)) is not None:
            frame = self._pending[STAMP.size : size]
            self._pending = self._pending[size:]
            for message in self._decoder.decode_bytes(frame):
                self._update_from_message(message)

    def _update_from_message(self, message: Message) -> None:
        name, component = message.msg_name, message.src_component
        if component == AUTOPILOT:
            if name == "HEARTBEAT":
                self.autopilot_kind = AUTOPILOT_KINDS.get(message.autopilot, self.autopilot_kind)
            elif name == "GLOBAL_POSITION_INT":
                self._update_position(message)
        elif component == COMPANION:
            if name == "NAMED_VALUE_FLOAT" and math.isfinite(message.value):
                self.named_values[message.name] = message.value
            elif name == "STATUSTEXT" and message.severity <= MAX_DISPLAYED_SEVERITY:
                text = self._texts.add_chunk_and_take_complete_text(message)
                if text is not None:
                    self.status_texts.append((self.t_s, text))

    def _update_position(self, message: Message) -> None:
        self.t_s = message.time_boot_ms / 1000.0
        self.up_m = message.relative_alt / 1000.0
        if message.lat == 0 and message.lon == 0:
            return  # ArduCopter sends 0, 0 before its first position
        lat_deg, lon_deg = message.lat / 1e7, message.lon / 1e7
        if self._first_position_deg is None:
            self._first_position_deg = (lat_deg, lon_deg)
        self.distance_m = math.hypot(*ne_offset_m(*self._first_position_deg, lat_deg, lon_deg))


def _first_complete_record_size(data: bytes) -> int | None:
    """Return the size of the first record in `data` (stamp and frame); None if incomplete."""
    head = STAMP.size
    if len(data) < head + 3:
        return None
    magic, payload, flags = data[head], data[head + 1], data[head + 2]
    if magic == 0xFE:
        size = head + payload + 8
    else:  # MAVLink 2; flag 1 is a signature of 13 bytes
        size = head + payload + 12 + (13 if flags & 1 else 0)
    return size if len(data) >= size else None
