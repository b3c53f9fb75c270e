"""Bytes to MAVLink messages and back by pymavlink; garbage and forgeries stop here."""

import os

os.environ.setdefault("MAVLINK20", "1")  # before pymavlink is imported: it chooses the wire version

import hashlib
import hmac
import struct
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.clock import epoch_us

COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
"""191: who we are on the vehicle's system."""

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
LINK_ID = 191
Stream = tuple[int, int, int]
"""Link, system, component: who signs counts time stamps up for each of these."""

SIGNING_EPOCH_US = 1_420_070_400_000_000
"""2015-01-01, where MAVLink's signing clock starts."""


_Message: Any = mavlink.MAVLink_message


class CurrentMode(_Message):
    """CURRENT_MODE: PX4's mode by its own stream, at any rate, where HEARTBEAT is held to 1 Hz.

    Standard MAVLink (common.xml, 436) that pymavlink has in its development dialect only.
    """

    id = 436
    msgname = "CURRENT_MODE"
    fieldnames = ("standard_mode", "custom_mode", "intended_custom_mode")
    ordered_fieldnames = ("custom_mode", "intended_custom_mode", "standard_mode")
    fieldtypes = ("uint8_t", "uint32_t", "uint32_t")
    fielddisplays_by_name: ClassVar[dict[str, str]] = {}
    fieldenums_by_name: ClassVar[dict[str, str]] = {}
    fieldunits_by_name: ClassVar[dict[str, str]] = {}
    native_format = bytearray(b"<IIB")
    orders = (2, 0, 1)
    lengths = (1, 1, 1)
    array_lengths = (0, 0, 0)
    crc_extra = 193
    unpacker = struct.Struct("<IIB")
    instance_field = None
    instance_offset = -1

    def __init__(self, standard_mode: int, custom_mode: int, intended_custom_mode: int) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self._instance_field = None
        self._instance_offset = -1
        self.standard_mode = standard_mode
        self.custom_mode = custom_mode
        self.intended_custom_mode = intended_custom_mode

    def pack(self, mav: Any, force_mavlink1: bool = False) -> Any:
        """Its frame."""
        payload = self.unpacker.pack(
            self.custom_mode, self.intended_custom_mode, self.standard_mode
        )
        return self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)


mavlink.mavlink_map.setdefault(CurrentMode.id, CurrentMode)


class _Codec(mavlink.MAVLink):
    """pymavlink's codec, with its replay memory fed only by signatures that were right.

    `refused_stamp`: the newest time of rightly signed frames that were refused as too old, while
    none is accepted.
    """

    refused_stamp: int | None = None

    def check_signature(self, msgbuf: Any, srcSystem: int, srcComponent: int) -> bool:
        key = self.signing.secret_key or b""
        right = hashlib.sha256(bytes(key) + bytes(msgbuf[:-6])).digest()[:6]
        if not hmac.compare_digest(right, bytes(msgbuf[-6:])):
            return False
        if super().check_signature(msgbuf, srcSystem, srcComponent):
            self.refused_stamp = None
            return True
        stamp = int.from_bytes(bytes(msgbuf[-12:-6]), "little")
        if (msgbuf[-13], srcSystem, srcComponent) not in self.signing.stream_timestamps:
            self.refused_stamp = max(stamp, self.refused_stamp or 0)
        return False


class MavlinkCodec:
    """Parses what a link brought and packs what goes out, signed when there is a key."""

    def __init__(self, *, datagrams: bool, signing_key: bytes | None = None) -> None:
        self._datagrams = datagrams
        self.mav = _Codec(None, srcSystem=1, srcComponent=COMPONENT)
        self.mav.robust_parsing = True
        self.bad_frames = 0
        if signing_key is not None:
            signing = self.mav.signing
            signing.secret_key = bytes(signing_key)
            signing.sign_outgoing = True
            signing.link_id = LINK_ID
            signing.timestamp = (epoch_us() - SIGNING_EPOCH_US) // 10

    @property
    def signed(self) -> bool:
        """True when a key is in use."""
        return self.mav.signing.secret_key is not None

    def remember(self, streams: dict[Stream, int]) -> None:
        """Take up the newest time stamps that an earlier process heard: older frames are replays.

        Our own stamps go on after the newest of all, also where this computer's clock stood still.
        """
        self.mav.signing.stream_timestamps.update(streams)
        newest = max(streams.values(), default=0)
        self.mav.signing.timestamp = max(self.mav.signing.timestamp, newest)

    @property
    def streams(self) -> dict[Stream, int]:
        """The newest time stamp heard of each stream, and of our own."""
        own = (LINK_ID, self.mav.srcSystem, COMPONENT)
        return {**self.mav.signing.stream_timestamps, own: self.mav.signing.timestamp}

    @property
    def clocks_apart_us(self) -> tuple[int, int] | None:
        """Two times since 1970, too far apart: of signed frames that we must refuse, and ours.

        A frame of a new stream is refused when it is over a minute older than our signing clock.
        """
        if self.mav.refused_stamp is None:
            return None
        theirs, ours = self.mav.refused_stamp, self.mav.signing.timestamp
        return theirs * 10 + SIGNING_EPOCH_US, ours * 10 + SIGNING_EPOCH_US

    def be_system(self, system_id: int) -> None:
        """Speak as a component of this system."""
        self.mav.srcSystem = system_id

    def parse(self, data: bytes) -> list[Any]:
        """Return the good messages in order; whatever is broken is counted and left out.

        A datagram holds whole frames, so a torn one never swallows the next datagram.
        """
        messages: list[Any] = []
        try:
            found = self.mav.parse_buffer(data) or []
        except (mavlink.MAVError, ValueError, IndexError, UnicodeDecodeError):
            self.bad_frames += 1
            self._forget()
            return messages
        for message in found:
            kind = message.get_type()
            if kind == "BAD_DATA":
                self.bad_frames += 1
            elif not kind.startswith("UNKNOWN"):
                messages.append(message)
        if self._datagrams and self.mav.buf_len() > 0:
            self.bad_frames += 1
            self._forget()
        return messages

    def _forget(self) -> None:
        self.mav.buf = bytearray()
        self.mav.buf_index = 0
        self.mav.expected_length = mavlink.HEADER_LEN_V1 + 2
        self.mav.have_prefix_error = False

    def pack(self, message: Any) -> bytes:
        """Return the frame of an outgoing message."""
        frame = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return frame
