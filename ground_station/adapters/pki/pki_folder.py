"""The folder from which a fleet's identities come: authorities, the roster, a folder a member.

PKI/roster.toml            the roster (`roster/1`); `pki` alone writes it
PKI/roster.json            the same, signed: members take it
PKI/authority/N/           keys of authority N; whoever has them can make members: keep it apart
PKI/members/NAME/          what NAME gets, whole; its private keys may be deleted here afterwards
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec

from companion.core.base.errors import LeewayError
from companion.fleet.identity import (
    IDENTITY,
    ROSTER,
    SIGNING_KEY,
    TLS_CERTIFICATE,
    ZENOH,
    read_bytes,
    read_signing_key,
)
from companion.fleet.roles import LISTENS, Role
from companion.fleet.roster import Roster, RosterMember, SignedRoster, roster_from_toml, roster_toml
from companion.fleet.signature import new_private_key, public_key_of, sign
from companion.fleet.topics import checked_name
from companion.fleet.trust import ROSTER_KIND
from ground_station.adapters.pki.access_rules import (
    TLS_AUTHORITIES,
    TLS_KEY,
    zenoh_json,
)
from ground_station.adapters.pki.certificates import (
    TlsAuthority,
    TlsKey,
    authority_from_pem,
    public_key_in,
)

ROSTER_TEXT, AUTHORITY, MEMBERS, ROSTER_KEY = "roster.toml", "authority", "members", "roster.key"
PRIVATE, PUBLIC = 0o600, 0o644


@dataclass(frozen=True, slots=True)
class FleetAuthority:
    """One authority: signs certificates, and rosters."""

    tls: TlsAuthority
    roster_key: bytes

    @property
    def name(self) -> str:
        """The public key that members know it by."""
        return public_key_of(self.roster_key)


@dataclass(slots=True)
class PkiFolder:
    """The folder, read. Each deed leaves it, and all members' folders, as they should be."""

    folder: Path
    roster: Roster
    authorities: list[FleetAuthority]
    now: datetime

    @classmethod
    def init(cls, folder: Path, fleet: str, now: datetime) -> "PkiFolder":
        """A new fleet with an authority of its own; LeewayError where the folder holds one."""
        checked_name("fleet", fleet)
        if (folder / ROSTER_TEXT).exists():
            raise LeewayError(f"{folder}: holds a fleet already")
        private_folder(folder)
        made = cls(folder, Roster(fleet=fleet, number=1, members=[]), [], now)
        made._new_authority()
        made._write()
        return made

    @classmethod
    def read(cls, folder: Path, now: datetime) -> "PkiFolder":
        """A folder that `init` made; LeewayError says which file is wrong."""
        path = folder / ROSTER_TEXT
        roster = roster_from_toml(read_bytes(path), str(path))
        numbers = sorted(int(p.name) for p in (folder / AUTHORITY).iterdir() if p.name.isdecimal())
        authorities = [_read_authority(folder / AUTHORITY / str(n)) for n in numbers]
        if not authorities:
            raise LeewayError(f"{folder / AUTHORITY}: no authority")
        return cls(folder, roster, authorities, now)

    # --- deeds ---------------------------------------------------------------------------------

    def add(self, name: str, role: Role, days: int, address: str) -> None:
        """A new member with fresh keys. One that is revoked may come again so."""
        self.add_all([name], role, days, address)

    def add_all(self, names: Sequence[str], role: Role, days: int, address: str = "") -> None:
        """New members of one role, all by one roster; LeewayError before anything is made."""
        self._check_address(role, address)
        if address and len(names) > 1:
            raise LeewayError(f"--address {address}: expected one member at an address")
        for at, name in enumerate(names):
            checked_name("member", name)
            known = self.roster.by_name.get(name)
            if known is not None and not known.revoked:
                raise LeewayError(f"{name}: on the roster already, as {known.role.value}")
            if name in names[:at]:
                raise LeewayError(f"{name}: named twice")
        made = [self._made(name, role, days, address) for name in names]
        self._put([m for m in self.roster.members if m.name not in names] + made)

    def _made(self, name: str, role: Role, days: int, address: str) -> RosterMember:
        """A member's keys and certificate, in its folder."""
        home = self.folder / MEMBERS / name
        private_folder(home)
        signing, tls = new_private_key(), TlsKey.new()
        member = _checked_member(
            name=name,
            role=role,
            key=public_key_of(signing),
            not_after=self._until(days),
            address=address,
        )
        write_file(home / SIGNING_KEY, f"{signing.hex()}\n".encode(), PRIVATE)
        write_file(home / TLS_KEY, tls.pem, PRIVATE)
        self._certify(member, tls.private.public_key())
        return member

    def renew(self, name: str, days: int) -> None:
        """The same keys for longer: what flies with them is not cut."""
        self.renew_all([name], days)

    def renew_all(self, names: Sequence[str], days: int) -> None:
        """Several members' certificates for longer, by one roster."""
        new: dict[str, RosterMember] = {}
        for old in [self._member(name) for name in names]:
            member = msgspec.structs.replace(old, not_after=self._until(days))
            path = self.folder / MEMBERS / old.name / TLS_CERTIFICATE
            self._certify(member, public_key_in(read_bytes(path), str(path)))
            new[old.name] = member
        self._put([new.get(m.name, m) for m in self.roster.members])

    def ending_within(self, days: int) -> list[str]:
        """Members whose certificates end within so many days, or have ended."""
        until = self.now + timedelta(days=days)
        return [m.name for m in self.roster.members if not m.revoked and m.not_after <= until]

    def revoke(self, *names: str) -> None:
        """Nobody believes them from the moment that they have the new roster."""
        gone = {name: msgspec.structs.replace(self._member(name), revoked=True) for name in names}
        self._put([gone.get(m.name, m) for m in self.roster.members])

    def rotate(self) -> None:
        """A second authority beside the first: both count until `retire`."""
        if len(self.authorities) > 1:
            raise LeewayError("two authorities count already: expected `retire` first")
        self._new_authority()
        self._put(self.roster.members)

    def retire(self) -> None:
        """The older authority counts no more; LeewayError where it is the only one."""
        if len(self.authorities) < 2:
            raise LeewayError("one authority only: expected `rotate` first")
        oldest = min((self.folder / AUTHORITY).iterdir(), key=lambda path: int(path.name))
        for file in oldest.iterdir():
            file.unlink()
        oldest.rmdir()
        self.authorities = self.authorities[1:]
        self._put(self.roster.members)

    # --- parts ---------------------------------------------------------------------------------

    def _member(self, name: str) -> RosterMember:
        found = self.roster.by_name.get(name)
        if found is None or found.revoked:
            raise LeewayError(f"{name}: {'revoked' if found else 'not on the roster'}")
        return found

    def _check_address(self, role: Role, address: str) -> None:
        if address and role not in LISTENS:
            raise LeewayError(f"--address: a {role.value} is called by nobody")
        if role is Role.ROUTER and not address:
            raise LeewayError("--address: expected HOST:PORT, where the others find the router")

    def _until(self, days: int) -> datetime:
        return (self.now + timedelta(days=days)).replace(microsecond=0)

    def _certify(self, member: RosterMember, public: object) -> None:
        """By the newest authority."""
        tls = self.authorities[-1].tls
        pem = tls.certify(self.roster.fleet, member, public, self.now)  # pyright: ignore
        write_file(self.folder / MEMBERS / member.name / TLS_CERTIFICATE, pem, PUBLIC)

    def _new_authority(self) -> None:
        number = len(self.authorities) + 1
        while (self.folder / AUTHORITY / str(number)).exists():
            number += 1
        home = self.folder / AUTHORITY / str(number)
        private_folder(home)
        made = FleetAuthority(TlsAuthority.new(self.roster.fleet, self.now), new_private_key())
        write_file(home / TLS_KEY, made.tls.key.pem, PRIVATE)
        write_file(home / TLS_CERTIFICATE, made.tls.pem, PUBLIC)
        write_file(home / ROSTER_KEY, f"{made.roster_key.hex()}\n".encode(), PRIVATE)
        self.authorities = [*self.authorities, made]

    def _put(self, members: list[RosterMember]) -> None:
        number = self.roster.number + 1
        self.roster = msgspec.structs.replace(self.roster, number=number, members=members)
        self._write()

    def _write(self) -> None:
        """The roster last but for the members: cut before, the old one counts."""
        text = roster_toml(self.roster)
        signed = msgspec.json.encode(self._signed(text))
        write_file(self.folder / ROSTER_TEXT, text.encode(), PUBLIC)
        write_file(self.folder / ROSTER, signed, PUBLIC)
        for member in self.roster.members:
            if not member.revoked:
                self._write_member(member, signed)

    def _write_member(self, member: RosterMember, signed: bytes) -> None:
        home = self.folder / MEMBERS / member.name
        write_file(home / TLS_AUTHORITIES, b"".join(a.tls.pem for a in self.authorities), PUBLIC)
        write_file(home / IDENTITY, self._identity(member).encode(), PUBLIC)
        write_file(home / ZENOH, zenoh_json(self.roster, member).encode(), PUBLIC)
        write_file(home / ROSTER, signed, PUBLIC)

    def _identity(self, member: RosterMember) -> str:
        keys = ", ".join(f'"{authority.name}"' for authority in self.authorities)
        lines = ['format = "identity/1"', f'fleet = "{self.roster.fleet}"']
        return "\n".join([*lines, f'name = "{member.name}"', f"authorities = [{keys}]", ""])

    def _signed(self, text: str) -> SignedRoster:
        raw, fleet = text.encode(), self.roster.fleet
        return SignedRoster(
            roster=text,
            signatures={
                one.name: sign(
                    one.roster_key, kind=ROSTER_KIND, fleet=fleet, signer=ROSTER_KIND, raw=raw
                ).hex()
                for one in self.authorities
            },
        )


def utc_at(epoch_us: int) -> datetime:
    """A wall clock's time as certificates name it."""
    return datetime.fromtimestamp(epoch_us / 1e6, UTC)


def _checked_member(**fields: object) -> RosterMember:
    try:
        return msgspec.convert({**fields}, RosterMember)
    except msgspec.ValidationError as error:
        raise LeewayError(f"{fields['name']}: {error}") from error


def _read_authority(home: Path) -> FleetAuthority:
    key, certificate = read_bytes(home / TLS_KEY), read_bytes(home / TLS_CERTIFICATE)
    tls = authority_from_pem(key, certificate, str(home))
    return FleetAuthority(tls, read_signing_key(home / ROSTER_KEY))


def private_folder(path: Path) -> None:
    """Make a folder that its owner alone may enter."""
    try:
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.chmod(0o700)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error


def write_file(path: Path, content: bytes, mode: int) -> None:
    """Write a file whole or not at all, and never for a moment readable by others."""
    fresh = path.with_name(f"{path.name}.new")
    try:
        fresh.unlink(missing_ok=True)
        descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
