"""Ed25519 signatures over messages of a fleet; only a fleet with a roster loads `cryptography`.

What is signed names its purpose, so that a signature for one thing is none for another: a domain,
the message's kind, the fleet, the signer, then the exact bytes.
"""

from functools import lru_cache

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

DOMAIN = b"leeway-signed/1"


def new_private_key() -> bytes:
    """A fresh private key, 32 bytes."""
    return Ed25519PrivateKey.generate().private_bytes_raw()


def public_key_of(private: bytes) -> str:
    """The public half, as rosters name it."""
    return Ed25519PrivateKey.from_private_bytes(private).public_key().public_bytes_raw().hex()


def sign(private: bytes, *, kind: str, fleet: str, signer: str, raw: bytes) -> bytes:
    """The signature, 64 bytes."""
    key = Ed25519PrivateKey.from_private_bytes(private)
    return key.sign(_signed_bytes(kind, fleet, signer, raw))


def is_signed(
    public: str, signature: bytes, *, kind: str, fleet: str, signer: str, raw: bytes
) -> bool:
    """Tell whether the holder of this key signed these bytes for this purpose."""
    try:
        _public(public).verify(signature, _signed_bytes(kind, fleet, signer, raw))
    except InvalidSignature:
        return False
    return True


@lru_cache(maxsize=2048)  # a thousand members send a thousand states a second
def _public(key: str) -> Ed25519PublicKey:
    return Ed25519PublicKey.from_public_bytes(bytes.fromhex(key))


def _signed_bytes(kind: str, fleet: str, signer: str, raw: bytes) -> bytes:
    """No part before the last may hold a zero byte: names and kinds never do."""
    return b"\0".join([DOMAIN, kind.encode(), fleet.encode(), signer.encode(), raw])
