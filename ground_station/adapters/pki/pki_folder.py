"""Folder of a fleet's public key infrastructure: authorities, the roster, one folder per member.

PKI/roster.toml            the roster (`roster/1`); only `pki` writes it
PKI/roster.json            the signed roster, which members accept
PKI/authority/N/           keys of authority N, which can create members: store them separately
PKI/members/NAME/          complete folder for NAME; its private keys may be deleted after the copy
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec

from companion.core.base.errors import LeewayError
from companion.fleet.envelope import generate_private_key, public_key_hex_of, sign_message
from companion.fleet.identity import (
    IDENTITY,
    ROSTER,
    SIGNING_KEY,
    TLS_CERTIFICATE,
    ZENOH,
    read_file_bytes,
    read_signing_key,
)
from companion.fleet.messages import Refused
from companion.fleet.roles import SERVERS, Role
from companion.fleet.roster import (
    Roster,
    RosterMember,
    SignedRoster,
    roster_from_toml,
    roster_to_toml_text,
)
from companion.fleet.topics import require_valid_name
from companion.fleet.trust import ROSTER_KIND, verify_roster
from ground_station.adapters.files.atomic_file import write_file_atomically
from ground_station.adapters.pki.access_rules import (
    TLS_CA,
    TLS_KEY,
    member_zenoh_config_json,
)
from ground_station.adapters.pki.certificates import (
    TlsAuthority,
    TlsKey,
    authority_from_pem,
    public_key_of_certificate,
)

ROSTER_FILE, AUTHORITY_FOLDER, MEMBERS_FOLDER, ROSTER_KEY_FILE = (
    "roster.toml",
    "authority",
    "members",
    "roster.key",
)
PRIVATE_MODE, PUBLIC_MODE = 0o600, 0o644


@dataclass(frozen=True, slots=True)
class FleetAuthority:
    """Authority that signs certificates and rosters."""

    tls: TlsAuthority
    roster_key: bytes

    @property
    def public_key(self) -> str:
        """Public key that identifies the authority to members."""
        return public_key_hex_of(self.roster_key)


@dataclass(slots=True)
class PkiFolder:
    """Content of the folder. Each operation also updates the folders of all members."""

    folder: Path
    roster: Roster
    authority_list: list[FleetAuthority]
    now: datetime

    @classmethod
    def create_fleet(cls, folder: Path, fleet_name: str, now: datetime) -> "PkiFolder":
        """Create a fleet with an authority. Raises LeewayError if the folder holds a fleet."""
        require_valid_name("fleet", fleet_name)
        if (folder / ROSTER_FILE).exists():
            raise LeewayError(f"{folder}: holds a fleet already")
        make_private_folder(folder)
        created = cls(folder, Roster(fleet=fleet_name, number=1, members=[]), [], now)
        created._create_and_store_authority()
        created._write_roster_and_member_folders()
        return created

    @classmethod
    def read(cls, folder: Path, now: datetime) -> "PkiFolder":
        """Read an existing folder. Raises LeewayError with the invalid file."""
        path = folder / ROSTER_FILE
        roster = roster_from_toml(read_file_bytes(path), str(path))
        numbers = sorted(
            int(p.name) for p in (folder / AUTHORITY_FOLDER).iterdir() if p.name.isdecimal()
        )
        authority_list = [_read_authority(folder / AUTHORITY_FOLDER / str(n)) for n in numbers]
        if not authority_list:
            raise LeewayError(f"{folder / AUTHORITY_FOLDER}: no authority")
        newest = _newer_signed_roster(folder / ROSTER, roster, authority_list)
        return cls(folder, newest or roster, authority_list, now)

    # --- operations ----------------------------------------------------------------------------

    def add_member(self, name: str, role: Role, validity_days: int, address: str) -> None:
        """Add a member with new keys; a revoked member may be added again."""
        self.add_members([name], role, validity_days, address)

    def add_members(
        self, names: Sequence[str], role: Role, validity_days: int, address: str = ""
    ) -> None:
        """Add members of one role with one roster. Raises LeewayError before any change."""
        if address and role not in SERVERS:
            raise LeewayError(f"--address: a {role.value} has no address, expected none")
        if role is Role.ROUTER and not address:
            raise LeewayError("--address: expected HOST:PORT of the router")
        if address and len(names) > 1:
            raise LeewayError(f"--address {address}: expected one member at an address")
        for at, name in enumerate(names):
            require_valid_name("member", name)
            known = self.roster.member_by_name.get(name)
            if known is not None and not known.revoked:
                raise LeewayError(f"{name}: on the roster already, as {known.role.value}")
            if name in names[:at]:
                raise LeewayError(f"{name}: named twice")
        created = [
            self._create_member_keys_and_certificate(name, role, validity_days, address)
            for name in names
        ]
        self._write_new_roster_with_members(
            [m for m in self.roster.members if m.name not in names] + created
        )

    def _create_member_keys_and_certificate(
        self, name: str, role: Role, validity_days: int, address: str
    ) -> RosterMember:
        """Create a member's keys and certificate in its folder."""
        home = self.folder / MEMBERS_FOLDER / name
        make_private_folder(home)
        signing, tls = generate_private_key(), TlsKey.generate()
        member = _build_validated_member(
            name=name,
            role=role,
            key=public_key_hex_of(signing),
            not_after=self._expiry_after(validity_days),
            address=address,
        )
        write_file_atomically(home / SIGNING_KEY, f"{signing.hex()}\n".encode(), PRIVATE_MODE)
        write_file_atomically(home / TLS_KEY, tls.private_key_pem, PRIVATE_MODE)
        self._sign_and_write_certificate(member, tls.private.public_key())
        return member

    def renew_member_certificates(self, names: Sequence[str], validity_days: int) -> None:
        """Extend members' certificates with the same keys and one roster; connections continue."""
        new: dict[str, RosterMember] = {}
        for old in [self._require_active_member(name) for name in names]:
            member = msgspec.structs.replace(old, not_after=self._expiry_after(validity_days))
            path = self.folder / MEMBERS_FOLDER / old.name / TLS_CERTIFICATE
            self._sign_and_write_certificate(
                member, public_key_of_certificate(read_file_bytes(path), str(path))
            )
            new[old.name] = member
        self._write_new_roster_with_members([new.get(m.name, m) for m in self.roster.members])

    def names_of_members_expiring_within(self, days: int) -> list[str]:
        """Return members whose certificates end within this number of days, or have ended."""
        until = self.now + timedelta(days=days)
        return [m.name for m in self.roster.members if not m.revoked and m.not_after <= until]

    def revoke_members(self, *member_names: str) -> None:
        """Revoke members: others reject them as soon as they have the new roster."""
        revoked_members = {
            name: msgspec.structs.replace(
                self._require_active_member(name),
                revoked=True,
                revoked_since=self.roster.number + 1,
            )
            for name in member_names
        }
        self._write_new_roster_with_members(
            [revoked_members.get(m.name, m) for m in self.roster.members]
        )

    def add_second_authority(self) -> None:
        """Add a second authority: both are valid until `remove_oldest_authority`."""
        if len(self.authority_list) > 1:
            raise LeewayError("two authorities: run `ground-station pki rotate --finish` first")
        self._create_and_store_authority()
        self._write_new_roster_with_members(self.roster.members)

    def remove_oldest_authority(self) -> None:
        """Remove the older authority. Raises LeewayError if it is the only one."""
        if len(self.authority_list) < 2:
            raise LeewayError("one authority only: run `ground-station pki rotate` first")
        oldest = min((self.folder / AUTHORITY_FOLDER).iterdir(), key=lambda path: int(path.name))
        for file in oldest.iterdir():
            file.unlink()
        oldest.rmdir()
        self.authority_list = self.authority_list[1:]
        self._write_new_roster_with_members(self.roster.members)

    # --- parts ---------------------------------------------------------------------------------

    def _require_active_member(self, name: str) -> RosterMember:
        found = self.roster.member_by_name.get(name)
        if found is None or found.revoked:
            raise LeewayError(f"{name}: {'revoked' if found else 'not on the roster'}")
        return found

    def _expiry_after(self, days: int) -> datetime:
        return (self.now + timedelta(days=days)).replace(microsecond=0)

    def _sign_and_write_certificate(self, member: RosterMember, public_key: object) -> None:
        """Sign with the newest authority."""
        tls = self.authority_list[-1].tls
        pem = tls.sign_member_certificate(self.roster.fleet, member, public_key, self.now)  # pyright: ignore
        write_file_atomically(
            self.folder / MEMBERS_FOLDER / member.name / TLS_CERTIFICATE, pem, PUBLIC_MODE
        )

    def _create_and_store_authority(self) -> None:
        number = len(self.authority_list) + 1
        while (self.folder / AUTHORITY_FOLDER / str(number)).exists():
            number += 1
        home = self.folder / AUTHORITY_FOLDER / str(number)
        make_private_folder(home)
        created = FleetAuthority(
            TlsAuthority.generate(self.roster.fleet, self.now), generate_private_key()
        )
        write_file_atomically(home / TLS_KEY, created.tls.key.private_key_pem, PRIVATE_MODE)
        write_file_atomically(home / TLS_CERTIFICATE, created.tls.certificate_pem, PUBLIC_MODE)
        write_file_atomically(
            home / ROSTER_KEY_FILE, f"{created.roster_key.hex()}\n".encode(), PRIVATE_MODE
        )
        self.authority_list = [*self.authority_list, created]

    def _write_new_roster_with_members(self, members: list[RosterMember]) -> None:
        number = self.roster.number + 1
        self.roster = msgspec.structs.replace(self.roster, number=number, members=members)
        self._write_roster_and_member_folders()

    def _write_roster_and_member_folders(self) -> None:
        """Write roster, then members' folders: after an interruption the old roster is in force."""
        text = roster_to_toml_text(self.roster)
        signed = msgspec.json.encode(self._sign_roster(text))
        write_file_atomically(self.folder / ROSTER_FILE, text.encode(), PUBLIC_MODE)
        write_file_atomically(self.folder / ROSTER, signed, PUBLIC_MODE)
        for member in self.roster.members:
            if not member.revoked:
                self._write_member_folder(member, signed)

    def _write_member_folder(self, member: RosterMember, signed_roster_bytes: bytes) -> None:
        home = self.folder / MEMBERS_FOLDER / member.name
        write_file_atomically(
            home / TLS_CA, b"".join(a.tls.certificate_pem for a in self.authority_list), PUBLIC_MODE
        )
        keys = ", ".join(f'"{authority.public_key}"' for authority in self.authority_list)
        lines = ['format = "identity/1"', f'fleet = "{self.roster.fleet}"']
        lines += [f'name = "{member.name}"', f"authorities = [{keys}]", ""]
        write_file_atomically(home / IDENTITY, "\n".join(lines).encode(), PUBLIC_MODE)
        write_file_atomically(
            home / ZENOH, member_zenoh_config_json(self.roster, member).encode(), PUBLIC_MODE
        )
        write_file_atomically(home / ROSTER, signed_roster_bytes, PUBLIC_MODE)

    def _sign_roster(self, roster_text: str) -> SignedRoster:
        raw, fleet = roster_text.encode(), self.roster.fleet
        return SignedRoster(
            roster=roster_text,
            signatures={
                one.public_key: sign_message(
                    one.roster_key, kind=ROSTER_KIND, fleet=fleet, signer=ROSTER_KIND, raw=raw
                ).hex()
                for one in self.authority_list
            },
        )


def _newer_signed_roster(
    path: Path, roster: Roster, authority_list: list[FleetAuthority]
) -> Roster | None:
    """Return the signed roster if it is newer: a folder restored from a backup continues with a
    member's copy.
    """
    if not path.exists():
        return None
    found = verify_roster(read_file_bytes(path), frozenset(a.public_key for a in authority_list))
    if isinstance(found, Refused):
        raise LeewayError(f"{path}: {found.reason}")
    return found[1] if found[1].fleet == roster.fleet and found[1].number > roster.number else None


def utc_datetime(epoch_us: int) -> datetime:
    """Convert a wall clock time to the time type of certificates."""
    return datetime.fromtimestamp(epoch_us / 1e6, UTC)


def _build_validated_member(**fields: object) -> RosterMember:
    try:
        return msgspec.convert({**fields}, RosterMember)
    except msgspec.ValidationError as error:
        raise LeewayError(f"{fields['name']}: {error}") from error


def _read_authority(home: Path) -> FleetAuthority:
    key, certificate = read_file_bytes(home / TLS_KEY), read_file_bytes(home / TLS_CERTIFICATE)
    tls = authority_from_pem(key, certificate, str(home))
    return FleetAuthority(tls, read_signing_key(home / ROSTER_KEY_FILE))


def make_private_folder(path: Path) -> None:
    """Create a folder that only its owner can enter."""
    try:
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.chmod(0o700)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
