"""Tokens of the people who may use the map: kept as digests, never as they are.

A token has 256 random bits, so a plain SHA-256 of it can be neither guessed nor looked up.
"""

import hashlib
import hmac
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError
from companion.fleet.roles import COMMANDS, Role
from ground_station.core.people.person import Person, person_of

ROLES = (Role.SUPERVISOR, Role.DISPATCHER, Role.VIEWER)
"""Of a person; only the last may order nothing."""

TOKEN_BYTES = 32
FORMAT = "map-tokens/1"
Sha256 = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")]


class TokenHolder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A named user of the map. `made`: on which day, for people."""

    name: str
    role: Literal["supervisor", "dispatcher", "viewer"]
    sha256: Sha256
    made: Annotated[str, Meta(max_length=10)]

    @property
    def person(self) -> Person:
        """Who acts with this token. Raises LeewayError for an impossible name."""
        return Person(person_of(self.name).name, Role(self.role))


class TokenBook(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All holders of tokens (`map-tokens/1`)."""

    format: Literal["map-tokens/1"] = FORMAT
    people: tuple[TokenHolder, ...] = ()

    def person(self, token: str) -> Person | None:
        """Whose token this is; None: nobody's."""
        digest = digest_of(token)
        found = [one for one in self.people if hmac.compare_digest(one.sha256, digest)]
        return found[0].person if found else None

    def added(self, name: str, role: Role, token: str, made: str) -> "TokenBook":
        """With one more. Raises LeewayError where the name has a token, or is none."""
        if role not in ROLES:
            raise LeewayError(f"role {role.value}: expected {' or '.join(r.value for r in ROLES)}")
        if any(one.name == name for one in self.people):
            raise LeewayError(f"{name} has a token: revoke it first")
        sha256 = digest_of(token)
        holder = TokenHolder(name=person_of(name).name, role=role.value, sha256=sha256, made=made)
        return TokenBook(people=(*self.people, holder))

    def without(self, name: str) -> "TokenBook":
        """Without this one's. Raises LeewayError where there is none."""
        if all(one.name != name for one in self.people):
            known = ", ".join(one.name for one in self.people) or "nobody"
            raise LeewayError(f"{name} has no token; these have: {known}")
        return TokenBook(people=tuple(one for one in self.people if one.name != name))


def digest_of(token: str) -> str:
    """SHA-256 of a token, hexadecimal."""
    return hashlib.sha256(token.encode()).hexdigest()


def deed_trouble(person: Person) -> str:
    """Why this person may order nothing; empty: they may."""
    if person.role in COMMANDS:
        return ""
    return f"{person.name} is a {person.role.value}: may not command"
