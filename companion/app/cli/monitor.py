"""`companion monitor`: show a vehicle's service record, or reset part of it."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()


class RecordAction(StrEnum):
    """What to do with the record."""

    STATUS = "status"
    RESET = "reset"


@app.command()
def monitor(
    action: Annotated[RecordAction, typer.Argument(help="Show the record, or reset SUBJECT.")],
    subject: Annotated[
        str | None,
        typer.Argument(
            help="reset: draw (power draw), wind, lost (conservative assumptions after lost"
            " evidence), or a pack's name (`unnamed` without --pack)."
        ),
    ] = None,
    by: Annotated[str, typer.Option(help="reset: your name, recorded.")] = "",
    why: Annotated[str, typer.Option(help="reset: the reason, recorded.")] = "",
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Name in the fleet or of the airframe; default: the only one with a record."
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            "--monitor", help="Folder of the records (systemd services: /var/lib/leeway/monitor)."
        ),
    ] = None,
) -> None:
    """Show the evidence and alarms of a vehicle's service, or reset one.

    A reset discards the evidence on one quantity: the next flight flies without its alarm. Do not
    reset while the vehicle flies: the flight overwrites the record when it ends.

    companion monitor status
    companion monitor reset A7 --by Kim --why "new cells"
    """
    from companion.adapters.clock import unix_time_us
    from companion.adapters.files.monitor_file import read_service_record, write_service_record
    from companion.app.cli.monitor_report import service_report_lines
    from companion.core.monitor.service import reset_evidence_of_subject

    if action is RecordAction.STATUS and (subject or by or why):
        raise LeewayError("monitor status: expected no SUBJECT, --by or --why")
    if action is RecordAction.RESET and not (subject and by.strip() and why.strip()):
        raise LeewayError("monitor reset: expected SUBJECT, --by NAME and --why REASON")
    path = _find_record_file_path(folder, vehicle)
    service = read_service_record(path)
    if service is None:
        raise LeewayError(f"{path}: no such record")
    if subject is None:
        typer.echo("\n".join(service_report_lines(path.stem, service)))
        return
    write_service_record(
        path, reset_evidence_of_subject(service, subject, by, why, unix_time_us() / 1e6)
    )
    typer.echo(f"{path.stem}: {subject} reset by {by}: {why}")


def _find_record_file_path(folder: Path | None, vehicle: str | None) -> Path:
    """Return the file of the record. Raises LeewayError if the vehicle is ambiguous."""
    from companion.adapters.files.monitor_file import service_monitor_folder, service_record_path

    folder = folder or service_monitor_folder()
    if folder is None:
        raise LeewayError("--monitor: expected the folder of the records")
    if vehicle is not None:
        return service_record_path(folder, vehicle)
    found = sorted(folder.glob("*.json"))
    if len(found) != 1:
        names = ", ".join(path.stem for path in found) or "none"
        raise LeewayError(f"--vehicle: expected a name; records in {folder}: {names}")
    return found[0]
