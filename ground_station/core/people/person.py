"""The operators of a desk: a name and a role."""

import re
from dataclasses import dataclass

from companion.core.base.errors import LeewayError
from companion.fleet.roles import Role
from companion.fleet.trust import MEMBER_SEPARATOR

NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,39}\Z")
"""Pattern of login names and mail addresses; fits into `Command.by` after `desk/`."""

MAX_NAME_LENGTH = 59
"""Maximum length of a name with its member: the 64 characters of `Command.by`, less `desk/`."""


@dataclass(frozen=True, slots=True)
class DeskOperator:
    """An operator of a desk. `name`: as recorded in the audit; `role`: of the roster, if an
    identity proved it.
    """

    name: str
    role: Role


def local_supervisor_operator(name: str) -> DeskOperator:
    """Return an operator by name. Without network identities every user is a supervisor."""
    return DeskOperator(_validated_operator_name(name), Role.SUPERVISOR)


def member_operator(member: str, role: Role, claimed_user_name: str | None = None) -> DeskOperator:
    """Return the operator acting with this member's identity. A different claimed name is not
    proven: it precedes the member's proven name.
    """
    if claimed_user_name is None or claimed_user_name == member:
        return DeskOperator(member, role)
    name = f"{_validated_operator_name(claimed_user_name)}{MEMBER_SEPARATOR}{member}"
    if len(name) > MAX_NAME_LENGTH:
        max_length = MAX_NAME_LENGTH - len(MEMBER_SEPARATOR) - len(member)
        raise LeewayError(
            f"user {claimed_user_name!r}: expected at most {max_length} characters with {member}"
        )
    return DeskOperator(name, role)


def desk_signing_name(operator: DeskOperator) -> str:
    """Return the name with which a desk started by this operator signs its own decisions."""
    return operator.name if operator.role is Role.DESK else f"desk/{operator.name}"


def _validated_operator_name(name: str) -> str:
    if NAME_PATTERN.match(name) is None:
        raise LeewayError(f"user {name!r}: expected 1 to 40 letters, digits and . _ @ -")
    return name
