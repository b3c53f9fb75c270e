"""`companion signing provision`: shared signing key of autopilot and companion."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="MAVLink message signing.")


@app.callback()
def signing() -> None:
    """MAVLink message signing: messages without the key are rejected."""


@app.command()
def provision(
    link: Annotated[
        str,
        typer.Option(
            help="Link to the autopilot. Use a cable or a private network: the key is sent"
            " unencrypted."
        ),
    ],
    key: Annotated[
        Path, typer.Option(help="Key file (mode 0600); created with a random key if missing.")
    ] = Path("signing.key"),
    system: Annotated[
        int | None,
        typer.Option(help="MAVLink system id of the vehicle; default: the only one."),
    ] = None,
) -> None:
    """Write a signing key to a disarmed autopilot and verify it.

    companion signing provision --link serial:/dev/serial0:921600 --key /etc/leeway/signing.key
    """
    from companion.adapters.autopilots.link import open_link
    from companion.app.tools.provision_signing import Provisioning, read_or_create_key

    secret, is_new = read_or_create_key(key)
    typer.echo(f"{key}: {'created with a random key' if is_new else 'existing key'}, mode 0600")
    connection = open_link(link)
    try:
        system_id = Provisioning(connection).send_signing_key_and_verify(secret, system)
    finally:
        connection.close()
    typer.echo(f"system {system_id} signs with this key; fly with --signing-key {key}")
