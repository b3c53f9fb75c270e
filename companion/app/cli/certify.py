"""Command line of `companion certify`. The implementation is imported when it runs."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()

EPILOG = """Exit codes: 0 certificate written; 2 a day or option is invalid and nothing is written.
Logs are excluded, with a message, if they are unreadable, end in flight, or were recorded on a day
that the airframe was fitted to."""


@app.command(name="certify", epilog=EPILOG)
def certify_command(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Flight logs of at least three days: .ulg, .bin, .tlog, .mcap or CSV."),
    ],
    airframe: Annotated[
        Path, typer.Option(help="Airframe file (.toml); the certificate goes to its folder.")
    ],
    payload_kg: Annotated[
        str,
        typer.Option(
            help="Payload mass of each log in kg, in order, for example 0,0.8,0.4. Default: from"
            " parameters.csv in the log's folder, else 0."
        ),
    ] = "",
    dates: Annotated[
        str,
        typer.Option(
            help="Date of each log, in order: 2026-05-01,2026-05-01,2026-05-02. Default: from"
            " parameters.csv in the log's folder."
        ),
    ] = "",
    temperature_c: Annotated[
        float | None,
        typer.Option(
            help="Air temperature in °C if no table states it. Default: air density at 20 °C, and"
            " the certificate states no temperature."
        ),
    ] = None,
    max_loss: Annotated[
        float, typer.Option(help="Accepted loss per mission; the evidence it needs is printed.")
    ] = 0.01,
    wind_process: Annotated[
        str, typer.Option(help="Wind process (name or file) of the printed limit of evidence.")
    ] = "coast",
) -> None:
    """Write an airframe's certificate: the bound on its power draw that its flight logs support.

    Example: companion certify logs/*.csv.gz --airframe my_airframe.toml
    """
    from companion.app.tools.certify import CertifyOptions, evaluate_logs_and_write_certificate

    evaluate_logs_and_write_certificate(
        CertifyOptions(
            tuple(logs), airframe, payload_kg, dates, temperature_c, max_loss, wind_process
        )
    )
