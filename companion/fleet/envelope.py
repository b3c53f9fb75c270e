"""The envelope of a signed message: the message's exact bytes, who signed, and the signature.

MessagePack, so that the bytes inside stay as they are. Nothing in it is believed before `trust` has
checked it.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.core.base.wire_message import Name
from companion.fleet.messages import LARGEST_BYTES, Refused

OVERHEAD_BYTES = 256
"""Format, name, signature and lengths are at most 130 bytes."""


class Envelope(msgspec.Struct, frozen=True, array_like=True):
    """One message in its envelope."""

    format: Literal["signed/1"]
    signer: Name
    signature: Annotated[bytes, Meta(min_length=64, max_length=64)]
    message: bytes


_decoder = msgspec.msgpack.Decoder(Envelope)


def put_in_envelope(signer: str, signature: bytes, raw: bytes) -> bytes:
    """The bytes that travel."""
    return msgspec.msgpack.encode(Envelope("signed/1", signer, signature, raw))


def read_envelope(kind: str, raw: bytes) -> Envelope | Refused:
    """What lies in the envelope, or why these bytes are none."""
    if len(raw) > LARGEST_BYTES[kind] + OVERHEAD_BYTES:
        return Refused(f"{kind}: {len(raw)} bytes")
    try:
        return _decoder.decode(raw)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return Refused(f"{kind}: not signed")
