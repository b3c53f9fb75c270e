"""A member's identity in a folder: its name, its keys, and the roster in force.

`ground-station pki` writes the folder; the member only replaces the roster by a newer one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.adapters.clock import unix_time_us
from companion.adapters.files.atomic_file import write_text_atomically
from companion.adapters.files.signing_files import read_signing_key
from companion.core.base.documents import parse_toml
from companion.core.base.errors import LeewayError
from companion.core.base.wire_message import Key, Name
from companion.fleet.messages import Refused
from companion.fleet.roster import SignedRoster
from companion.fleet.trust import CertificateValidity, MemberTrust, verify_roster

IDENTITY, ROSTER, SIGNING_KEY, ZENOH = "identity.toml", "roster.json", "signing.key", "zenoh.json5"
TLS_CERTIFICATE = "tls.pem"


class IdentityFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An `identity/1` file: the member that owns this folder."""

    format: Literal["identity/1"] = "identity/1"
    """The format's name."""
    fleet: Name
    """The fleet."""
    name: Name
    """The member."""
    authority_keys: Annotated[list[Key], Meta(min_length=1, max_length=8)] = msgspec.field(
        name="authorities"
    )
    """Public keys of the accepted roster signers; two during a change of the authority."""


@dataclass(frozen=True, slots=True)
class MemberIdentity:
    """The content of a member's folder."""

    folder: Path
    trust: MemberTrust

    @property
    def zenoh_config_path(self) -> Path:
        """Its zenoh configuration."""
        return self.folder / ZENOH

    def read_roster_file(self) -> bytes:
        """Read the roster file again, which may have been replaced by a newer one."""
        return read_file_bytes(self.folder / ROSTER)


def read_and_verify_identity(
    folder: Path, clock_us: Callable[[], int] = unix_time_us
) -> MemberIdentity:
    """Read the identity in a folder; LeewayError names the invalid file."""
    identity_file = _read_identity_file(folder / IDENTITY)
    authority_keys = frozenset(identity_file.authority_keys)
    found = verify_roster(read_file_bytes(folder / ROSTER), authority_keys)
    if isinstance(found, Refused):
        raise LeewayError(f"{folder / ROSTER}: {found.reason}")
    signed, roster = found
    if roster.fleet != identity_file.fleet:
        raise LeewayError(
            f"{folder / ROSTER}: of fleet {roster.fleet}, expected {identity_file.fleet}"
        )
    private = read_signing_key(folder / SIGNING_KEY)

    def store_roster(newer: SignedRoster) -> None:
        write_text_atomically(folder / ROSTER, msgspec.json.encode(newer).decode())

    read_end_us = partial(read_certificate_end_us, folder / TLS_CERTIFICATE)
    trust = MemberTrust(
        identity_file.name,
        private,
        authority_keys,
        signed,
        roster,
        store_roster,
        CertificateValidity(clock_us, read_end_us),
    )
    return MemberIdentity(folder, trust)


def read_identity_of_fleet_and_member(
    folder: Path, fleet: str, name: str | None = None
) -> MemberIdentity:
    """Read the identity in a folder, which must be of this fleet and, if given, of this member."""
    found = read_and_verify_identity(folder)
    if found.trust.fleet != fleet:
        raise LeewayError(f"{folder}: of fleet {found.trust.fleet}, expected {fleet}")
    if name is not None and found.trust.name != name:
        raise LeewayError(f"{folder}: is {found.trust.name}'s, expected {name}'s")
    return found


def read_certificate_end_us(path: Path) -> int | None:
    """Return a certificate's end (PEM) in microseconds since 1970; None if there is no file.

    Raises LeewayError for an invalid certificate.
    """
    if not path.exists():
        return None
    from cryptography import x509  # only a fleet with a roster loads it

    try:
        end = x509.load_pem_x509_certificate(read_file_bytes(path)).not_valid_after_utc
    except ValueError as error:
        raise LeewayError(f"{path}: not a certificate: {error}") from error
    return round(end.timestamp() * 1e6)


def read_file_bytes(path: Path) -> bytes:
    """Read a file of an identity; LeewayError if it is unreadable."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error


def _read_identity_file(path: Path) -> IdentityFile:
    try:
        return msgspec.convert(parse_toml(read_file_bytes(path), str(path)), IdentityFile)
    except msgspec.ValidationError as error:
        raise LeewayError(f"{path}: {error}") from error
