"""`ground-station pki`: who belongs to a fleet, and the folders that make them members."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.roles import Role
from ground_station.adapters.clock import epoch_us

if TYPE_CHECKING:
    from ground_station.adapters.pki.pki_folder import PkiFolder

SOON = 3
DAYS = 365

app = typer.Typer(
    no_args_is_help=True,
    help=(
        "Make and end the identities of a fleet's members (docs/how-to/secure-a-fleet.md).\n\n"
        "ground-station pki init harbour\n\n"
        "ground-station pki add d1 --role vehicle"
    ),
)

Folder = Annotated[Path, typer.Option("--pki", help="The folder of authority, roster and members.")]
HERE = Path("fleet-pki")
Names = Annotated[list[str], typer.Argument(help="One member or several.", metavar="NAME...")]
MaybeNames = Annotated[
    list[str] | None, typer.Argument(help="One member or several.", metavar="NAME...")
]
Days = Annotated[int, typer.Option(min=1, max=3650, help="How long the certificate is valid.")]


@app.command()
def init(fleet: str, pki: Folder = HERE) -> None:
    """Make the authority of a new fleet. Keep PKI/authority apart: it can make members."""
    from ground_station.adapters.pki.pki_folder import PkiFolder, utc_at

    PkiFolder.init(pki, fleet, utc_at(epoch_us()))
    typer.echo(f"{pki}: the authority of {fleet}; keep {pki / 'authority'} apart")


@app.command()
def add(
    names: Names,
    role: Annotated[Role, typer.Option(help="What it may do.")],
    address: Annotated[
        str, typer.Option(help="HOST:PORT at which the others find a desk or router.")
    ] = "",
    days: Days = DAYS,
    pki: Folder = HERE,
) -> None:
    """Make members: keys, certificate and network file of each, in a folder to carry to it.

    ground-station pki add desk --role desk --address desk.harbour.example:7447
    ground-station pki add d1 d2 d3 --role vehicle
    """
    folder = _open(pki)
    folder.add_all(names, role, days, address)
    for name in names:
        typer.echo(f"{pki / 'members' / name}: for {name} only; roster {folder.roster.number}")


@app.command()
def renew(
    names: MaybeNames = None,
    ending: Annotated[
        int | None,
        typer.Option(min=0, help="Renew all whose certificates end within so many days, instead."),
    ] = None,
    days: Days = DAYS,
    pki: Folder = HERE,
) -> None:
    """Make members' certificates valid for longer; their keys stay.

    ground-station pki renew d1 d2
    ground-station pki renew --ending 30
    """
    if bool(names) == (ending is not None):
        raise LeewayError("renew: expected names, or --ending DAYS")
    folder = _open(pki)
    whom = names or folder.ending_within(ending or 0)
    if not whom:
        typer.echo(f"nobody's certificate ends within {ending} days")
        return
    folder.renew_all(whom, days)
    for name in whom:
        at = pki / "members" / name
        typer.echo(f"{at}: carry tls.pem to {name}; roster {folder.roster.number}")


@app.command()
def revoke(names: Names, pki: Folder = HERE) -> None:
    """End members: nobody believes them any more once the new roster is with everybody."""
    folder = _open(pki)
    folder.revoke(*names)
    are = f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} revoked"
    words = f"roster {folder.roster.number}: {are}; a desk tells it"
    typer.echo(f"{words} once {pki / 'roster.json'} lies in its folder")


@app.command()
def neighbours(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="PKI PKI...", help="The folders of the fleets, each with a desk."),
    ],
    days: Days = DAYS,
) -> None:
    """Make fleets of yours neighbours: their vehicles hear one another's tracks, nothing else.

    Each fleet's desk gets what the others' authorities made for it, in its own folder: carry that
    to it once more. Of fleets of two operators each does `pki add OTHER --role neighbour`.

    ground-station pki neighbours north-pki south-pki
    """
    from ground_station.adapters.pki.neighbours import introduce

    if len(folders) < 2:
        raise LeewayError("neighbours: expected two folders or more")
    fleets = [_open(pki) for pki in folders]
    for made in introduce(fleets, days):
        typer.echo(f"{made}: for that desk only")
    for fleet in fleets:
        typer.echo(f"{fleet.folder}: {fleet.roster.fleet}, roster {fleet.roster.number}")


@app.command()
def rotate(pki: Folder = HERE) -> None:
    """Make a second authority beside the first. Carry all folders to their members, renew all."""
    folder = _open(pki)
    folder.rotate()
    typer.echo(f"{pki}: two authorities count; carry the folders, renew all, then `pki retire`")


@app.command()
def retire(pki: Folder = HERE) -> None:
    """End the older of two authorities, once every member has the newer one's certificate."""
    folder = _open(pki)
    folder.retire()
    typer.echo(f"{pki}: one authority counts")


@app.command()
def status(pki: Folder = HERE) -> None:
    """List the members and the days that their certificates are still valid.

    Exit code 3: one has at most 30 days left, or none.
    """
    from companion.fleet.roster import WARN_DAYS
    from ground_station.app.views.terminal import listing, terminal

    folder = _open(pki)
    table = listing("member", "role", "days", title=f"{folder.roster.fleet} {folder.roster.number}")
    soon: list[str] = []
    for member in folder.roster.members:
        days = (member.not_after - folder.now).days
        if not member.revoked and days <= WARN_DAYS:
            soon.append(member.name)
        table.add_row(member.name, member.role.value, "revoked" if member.revoked else str(days))
    terminal().print(table)
    if soon:
        typer.echo(f"renew: {', '.join(soon)}", err=True)
        raise typer.Exit(SOON)


def _open(pki: Path) -> "PkiFolder":
    from ground_station.adapters.pki.pki_folder import PkiFolder, utc_at

    if not pki.is_dir():
        raise LeewayError(f"{pki}: no such folder: expected `ground-station pki init FLEET` first")
    return PkiFolder.read(pki, utc_at(epoch_us()))
