"""`companion monitor`: what the monitor has found over a vehicle's service, and resetting it."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer(
    no_args_is_help=True,
    help="What the monitor has found over a vehicle's service, and resetting it.",
)

Vehicle = Annotated[
    str | None,
    typer.Option(
        help="Its name in the fleet, or its airframe's; default: the only one with a record."
    ),
]
Folder = Annotated[
    Path | None,
    typer.Option(
        "--monitor", help="Folder of the records (of our services: /var/lib/leeway/monitor)."
    ),
]


@app.command()
def status(vehicle: Vehicle = None, folder: Folder = None) -> None:
    """Show the evidence against each promise, what is in doubt, and who reset what."""
    from companion.adapters.files.monitor_file import read_service
    from companion.app.cli.monitor_report import report

    path = _record(folder, vehicle)
    service = read_service(path)
    if service is None:
        raise LeewayError(f"{path}: no such record")
    typer.echo("\n".join(report(path.stem, service)))


@app.command()
def reset(
    subject: Annotated[
        str, typer.Argument(help="draw, wind, lost, or a pack's name (`unnamed` without one).")
    ],
    by: Annotated[str, typer.Option(help="Who resets it: goes on record.")],
    why: Annotated[str, typer.Option(help="Why: goes on record.")],
    vehicle: Vehicle = None,
    folder: Folder = None,
) -> None:
    """Begin the evidence on one promise anew, on record: the next flight is as without the alarm.

    Not while the vehicle flies: a flight that ends writes what it knew when it began.
    Example: companion monitor reset A7 --by Kim --why "new cells"
    """
    from companion.adapters.clock import epoch_us
    from companion.adapters.files.monitor_file import read_service, write_service
    from companion.core.monitor.service import reset as reset_in

    path = _record(folder, vehicle)
    service = read_service(path)
    if service is None:
        raise LeewayError(f"{path}: no such record")
    if not by.strip() or not why.strip():
        raise LeewayError("--by and --why: expected a name and a reason")
    write_service(path, reset_in(service, subject, by, why, epoch_us() / 1e6))
    typer.echo(f"{path.stem}: {subject} begins anew, by {by}: {why}")


def _record(folder: Path | None, vehicle: str | None) -> Path:
    """The record that is meant. Raises LeewayError where that is open."""
    from companion.adapters.files.monitor_file import default_monitor_folder, service_file

    folder = folder or default_monitor_folder()
    if folder is None:
        raise LeewayError("--monitor: expected the folder of the records")
    if vehicle is not None:
        return service_file(folder, vehicle)
    found = sorted(folder.glob("*.json"))
    if len(found) != 1:
        names = ", ".join(path.stem for path in found) or "none"
        raise LeewayError(f"--vehicle: expected a name; records in {folder}: {names}")
    return found[0]
