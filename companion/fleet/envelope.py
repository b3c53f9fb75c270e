"""The envelope of a signed message, and its Ed25519 signature.

MessagePack, so that the bytes inside stay unchanged. The content is untrusted until `trust` has
verified it. Signed bytes name their purpose, so that a signature is valid for one purpose only: a
domain, the message's kind, the fleet, the signer, then the exact bytes. `cryptography` takes 0.1 s
to load: functions import it, so that only a fleet with a roster loads it.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from msgspec import Meta

from companion.core.base.wire_message import Name
from companion.fleet.messages import MAX_MESSAGE_BYTES, Refused

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

DOMAIN = b"leeway-signed/1"
MAX_OVERHEAD_BYTES = 256
"""Format, name, signature and lengths are at most 130 bytes."""


class Envelope(msgspec.Struct, frozen=True, array_like=True):
    """One message in its envelope."""

    format: Literal["signed/1"]
    signer: Name
    signature: Annotated[bytes, Meta(min_length=64, max_length=64)]
    message: bytes


_decoder = msgspec.msgpack.Decoder(Envelope)


def encode_envelope(signer: str, signature: bytes, message_bytes: bytes) -> bytes:
    """Encode an envelope."""
    return msgspec.msgpack.encode(Envelope("signed/1", signer, signature, message_bytes))


def decode_envelope(message_kind: str, envelope_bytes: bytes) -> Envelope | Refused:
    """Decode an envelope, or return the reason for its rejection."""
    if len(envelope_bytes) > MAX_MESSAGE_BYTES[message_kind] + MAX_OVERHEAD_BYTES:
        return Refused(f"{message_kind}: {len(envelope_bytes)} bytes")
    try:
        return _decoder.decode(envelope_bytes)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return Refused(f"{message_kind}: not signed")


def generate_private_key() -> bytes:
    """Generate a private key, 32 bytes."""
    return _ed25519().Ed25519PrivateKey.generate().private_bytes_raw()


def public_key_hex_of(private_key: bytes) -> str:
    """Return the public key, in the form used in rosters."""
    key = _ed25519().Ed25519PrivateKey.from_private_bytes(private_key)
    return key.public_key().public_bytes_raw().hex()


def sign_message(private_key: bytes, *, kind: str, fleet: str, signer: str, raw: bytes) -> bytes:
    """Return the signature, 64 bytes."""
    key = _ed25519().Ed25519PrivateKey.from_private_bytes(private_key)
    return key.sign(_bytes_to_sign(kind, fleet, signer, raw))


def is_signature_valid(
    public_key_hex: str, signature: bytes, *, kind: str, fleet: str, signer: str, raw: bytes
) -> bool:
    """Return True if the holder of this key signed these bytes for this purpose."""
    from cryptography.exceptions import InvalidSignature

    try:
        _public_key_from_hex(public_key_hex).verify(
            signature, _bytes_to_sign(kind, fleet, signer, raw)
        )
    except InvalidSignature:
        return False
    return True


def _ed25519() -> Any:
    from cryptography.hazmat.primitives.asymmetric import ed25519

    return ed25519


@lru_cache(maxsize=2048)  # a thousand members send a thousand states a second
def _public_key_from_hex(key_hex: str) -> "Ed25519PublicKey":
    return _ed25519().Ed25519PublicKey.from_public_bytes(bytes.fromhex(key_hex))


def _bytes_to_sign(kind: str, fleet: str, signer: str, raw: bytes) -> bytes:
    """Join the parts; none before the last may hold a zero byte, and names and kinds never do."""
    return b"\0".join([DOMAIN, kind.encode(), fleet.encode(), signer.encode(), raw])
