"""Tokens of the users of the map, stored as digests only.

A token has 256 random bits, so its plain SHA-256 can be neither guessed nor looked up.
"""

import hashlib
import hmac
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError
from companion.fleet.roles import COMMANDERS, Role
from ground_station.core.people.person import DeskOperator, local_supervisor_operator

USER_ROLES = (Role.SUPERVISOR, Role.DISPATCHER, Role.VIEWER)
"""Roles of users; a viewer may not command."""

TOKEN_BYTES = 32
FORMAT = "map-tokens/1"
Sha256 = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")]


class TokenHolder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A named user of the map. `created`: day of issue, for display."""

    name: str
    role: Literal["supervisor", "dispatcher", "viewer"]
    sha256: Sha256
    created: Annotated[str, Meta(max_length=10)] = msgspec.field(name="made")

    @property
    def operator(self) -> DeskOperator:
        """The operator of this token. Raises LeewayError for an invalid name."""
        return DeskOperator(local_supervisor_operator(self.name).name, Role(self.role))


class TokenRegistry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All token holders (`map-tokens/1`)."""

    format: Literal["map-tokens/1"] = FORMAT
    holders: tuple[TokenHolder, ...] = msgspec.field(default=(), name="people")

    def find_operator(self, token: str) -> DeskOperator | None:
        """Return the operator with this token; None: unknown token."""
        digest = token_digest(token)
        found = [one for one in self.holders if hmac.compare_digest(one.sha256, digest)]
        return found[0].operator if found else None

    def with_holder(self, name: str, role: Role, token: str, created: str) -> "TokenRegistry":
        """Return the list with one more. Raises LeewayError for an invalid or existing name."""
        if role not in USER_ROLES:
            raise LeewayError(
                f"role {role.value}: expected {' or '.join(r.value for r in USER_ROLES)}"
            )
        if any(one.name == name for one in self.holders):
            raise LeewayError(f"{name} has a token: revoke it first")
        sha256 = token_digest(token)
        holder = TokenHolder(
            name=local_supervisor_operator(name).name,
            role=role.value,
            sha256=sha256,
            created=created,
        )
        return TokenRegistry(holders=(*self.holders, holder))

    def without_holder(self, name: str) -> "TokenRegistry":
        """Return the list without this holder. Raises LeewayError if there is none."""
        if all(one.name != name for one in self.holders):
            known = ", ".join(one.name for one in self.holders) or "none"
            raise LeewayError(f"{name} has no token; token holders: {known}")
        return TokenRegistry(holders=tuple(one for one in self.holders if one.name != name))


def token_digest(token: str) -> str:
    """Return the SHA-256 of a token, hexadecimal."""
    return hashlib.sha256(token.encode()).hexdigest()


def command_refusal_reason(operator: DeskOperator) -> str:
    """Return the refusal of a command by this operator; empty: permitted."""
    if operator.role in COMMANDERS:
        return ""
    return f"{operator.name} is a {operator.role.value}: may not command"
