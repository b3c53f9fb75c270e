"""State of a vehicle that we do not simulate, read from the companion's growing stream.tlog.

The companion is the only one on the link, so this is all that there is to see of the vehicle.
"""

import math
import struct
from dataclasses import dataclass, field
from pathlib import Path

from companion.core.base.geo import offset_m
from sim_bridge.app.flight.joined_texts import JoinedTexts
from sim_bridge.autopilot.mavlink.codec import Decoder, Message

STAMP = struct.Struct(">Q")
AUTOPILOT, COMPANION = 1, 191
AUTOPILOT_KINDS = {3: "ardupilot", 12: "px4"}  # MAV_AUTOPILOT
SEVERITY_NOTICE = 5


@dataclass(slots=True)
class Overheard:
    """Follows one stream.tlog; `listen` takes what was appended since."""

    path: Path
    autopilot_kind: str | None = None
    named: dict[str, float] = field(default_factory=dict)
    said: list[tuple[float, str]] = field(default_factory=list)
    t_s: float = 0.0
    away_m: float = 0.0
    up_m: float = 0.0
    _offset: int = 0
    _pending: bytes = b""
    _texts: JoinedTexts = field(default_factory=JoinedTexts, repr=False)
    _stood: tuple[float, float] | None = None
    _decoder: Decoder = field(default_factory=Decoder, repr=False)

    def listen(self) -> None:
        """Take in every whole frame that is new."""
        if not self.path.exists():
            return
        with self.path.open("rb") as file:
            file.seek(self._offset)
            fresh = file.read()
        self._offset += len(fresh)
        self._pending += fresh
        while (size := _record_size(self._pending)) is not None:
            frame = self._pending[STAMP.size : size]
            self._pending = self._pending[size:]
            for message in self._decoder.feed(frame):
                self._hear(message)

    def _hear(self, message: Message) -> None:
        name, component = message.msg_name, message.src_component
        if component == AUTOPILOT:
            if name == "HEARTBEAT":
                self.autopilot_kind = AUTOPILOT_KINDS.get(message.autopilot, self.autopilot_kind)
            elif name == "GLOBAL_POSITION_INT":
                self._place(message)
        elif component == COMPANION:
            if name == "NAMED_VALUE_FLOAT" and math.isfinite(message.value):
                self.named[message.name] = message.value
            elif name == "STATUSTEXT" and message.severity <= SEVERITY_NOTICE:
                text = self._texts.take(message)
                if text is not None:
                    self.said.append((self.t_s, text))

    def _place(self, message: Message) -> None:
        self.t_s = message.time_boot_ms / 1000.0
        self.up_m = message.relative_alt / 1000.0
        if message.lat == 0 and message.lon == 0:
            return  # ArduCopter's word for "no position yet"
        lat_deg, lon_deg = message.lat / 1e7, message.lon / 1e7
        if self._stood is None:
            self._stood = (lat_deg, lon_deg)
        self.away_m = math.hypot(*offset_m(*self._stood, lat_deg, lon_deg))


def _record_size(data: bytes) -> int | None:
    """Bytes of the record at the front of `data` (stamp and frame), None while it is cut."""
    head = STAMP.size
    if len(data) < head + 3:
        return None
    magic, payload, flags = data[head], data[head + 1], data[head + 2]
    if magic == 0xFE:
        size = head + payload + 8
    else:  # MAVLink 2; flag 1 is a signature of 13 bytes
        size = head + payload + 12 + (13 if flags & 1 else 0)
    return size if len(data) >= size else None
