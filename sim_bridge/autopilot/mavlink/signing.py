"""MAVLink 2 message signing: 48 bits of SHA-256 under a shared key, with replay protection.

Source: mavlink.io/en/guide/message_signing.html. Timestamps count 10 us since 2015-01-01 UTC and
are passed in; they never go back.
"""

from enum import Enum
from hashlib import sha256

_MAGIC_V2 = 0xFD
_SIGNED = 0x01
_KEY_SIZE = 32
_SIGNATURE_SIZE = 13  # link id, timestamp (6), signature (6)
_MAX_STREAM_AGE_10US = 60 * 100_000  # one minute: how far a stream's first timestamp may lie back

RADIO_STATUS_ID = 109  # the telemetry radio itself sends it, and has no key


class SignatureCheck(Enum):
    """Result of checking one frame."""

    ACCEPTED = "accepted"
    UNSIGNED = "unsigned"
    WRONG_KEY = "wrong key"
    REPLAYED = "replayed"
    OLD_STREAM = "a stream that begins too far in the past"


class Signing:
    """One vehicle's key, clock and latest timestamps of every stream, for all its links."""

    def __init__(self, secret_key: bytes, timestamp_10us: int) -> None:
        if len(secret_key) != _KEY_SIZE:
            raise ValueError(f"secret_key: {len(secret_key)} bytes instead of {_KEY_SIZE}")
        self.timestamp_10us = timestamp_10us
        self._key = secret_key
        self._latest_timestamps: dict[tuple[int, int, int], int] = {}

    def link_signer(self, link_id: int) -> "LinkSigning":
        """The `Signer` of one link; `link_id` is 0 to 255."""
        return LinkSigning(self, link_id)

    def advance_clock_to(self, timestamp_10us: int) -> None:
        """Advance the clock to a time; it never goes back."""
        self.timestamp_10us = max(self.timestamp_10us, timestamp_10us)

    def make_signature_and_advance_clock(self, frame: bytes, link_id: int) -> bytes:
        """The 13 bytes that follow `frame`; each uses up one tick of the clock."""
        tail = bytes([link_id]) + self.timestamp_10us.to_bytes(6, "little")
        self.timestamp_10us += 1
        return tail + sha256(self._key + frame + tail).digest()[:6]

    def check(self, frame: bytes) -> SignatureCheck:
        """Check a frame with a valid CRC, and store its timestamp if it is accepted."""
        if frame[0] != _MAGIC_V2 or not frame[2] & _SIGNED:
            msg_id = int.from_bytes(frame[7:10], "little") if frame[0] == _MAGIC_V2 else frame[5]
            is_radio = msg_id == RADIO_STATUS_ID
            return SignatureCheck.ACCEPTED if is_radio else SignatureCheck.UNSIGNED
        if sha256(self._key + frame[:-6]).digest()[:6] != frame[-6:]:
            return SignatureCheck.WRONG_KEY
        timestamp_10us = int.from_bytes(frame[-12:-6], "little")
        stream = (frame[5], frame[6], frame[-_SIGNATURE_SIZE])
        last_10us = self._latest_timestamps.get(stream)
        if last_10us is None:
            if timestamp_10us < self.timestamp_10us - _MAX_STREAM_AGE_10US:
                return SignatureCheck.OLD_STREAM
        elif timestamp_10us <= last_10us:
            return SignatureCheck.REPLAYED
        self._latest_timestamps[stream] = timestamp_10us
        self.advance_clock_to(timestamp_10us)
        return SignatureCheck.ACCEPTED


class LinkSigning:
    """`codec.Signer` of one link; the vehicle owns the key, clock and stream timestamps."""

    def __init__(self, signing: Signing, link_id: int) -> None:
        self._signing = signing
        self._link_id = link_id
        self.verdicts: dict[SignatureCheck, int] = dict.fromkeys(SignatureCheck, 0)

    def make_signature_and_advance_clock(self, frame: bytes) -> bytes:
        """The 13 bytes that follow `frame` on this link."""
        return self._signing.make_signature_and_advance_clock(frame, self._link_id)

    def record_and_accept_frame(self, frame: bytes) -> bool:
        """Return True if `frame` is accepted; the results are counted."""
        verdict = self._signing.check(frame)
        self.verdicts[verdict] += 1
        return verdict is SignatureCheck.ACCEPTED
