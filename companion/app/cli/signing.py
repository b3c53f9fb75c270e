"""`companion signing provision`: a key for autopilot and companion."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="MAVLink message signing.")


@app.callback()
def signing() -> None:
    """MAVLink message signing: who does not have the key is not heard."""


@app.command()
def provision(
    link: Annotated[
        str,
        typer.Option(
            help="The autopilot, by a wire or a network that nobody else hears: the key goes in the"
            " clear."
        ),
    ],
    key: Annotated[
        Path, typer.Option(help="The key's file; made at random, for its owner only, if missing.")
    ] = Path("signing.key"),
    system: Annotated[
        int | None, typer.Option(help="MAVLink system id of the vehicle; default: the first heard.")
    ] = None,
) -> None:
    """Give a disarmed autopilot a signing key, and see that it signs with it.

    companion signing provision --link serial:/dev/serial0:921600 --key /etc/leeway/signing.key
    """
    from companion.adapters.autopilots.link import open_link
    from companion.app.tools.provision_signing import Provisioning, key_of

    secret, is_new = key_of(key)
    typer.echo(f"{key}: {'made at random' if is_new else 'used as it is'}, mode 0600")
    opened = open_link(link)
    try:
        found = Provisioning(opened).provision(secret, system)
    finally:
        opened.close()
    typer.echo(f"system {found} signs with it; fly with --signing-key {key}")
