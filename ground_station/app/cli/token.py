"""`ground-station token`: who may use the map, and order from it."""

from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.fleet.roles import Role
from ground_station.adapters.clock import epoch_us

app = typer.Typer(
    no_args_is_help=True,
    help=(
        "Give people tokens for the map, and take them back.\n\n"
        "ground-station token add anna --role dispatcher"
    ),
)


class MapRole(StrEnum):
    """What a person may do on the map (`web_tokens.ROLES`)."""

    SUPERVISOR = "supervisor"
    DISPATCHER = "dispatcher"
    VIEWER = "viewer"


DEFAULT_TOKENS = Path("leeway-map-tokens.json")
TokensFile = Annotated[
    Path, typer.Option("--tokens", help="The file of the tokens' digests (mode 0600).")
]


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="Who gets it, as the audit will name them.")],
    role: Annotated[
        MapRole,
        typer.Option(metavar="ROLE", help="supervisor and dispatcher may order; viewer may look."),
    ] = MapRole.DISPATCHER,
    tokens: TokensFile = DEFAULT_TOKENS,
) -> None:
    """Make a token and print it, once: the file keeps only its SHA-256.

    ground-station token add anna --role dispatcher
    """
    from ground_station.adapters.files.token_file import new_token, read_tokens, write_tokens
    from ground_station.core.people.web_tokens import TokenBook

    book = read_tokens(tokens) if tokens.exists() else TokenBook()
    token, today = new_token(), f"{datetime.fromtimestamp(epoch_us() / 1e6, tz=UTC):%Y-%m-%d}"
    write_tokens(tokens, book.added(name, Role(role), token, today))
    typer.echo(token)
    typer.echo(f"the token of {name}, {role}: it is not shown again", err=True)


@app.command()
def revoke(
    name: Annotated[str, typer.Argument(help="Whose token.")],
    tokens: TokensFile = DEFAULT_TOKENS,
) -> None:
    """Take a token back: a map that runs lets it in no longer than a second.

    ground-station token revoke anna
    """
    from ground_station.adapters.files.token_file import read_tokens, write_tokens

    write_tokens(tokens, read_tokens(tokens).without(name))
    typer.echo(f"revoked: {name}")


@app.command(name="list")
def list_(tokens: TokensFile = DEFAULT_TOKENS) -> None:
    """List who has a token."""
    from ground_station.adapters.files.token_file import read_tokens
    from ground_station.app.views.terminal import listing, terminal

    table = listing("name", "role", "made")
    for one in read_tokens(tokens).people:
        table.add_row(one.name, one.role, one.made)
    terminal().print(table)
