"""Members of a fleet and their permissions: `roster/1`, also in a form signed by an authority."""

import hashlib
import re
from collections.abc import Mapping
from datetime import datetime
from enum import Enum
from functools import cached_property
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.core.base.documents import parse_toml
from companion.core.base.errors import LeewayError
from companion.core.base.wire_message import Key, Name
from companion.fleet.messages import Refused
from companion.fleet.roles import NEIGHBOURS, Role

MAX_ROSTER_BYTES = 1 << 20
"""Some 5,000 members of 200 bytes."""

WARN_DAYS = 30
"""A month: enough time to deliver a new certificate to a vehicle at another site."""

Address = Annotated[str, Meta(max_length=260, pattern=r"^([A-Za-z0-9.:\[\]-]+:[0-9]{1,5})?\Z")]


class RosterMember(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One member: a machine or a person."""

    name: Name
    """Its name; a vehicle's is its name in flight, a neighbour's is its fleet's."""
    role: Role
    """Its role, which determines its permissions."""
    key: Key
    """Public half of the Ed25519 key that it signs messages with, 64 hex digits."""
    not_after: Annotated[datetime, Meta(tz=True)]
    """End of its certificate."""
    revoked: bool = False
    """Nothing that it signs is accepted any more."""
    revoked_since: Annotated[int, Meta(ge=0)] = 0
    """Number of the roster that revoked it; 0: not revoked, or not known."""
    address: Address = ""
    """Of a desk or router: HOST:PORT for connections from other members."""

    @property
    def revocation_text(self) -> str:
        """Who is revoked, and since which roster."""
        since = f" since roster {self.revoked_since}" if self.revoked_since else ""
        return f"{self.name} is revoked{since}"

    @property
    def certificate_end_us(self) -> int:
        """The end of the certificate in microseconds since 1970."""
        return round(self.not_after.timestamp() * 1e6)


class Roster(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, dict=True):
    """A `roster/1` file: the members of one fleet. `ground-station pki` writes it."""

    format: Literal["roster/1"] = "roster/1"
    """The format's name."""
    fleet: Name
    """The fleet's name."""
    number: Annotated[int, Meta(ge=1)]
    """Increases with each change: the roster with the higher number is in force."""
    members: list[RosterMember] = []
    """All members, including the revoked ones."""

    def __post_init__(self) -> None:
        if len(self.member_by_name) != len(self.members):
            raise LeewayError("members: expected each name once")

    @cached_property
    def member_by_name(self) -> Mapping[str, RosterMember]:
        """Members by name."""
        return {member.name: member for member in self.members}

    @property
    def neighbour_fleet_names(self) -> list[str]:
        """Fleets that are neighbours of this one."""
        return [m.name for m in self.members if m.role in NEIGHBOURS and not m.revoked]


class SignedRoster(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A roster as members forward and store it: the text of its file, with signatures."""

    format: Literal["signed-roster/1"] = "signed-roster/1"
    roster: Annotated[str, Meta(max_length=MAX_ROSTER_BYTES)]
    """The text of the `roster/1` file."""
    signatures: dict[Key, Annotated[str, Meta(pattern=r"^[0-9a-f]{128}\Z")]]
    """Signature by public key of each authority that signed it."""


def roster_from_toml(raw: bytes, error_location: str) -> Roster:
    """Validate a roster; LeewayError names the file."""
    try:
        return msgspec.convert(parse_toml(raw, error_location), Roster)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{error_location}: {error}") from error


def roster_to_toml_text(roster: Roster) -> str:
    """Return the text of a roster's file. It has names, numbers and dates only, without escapes."""
    lines = [
        f'format = "{roster.format}"',
        f'fleet = "{roster.fleet}"',
        f"number = {roster.number}",
    ]
    for member in roster.members:
        lines += ["", "[[members]]", f'name = "{member.name}"', f'role = "{member.role.value}"']
        lines += [f'key = "{member.key}"', f"not_after = {member.not_after.isoformat()}"]
        lines += [f"revoked = {str(member.revoked).lower()}"]
        lines += [f"revoked_since = {member.revoked_since}"] if member.revoked_since else []
        lines += [f'address = "{member.address}"'] if member.address else []
    return "\n".join(lines) + "\n"


_FLEET_LINE = re.compile(r'^fleet = "([a-z0-9][a-z0-9_-]{0,31})"$', re.MULTILINE)
_FLEET_LINE_MAX_OFFSET = 2000  # characters


def decode_signed_roster_and_fleet_name(raw: bytes) -> tuple[SignedRoster, str] | Refused:
    """Decode a signed roster without parsing its text, and find the fleet named in the text.

    The text is parsed only after its signature was verified: TOML can take minutes to parse.
    """
    if len(raw) > 2 * MAX_ROSTER_BYTES:
        return Refused(f"roster: {len(raw)} bytes")
    try:
        signed = msgspec.json.decode(raw, type=SignedRoster)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        return Refused(f"roster: {error}"[:300])
    named = _FLEET_LINE.search(signed.roster[:_FLEET_LINE_MAX_OFFSET])
    return (signed, named[1]) if named else Refused("roster: expected a line with the fleet's name")


def parse_verified_roster(signed: SignedRoster, fleet: str) -> Roster | Refused:
    """Parse the text of a roster whose signature for this fleet was verified."""
    try:
        roster = roster_from_toml(signed.roster.encode(), "roster")
    except (LeewayError, UnicodeError, RecursionError) as error:
        return Refused(f"roster: {error}"[:300])
    if roster.fleet != fleet:
        return Refused(f"roster: of fleet {roster.fleet}")
    return roster


class RosterDifference(Enum):
    """How one roster differs from another."""

    NONE = "the same"
    NEWER = "a successor"
    ROLLBACK = "a predecessor"
    FORK = "a fork"


def roster_stamp_of(number: int, signed: SignedRoster) -> str:
    """Return a roster's number and the hash of its text."""
    return f"{number}:{hashlib.sha256(signed.roster.encode()).hexdigest()[:16]}"


def roster_difference(stamp: str, reference: str) -> RosterDifference:
    """Return how the roster of `stamp` differs from that of `reference`."""
    number, reference_number = (int(one.partition(":")[0]) for one in (stamp, reference))
    if number != reference_number:
        newer = number > reference_number
        return RosterDifference.NEWER if newer else RosterDifference.ROLLBACK
    return RosterDifference.NONE if stamp == reference else RosterDifference.FORK
