"""`ground-station token`: access to the live map."""

from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.roles import Role
from ground_station.adapters.clock import epoch_us

app = typer.Typer()

DEFAULT_TOKENS = Path("leeway-map-tokens.json")
TokensFile = Annotated[
    Path, typer.Option("--tokens", help="File of the tokens' digests (mode 0600).")
]


class TokenAction(StrEnum):
    """What to do with the tokens."""

    ADD = "add"
    REVOKE = "revoke"
    LIST = "list"


class MapRole(StrEnum):
    """Permission of a person on the map (`web_tokens.USER_ROLES`)."""

    SUPERVISOR = "supervisor"
    DISPATCHER = "dispatcher"
    VIEWER = "viewer"


@app.command()
def token(
    action: Annotated[TokenAction, typer.Argument(help="Add, revoke or list tokens.")],
    name: Annotated[
        str | None, typer.Argument(help="add, revoke: the person, as named in the audit.")
    ] = None,
    role: Annotated[
        MapRole,
        typer.Option(
            metavar="ROLE", help="add: supervisor and dispatcher may command; viewer may read."
        ),
    ] = MapRole.DISPATCHER,
    tokens: TokensFile = DEFAULT_TOKENS,
) -> None:
    """Manage access to the live map by tokens.

    `add` prints the token once: the file contains its SHA-256 only. A running map applies `revoke`
    within a second.

    ground-station token add anna --role dispatcher
    ground-station token revoke anna
    ground-station token list
    """
    from ground_station.adapters.files.token_file import (
        generate_random_token,
        read_owner_only_tokens,
        write_owner_only_tokens_atomically,
    )
    from ground_station.app.views.terminal import plain_console, plain_table
    from ground_station.core.people.web_tokens import TokenRegistry

    if (name is None) != (action is TokenAction.LIST):
        raise LeewayError("token: expected `add NAME`, `revoke NAME` or `list`")
    if name is None:
        table = plain_table("name", "role", "made")
        for one in read_owner_only_tokens(tokens).holders:
            table.add_row(one.name, one.role, one.created)
        plain_console().print(table)
    elif action is TokenAction.REVOKE:
        write_owner_only_tokens_atomically(
            tokens, read_owner_only_tokens(tokens).without_holder(name)
        )
        typer.echo(f"revoked: {name}")
    else:
        registry = read_owner_only_tokens(tokens) if tokens.exists() else TokenRegistry()
        secret, today = (
            generate_random_token(),
            f"{datetime.fromtimestamp(epoch_us() / 1e6, tz=UTC):%Y-%m-%d}",
        )
        write_owner_only_tokens_atomically(
            tokens, registry.with_holder(name, Role(role), secret, today)
        )
        typer.echo(secret)
        typer.echo(f"token of {name}, {role}: not shown again", err=True)
