"""The command line of `companion certify`. What it does is imported when it runs."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()

EPILOG = """Exit codes: 0 written; 2 a day or an option cannot be used, and nothing is written. Logs
that cannot be used, end in the air, or are of a day that the airframe was fitted to are left out by
name."""


@app.command(name="certify", epilog=EPILOG)
def certify_command(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Flight logs of three days or more: .ulg, .bin, .tlog, .mcap or CSV."),
    ],
    airframe: Annotated[
        Path, typer.Option(help="The airframe file (.toml); the certificate is written beside it.")
    ],
    payload_kg: Annotated[
        str,
        typer.Option(
            help="Parcel aboard in each log, in their order: 0,0.8,0.4. Default: by parameters.csv"
            " beside the log, else 0."
        ),
    ] = "",
    dates: Annotated[
        str,
        typer.Option(
            help="Day of each log, in their order: 2026-05-01,2026-05-01,2026-05-02. Default: by"
            " parameters.csv beside the log."
        ),
    ] = "",
    temperature_c: Annotated[
        float | None,
        typer.Option(
            help="Of the air, where no table states it. Absent: density as at 20 C, and the"
            " certificate names no temperature."
        ),
    ] = None,
    max_loss: Annotated[
        float, typer.Option(help="The loss that you would accept: what it would need is said.")
    ] = 0.01,
) -> None:
    """Say what days of flights support of an airframe's draw, and write its certificate.

    Example: companion certify logs/*.csv.gz --airframe my_airframe.toml
    """
    from companion.app.tools.certify import CertifyOptions, run_certify

    run_certify(CertifyOptions(tuple(logs), airframe, payload_kg, dates, temperature_c, max_loss))
