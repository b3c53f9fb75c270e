"""`ground-station pki`: identities of a fleet's members."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.roles import Role
from ground_station.adapters.clock import epoch_us
from ground_station.app.options.program_options import (
    GroupWithOptions,
    command_class_with_options,
    current_group_option_values,
)

if TYPE_CHECKING:
    from ground_station.adapters.pki.pki_folder import PkiFolder

EXIT_EXPIRING = 3
DEFAULT_VALIDITY_DAYS = 365

app = typer.Typer(
    cls=GroupWithOptions,
    no_args_is_help=True,
    help=(
        "Manage the identities of fleet members (docs/how-to/secure-a-fleet.md).\n\n"
        "ground-station pki init harbour\n\n"
        "ground-station pki add d1 --role vehicle"
    ),
)

Folder = Annotated[Path, typer.Option("--pki", help="The folder of authority, roster and members.")]
DEFAULT_PKI_FOLDER = Path("fleet-pki")
Names = Annotated[list[str], typer.Argument(help="One member or several.", metavar="NAME...")]
OptionalNames = Annotated[
    list[str] | None, typer.Argument(help="One member or several.", metavar="NAME...")
]
ValidityDays = Annotated[
    int, typer.Option(min=1, max=3650, help="Validity of the certificate, days.")
]


@app.callback()
def group_option(pki: Folder = DEFAULT_PKI_FOLDER) -> None:
    """Declare the folder, which all commands use."""


@app.command(cls=command_class_with_options("pki"))
def init(fleet: Annotated[str, typer.Argument(help="Name of the new fleet.")]) -> None:
    """Create the authority of a new fleet. Keep PKI/authority offline."""
    from ground_station.adapters.pki.pki_folder import PkiFolder, utc_datetime

    pki = _pki_path()
    PkiFolder.create_fleet(pki, fleet, utc_datetime(epoch_us()))
    typer.echo(f"{pki}: the authority of {fleet}; keep {pki / 'authority'} offline")


@app.command(cls=command_class_with_options("pki"))
def add(
    names: Names,
    role: Annotated[Role, typer.Option(help="Role, which defines its permissions.")],
    address: Annotated[
        str, typer.Option(help="HOST:PORT of a desk or router for other members.")
    ] = "",
    days: ValidityDays = DEFAULT_VALIDITY_DAYS,
) -> None:
    """Add members: create a folder with keys and certificate for each.

    Copy each folder to its member. Roles: desk, supervisor and dispatcher send commands; vehicle
    and truck report their state; station sends wind; router forwards; viewer reads; neighbour
    (another fleet) receives tracks. With --role neighbour, NAME may be the PKI folder of another of
    your fleets: each desk gets the credentials of the other fleets in its folder, and their
    vehicles exchange tracks only.

    ground-station pki add desk --role desk --address desk.harbour.example:7447
    ground-station pki add d1 d2 d3 --role vehicle
    ground-station pki add south-pki --pki north-pki --role neighbour
    """
    folder = _read_pki_folder(_pki_path())
    if role is Role.NEIGHBOUR and all(Path(name).is_dir() for name in names):
        from ground_station.adapters.pki.neighbours import add_mutual_neighbour_identities

        fleets = [folder, *(_read_pki_folder(Path(name)) for name in names)]
        for member_folder_path in add_mutual_neighbour_identities(fleets, days):
            typer.echo(f"{member_folder_path}: copy it to that desk only")
        for fleet in fleets:
            typer.echo(f"{fleet.folder}: {fleet.roster.fleet}, roster {fleet.roster.number}")
        return
    folder.add_members(names, role, days, address)
    for name in names:
        member_folder = folder.folder / "members" / name
        typer.echo(f"{member_folder}: copy it to {name} only (roster {folder.roster.number})")


@app.command(cls=command_class_with_options("pki"))
def renew(
    names: OptionalNames = None,
    ending: Annotated[
        int | None,
        typer.Option(min=0, help="Renew all certificates that expire within this many days."),
    ] = None,
    days: ValidityDays = DEFAULT_VALIDITY_DAYS,
) -> None:
    """Renew members' certificates; keys are unchanged.

    ground-station pki renew d1 d2
    ground-station pki renew --ending 30
    """
    if bool(names) == (ending is not None):
        raise LeewayError("renew: expected names, or --ending DAYS")
    folder = _read_pki_folder(_pki_path())
    selected_names = names or folder.names_of_members_expiring_within(ending or 0)
    if not selected_names:
        typer.echo(f"no certificate expires within {ending} days")
        return
    folder.renew_member_certificates(selected_names, days)
    for name in selected_names:
        member_folder = folder.folder / "members" / name
        typer.echo(f"{member_folder}: copy tls.pem to {name} (roster {folder.roster.number})")


@app.command(cls=command_class_with_options("pki"))
def revoke(names: Names) -> None:
    """Revoke members. Takes effect as the new roster reaches each member."""
    folder = _read_pki_folder(_pki_path())
    folder.revoke_members(*names)
    revoked_names, roster_path = ", ".join(names), folder.folder / "roster.json"
    typer.echo(f"roster {folder.roster.number} revokes {revoked_names}")
    typer.echo(f"copy {roster_path} to a desk's identity folder: the desk distributes it")
    typer.echo(f"each member accepts {revoked_names} until it receives that roster")


@app.command(cls=command_class_with_options("pki"))
def rotate(
    finish: Annotated[
        bool,
        typer.Option(
            "--finish", help="Remove the old authority, after all members have new certificates."
        ),
    ] = False,
) -> None:
    """Replace the authority: add a second, renew all, remove the first.

    ground-station pki rotate
    ground-station pki rotate --finish
    """
    folder = _read_pki_folder(_pki_path())
    if finish:
        folder.remove_oldest_authority()
        typer.echo(f"{folder.folder}: one authority is valid")
        return
    folder.add_second_authority()
    typer.echo(
        f"{folder.folder}: two authorities are valid; distribute the folders, renew all, then"
        " `pki rotate --finish`"
    )


@app.command(cls=command_class_with_options("pki"))
def status() -> None:
    """List members and the remaining validity of their certificates.

    Exit code 3: a certificate has expired or expires within 30 days.
    """
    from companion.fleet.roster import WARN_DAYS
    from ground_station.app.views.terminal import plain_console, plain_table

    folder = _read_pki_folder(_pki_path())
    table = plain_table(
        "member", "role", "days", title=f"{folder.roster.fleet} {folder.roster.number}"
    )
    expiring: list[str] = []
    for member in folder.roster.members:
        days = (member.not_after - folder.now).days
        if not member.revoked and days <= WARN_DAYS:
            expiring.append(member.name)
        table.add_row(member.name, member.role.value, "revoked" if member.revoked else str(days))
    plain_console().print(table)
    if expiring:
        typer.echo(f"expired or expiring: ground-station pki renew {' '.join(expiring)}", err=True)
        raise typer.Exit(EXIT_EXPIRING)


def _pki_path() -> Path:
    return current_group_option_values()["pki"]


def _read_pki_folder(pki: Path) -> "PkiFolder":
    from ground_station.adapters.pki.pki_folder import PkiFolder, utc_datetime

    if not pki.is_dir():
        raise LeewayError(f"{pki}: no such folder: use --pki, or `ground-station pki init FLEET`")
    return PkiFolder.read(pki, utc_datetime(epoch_us()))
