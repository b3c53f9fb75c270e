"""Who belongs to a fleet and what each may do: `roster/1`, and the same signed by an authority."""

import re
from collections.abc import Mapping
from datetime import datetime
from functools import cached_property
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.core.base.documents import toml_table
from companion.core.base.errors import LeewayError
from companion.core.base.wire_message import Key, Name
from companion.fleet.messages import Refused
from companion.fleet.roles import NEIGHBOURS, Role

LARGEST_ROSTER_BYTES = 1 << 20
"""Some 5,000 members of 200 bytes."""

WARN_DAYS = 30
"""A month: time enough to bring a new certificate to a vehicle that is away."""

Address = Annotated[str, Meta(max_length=260, pattern=r"^([A-Za-z0-9.:\[\]-]+:[0-9]{1,5})?\Z")]


class RosterMember(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One member: a machine or a person."""

    name: Name
    """Its name; a vehicle's is the one that it flies under, a neighbour's its fleet's."""
    role: Role
    """What it may do."""
    key: Key
    """Public half of the Ed25519 key that it signs messages with, 64 hex digits."""
    not_after: Annotated[datetime, Meta(tz=True)]
    """When its certificate ends."""
    revoked: bool = False
    """Nothing that it signs is believed any more."""
    address: Address = ""
    """Of a desk or router: HOST:PORT at which the others find it."""

    @property
    def not_after_us(self) -> int:
        """The same in microseconds since 1970."""
        return round(self.not_after.timestamp() * 1e6)


class Roster(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, dict=True):
    """A `roster/1` file: the members of one fleet. `ground-station pki` writes it."""

    format: Literal["roster/1"] = "roster/1"
    """The format's name."""
    fleet: Name
    """The fleet's name."""
    number: Annotated[int, Meta(ge=1)]
    """Counts up with each change: of two rosters the higher number is in force."""
    members: list[RosterMember] = []
    """Everybody, the revoked too."""

    def __post_init__(self) -> None:
        if len(self.by_name) != len(self.members):
            raise LeewayError("members: expected each name once")

    @cached_property
    def by_name(self) -> Mapping[str, RosterMember]:
        """Members by name."""
        return {member.name: member for member in self.members}

    @property
    def neighbours(self) -> list[str]:
        """Fleets that are neighbours of this one."""
        return [m.name for m in self.members if m.role in NEIGHBOURS and not m.revoked]


class SignedRoster(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A roster as members pass it on and keep it: the text of its file, with signatures."""

    format: Literal["signed-roster/1"] = "signed-roster/1"
    roster: Annotated[str, Meta(max_length=LARGEST_ROSTER_BYTES)]
    """The text of the `roster/1` file."""
    signatures: dict[Key, Annotated[str, Meta(pattern=r"^[0-9a-f]{128}\Z")]]
    """By the public key of each authority that signed it."""


def roster_from_toml(raw: bytes, where: str) -> Roster:
    """Check a roster; LeewayError names the file."""
    try:
        return msgspec.convert(toml_table(raw, where), Roster)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{where}: {error}") from error


def roster_toml(roster: Roster) -> str:
    """The text of a roster's file. Names, numbers and dates only: nothing needs an escape."""
    lines = [
        f'format = "{roster.format}"',
        f'fleet = "{roster.fleet}"',
        f"number = {roster.number}",
    ]
    for member in roster.members:
        lines += ["", "[[members]]", f'name = "{member.name}"', f'role = "{member.role.value}"']
        lines += [f'key = "{member.key}"', f"not_after = {member.not_after.isoformat()}"]
        lines += [f"revoked = {str(member.revoked).lower()}"]
        lines += [f'address = "{member.address}"'] if member.address else []
    return "\n".join(lines) + "\n"


_FLEET_LINE = re.compile(r'^fleet = "([a-z0-9][a-z0-9_-]{0,31})"$', re.MULTILINE)
_FLEET_WITHIN = 2000  # characters


def decode_signed_roster(raw: bytes) -> tuple[SignedRoster, str] | Refused:
    """Decode a signed roster, without its text, and find the fleet that the text names.

    The text is parsed only after its signature was verified: TOML can take minutes to parse.
    """
    if len(raw) > 2 * LARGEST_ROSTER_BYTES:
        return Refused(f"roster: {len(raw)} bytes")
    try:
        signed = msgspec.json.decode(raw, type=SignedRoster)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        return Refused(f"roster: {error}"[:300])
    named = _FLEET_LINE.search(signed.roster[:_FLEET_WITHIN])
    return (signed, named[1]) if named else Refused("roster: expected a line with the fleet's name")


def roster_of(signed: SignedRoster, fleet: str) -> Roster | Refused:
    """Parse the text of a roster whose signature for this fleet was verified."""
    try:
        roster = roster_from_toml(signed.roster.encode(), "roster")
    except (LeewayError, UnicodeError, RecursionError) as error:
        return Refused(f"roster: {error}"[:300])
    if roster.fleet != fleet:
        return Refused(f"roster: of fleet {roster.fleet}")
    return roster
