"""A member's identity as it lies in a folder: who it is, its keys, and the roster in force.

`ground-station pki` writes the folder; the member only replaces the roster by a newer one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from cryptography import x509
from msgspec import Meta

from companion.adapters.clock import epoch_us
from companion.adapters.files.atomic_file import write_text_whole
from companion.core.base.documents import toml_table
from companion.core.base.errors import LeewayError
from companion.core.base.wire_message import Key, Name
from companion.fleet.messages import Refused
from companion.fleet.roster import SignedRoster
from companion.fleet.trust import Trust, checked_roster

IDENTITY, ROSTER, SIGNING_KEY, ZENOH = "identity.toml", "roster.json", "signing.key", "zenoh.json5"
TLS_CERTIFICATE = "tls.pem"
OTHERS = 0o077


class IdentityFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An `identity/1` file: whose folder this is."""

    format: Literal["identity/1"] = "identity/1"
    """The format's name."""
    fleet: Name
    """The fleet."""
    name: Name
    """The member."""
    authorities: Annotated[list[Key], Meta(min_length=1, max_length=8)]
    """Public keys whose rosters it takes; two while the authority changes."""


@dataclass(frozen=True, slots=True)
class Identity:
    """A member's folder, read."""

    folder: Path
    trust: Trust

    @property
    def zenoh(self) -> Path:
        """Its zenoh configuration."""
        return self.folder / ZENOH

    def roster_file(self) -> bytes:
        """The roster as it lies in the folder now; somebody may have put a newer one there."""
        return read_bytes(self.folder / ROSTER)


def read_identity(folder: Path, clock_us: Callable[[], int] = epoch_us) -> Identity:
    """The identity in a folder; LeewayError says which file is wrong."""
    who = _identity_file(folder / IDENTITY)
    authorities = frozenset(who.authorities)
    found = checked_roster(read_bytes(folder / ROSTER), authorities)
    if isinstance(found, Refused):
        raise LeewayError(f"{folder / ROSTER}: {found.reason}")
    signed, roster = found
    if roster.fleet != who.fleet:
        raise LeewayError(f"{folder / ROSTER}: of fleet {roster.fleet}, expected {who.fleet}")
    private = read_signing_key(folder / SIGNING_KEY)

    def keep(newer: SignedRoster) -> None:
        write_text_whole(folder / ROSTER, msgspec.json.encode(newer).decode())

    end_us = partial(certificate_end_us, folder / TLS_CERTIFICATE)
    trust = Trust(who.name, private, authorities, signed, roster, clock_us, keep, end_us)
    return Identity(folder, trust)


def identity_of(folder: Path, fleet: str, name: str | None = None) -> Identity:
    """The identity in a folder, which must be of this fleet and, where given, of this member."""
    found = read_identity(folder)
    if found.trust.fleet != fleet:
        raise LeewayError(f"{folder}: of fleet {found.trust.fleet}, expected {fleet}")
    if name is not None and found.trust.name != name:
        raise LeewayError(f"{folder}: is {found.trust.name}'s, expected {name}'s")
    return found


def certificate_end_us(path: Path) -> int | None:
    """When a certificate (PEM) ends, in microseconds since 1970; None: the file is not there.

    LeewayError where it is no certificate.
    """
    if not path.exists():
        return None
    try:
        end = x509.load_pem_x509_certificate(read_bytes(path)).not_valid_after_utc
    except ValueError as error:
        raise LeewayError(f"{path}: not a certificate: {error}") from error
    return round(end.timestamp() * 1e6)


def read_signing_key(path: Path) -> bytes:
    """A private key that nobody else can read; LeewayError otherwise."""
    text = read_bytes(path).decode(errors="replace").strip()
    if path.stat().st_mode & OTHERS:
        raise LeewayError(f"{path}: others can read it: expected chmod 600")
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) != 32:
        raise LeewayError(f"{path}: expected 64 hex digits")
    return key


def read_bytes(path: Path) -> bytes:
    """A file of an identity; LeewayError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error


def _identity_file(path: Path) -> IdentityFile:
    try:
        return msgspec.convert(toml_table(read_bytes(path), str(path)), IdentityFile)
    except msgspec.ValidationError as error:
        raise LeewayError(f"{path}: {error}") from error
