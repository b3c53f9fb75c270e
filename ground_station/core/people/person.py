"""The people of a desk: a name and a role, made in one place."""

import re
from dataclasses import dataclass

from companion.core.base.errors import LeewayError
from companion.fleet.roles import Role

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,39}\Z")
"""As login names and mail addresses are; it fits into `Command.by` behind `desk/`."""

LONGEST = 59
"""Of a name and the member behind it: the 64 characters of `Command.by`, less `desk/`."""

BY_WAY_OF = " by way of "
"""As vehicles tell it (`companion.fleet.member`): who is said, and behind it who signed."""


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody who acts at a desk. `name` is as the audit keeps it; the role is the roster's where
    an identity proved it.
    """

    name: str
    role: Role


def person_of(name: str) -> Person:
    """A person by name. Without identities on the network whoever has the machine may do all."""
    return Person(_checked(name), Role.SUPERVISOR)


def person_behind(member: str, role: Role, said: str | None = None) -> Person:
    """Who acts with the identity of this member. Another name that was said is not proven: it
    stands before the member's, which is.
    """
    if said is None or said == member:
        return Person(member, role)
    name = f"{_checked(said)}{BY_WAY_OF}{member}"
    if len(name) > LONGEST:
        most = LONGEST - len(BY_WAY_OF) - len(member)
        raise LeewayError(f"user {said!r}: expected at most {most} characters beside {member}")
    return Person(name, role)


def desk_of(person: Person) -> str:
    """What a desk that this person has started signs its own decisions with."""
    return person.name if person.role is Role.DESK else f"desk/{person.name}"


def _checked(name: str) -> str:
    if NAME.match(name) is None:
        raise LeewayError(f"user {name!r}: expected 1 to 40 letters, digits and . _ @ -")
    return name
