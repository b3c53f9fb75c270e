"""Convert bytes to MAVLink messages and back with pymavlink; reject invalid and forged frames."""

import os

os.environ.setdefault("MAVLINK20", "1")  # before pymavlink is imported: selects the wire version

import hashlib
import hmac
import struct
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.clock import unix_time_us

COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
"""191: the companion's component ID on the vehicle's system."""

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
LINK_ID = 191
Stream = tuple[int, int, int]
"""Link, system, component: a sender of signed frames counts time stamps up for each stream."""

SIGNING_EPOCH_US = 1_420_070_400_000_000
"""2015-01-01, the start of MAVLink's signing clock."""


_Message: Any = mavlink.MAVLink_message


class CurrentMode(_Message):
    """CURRENT_MODE: PX4's mode as a stream of any rate; PX4 limits HEARTBEAT to 1 Hz.

    Standard MAVLink (common.xml, 436); pymavlink has it in its development dialect only.
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
        """Return the frame."""
        payload = self.unpacker.pack(
            self.custom_mode, self.intended_custom_mode, self.standard_mode
        )
        return self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)


mavlink.mavlink_map.setdefault(CurrentMode.id, CurrentMode)


class _VerifyingCodec(mavlink.MAVLink):
    """pymavlink's codec; only frames with a valid signature update its replay memory.

    `refused_stamp`: the newest time stamp of validly signed frames that were refused as too old,
    until a frame is accepted. `first_stamp_floor`: a new stream's first frame must be newer.
    """

    refused_stamp: int | None = None
    first_stamp_floor = 0

    def check_signature(self, msgbuf: Any, srcSystem: int, srcComponent: int) -> bool:
        key = self.signing.secret_key or b""
        expected_signature = hashlib.sha256(bytes(key) + bytes(msgbuf[:-6])).digest()[:6]
        if not hmac.compare_digest(expected_signature, bytes(msgbuf[-6:])):
            return False
        stamp = int.from_bytes(bytes(msgbuf[-12:-6]), "little")
        is_new = (msgbuf[-13], srcSystem, srcComponent) not in self.signing.stream_timestamps
        is_recent = not is_new or stamp > self.first_stamp_floor
        if is_recent and super().check_signature(msgbuf, srcSystem, srcComponent):
            self.refused_stamp = None
            return True
        if is_new:
            self.refused_stamp = max(stamp, self.refused_stamp or 0)
        return False


class MavlinkCodec:
    """Parses received bytes and packs outgoing messages, signed if there is a key."""

    def __init__(self, *, datagrams: bool, signing_key: bytes | None = None) -> None:
        self._datagrams = datagrams
        self.mav = _VerifyingCodec(None, srcSystem=1, srcComponent=COMPONENT)
        self.mav.robust_parsing = True
        self.bad_frames = 0
        if signing_key is not None:
            signing = self.mav.signing
            signing.secret_key = bytes(signing_key)
            signing.sign_outgoing = True
            signing.link_id = LINK_ID
            signing.timestamp = (unix_time_us() - SIGNING_EPOCH_US) // 10

    @property
    def is_signing(self) -> bool:
        """True when a key is in use."""
        return self.mav.signing.secret_key is not None

    def restore_signing_timestamps(self, newest_timestamp_by_stream: dict[Stream, int]) -> None:
        """Restore an earlier process's newest time stamps; older frames are refused as replays.

        Own stamps continue after the newest of all, also if the computer's clock did not advance.
        """
        self.mav.signing.stream_timestamps.update(newest_timestamp_by_stream)
        newest = max(newest_timestamp_by_stream.values(), default=0)
        self.mav.signing.timestamp = max(self.mav.signing.timestamp, newest)

    def refuse_streams_signed_before_start(self) -> None:
        """Refuse each stream until its stamps are newer than this start: no record of earlier ones.

        MAVLink accepts a new stream that is up to a minute old, which could be a replay.
        """
        self.mav.first_stamp_floor = self.mav.signing.timestamp

    @property
    def newest_signing_timestamp_by_stream(self) -> dict[Stream, int]:
        """The newest time stamp received of each stream, and of the companion's own stream."""
        own = (LINK_ID, self.mav.srcSystem, COMPONENT)
        return {**self.mav.signing.stream_timestamps, own: self.mav.signing.timestamp}

    @property
    def refused_and_own_signing_time_us(self) -> tuple[int, int] | None:
        """Times since 1970: of refused signed frames, and of this companion; `None`: none refused.

        A frame of a new stream is refused when it is over a minute older than the signing clock.
        """
        if self.mav.refused_stamp is None:
            return None
        theirs, ours = self.mav.refused_stamp, self.mav.signing.timestamp
        return theirs * 10 + SIGNING_EPOCH_US, ours * 10 + SIGNING_EPOCH_US

    def set_source_system_id(self, system_id: int) -> None:
        """Send as a component of this system."""
        self.mav.srcSystem = system_id

    def parse_valid_messages(self, data: bytes) -> list[Any]:
        """Return the valid messages in order; invalid frames are counted and discarded.

        A datagram holds whole frames, so an incomplete one never consumes the next datagram.
        """
        messages: list[Any] = []
        try:
            parsed = self.mav.parse_buffer(data) or []
        except (mavlink.MAVError, ValueError, IndexError, UnicodeDecodeError):
            self.bad_frames += 1
            self._reset_receive_buffer()
            return messages
        for message in parsed:
            kind = message.get_type()
            if kind == "BAD_DATA":
                self.bad_frames += 1
            elif not kind.startswith("UNKNOWN"):
                messages.append(message)
        if self._datagrams and self.mav.buf_len() > 0:
            self.bad_frames += 1
            self._reset_receive_buffer()
        return messages

    def _reset_receive_buffer(self) -> None:
        self.mav.buf = bytearray()
        self.mav.buf_index = 0
        self.mav.expected_length = mavlink.HEADER_LEN_V1 + 2
        self.mav.have_prefix_error = False

    def pack(self, message: Any) -> bytes:
        """Return the frame of an outgoing message."""
        frame = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return frame


def heartbeat_message(system_status: int, base_mode: int = 0, custom_mode: int = 0) -> Any:
    """Return the companion's heartbeat."""
    kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
    return mavlink.MAVLink_heartbeat_message(kind, none, base_mode, custom_mode, system_status, 3)


def timesync_response_message(t_s: float, request_ns: int) -> Any:
    """Return the response to a TIMESYNC request; the time is never 0, which marks a request."""
    return mavlink.MAVLink_timesync_message(max(1, round(t_s * 1e9)), request_ns)
