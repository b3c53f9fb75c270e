"""The people of a desk: a name and a role, made in one place."""

import re
from dataclasses import dataclass
from enum import Enum

from companion.core.base.errors import LeewayError

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,39}\Z")
"""As login names and mail addresses are; it fits into `Command.by` behind `desk/`."""


class Role(Enum):
    """What a person may do; each may also do what the one before may."""

    VIEWER = "viewer"
    DISPATCHER = "dispatcher"
    SUPERVISOR = "supervisor"


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody who acts at a desk, under the name that the audit keeps."""

    name: str
    role: Role


def person_of(name: str, role: Role = Role.SUPERVISOR) -> Person:
    """A person by name. Without identities on the network whoever has the machine may do all."""
    if NAME.match(name) is None:
        raise LeewayError(f"user {name!r}: expected 1 to 40 letters, digits and . _ @ -")
    return Person(name, role)


def desk_of(person: Person) -> str:
    """What a desk that this person has started signs its own decisions with."""
    return f"desk/{person.name}"
