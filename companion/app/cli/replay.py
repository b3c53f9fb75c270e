"""Command line of `companion replay`. The implementation is imported when it runs."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()


class Estimator(StrEnum):
    """Wind estimator."""

    LEEWAY = "leeway"
    REFERENCE = "reference"


EXIT_INTERRUPTED = 130

EPILOG = """Example: companion replay flight.ulg --airframe m100 --out wind.csv --picture flight.png

Formats, columns and the JSON record: docs/reference/replay-json.md. Exit codes: 0 replayed
(faults of the log are listed); 2 invalid input, or the file is not a log;
130 interrupted."""


@app.command(name="replay", epilog=EPILOG)
def replay_command(
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG",
            help="PX4 ULog (.ulg), ArduPilot dataflash (.bin), .tlog, Leeway .mcap, or CSV.",
        ),
    ],
    airframe: Annotated[
        str | None,
        typer.Option(
            help="A name in params/airframes, or a .toml file. Default: the drag of a generic"
            " multirotor estimates the wind, and energy is not evaluated."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the wind estimate as CSV.")] = None,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write decisions, events and faults as JSON.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Plot wind, energy and P(home) to a .png, .svg or .pdf file."),
    ] = None,
    flight: Annotated[
        Path | None,
        typer.Option(
            help="Flown flight, a flight/1 TOML file or a name in params/flights: gives route,"
            " limits and payload. Default: return straight to the take-off point."
        ),
    ] = None,
    payload: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Payload mass, kg, without --flight. Default: from parameters.csv in the log's"
            " folder, else 0.",
        ),
    ] = None,
    mass: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            max=100.0,
            help="Mass in flight, kg, without --airframe: scales the generic drag.",
        ),
    ] = None,
    max_loss: Annotated[
        float | None,
        typer.Option(help="Accepted loss probability per mission; default: the flight's, or 0.01."),
    ] = None,
    reserve: Annotated[
        float | None,
        typer.Option(help="Reserve as fraction of usable energy; default: the flight's, or 0.15."),
    ] = None,
    wind_process: Annotated[
        str | None,
        typer.Option(
            help="Wind process: a name in params/wind, or a file from `companion fit-wind`;"
            " default: the flight's mission.wind_process."
        ),
    ] = None,
    estimator: Annotated[
        Estimator | None,
        typer.Option(
            help="Wind estimator: leeway (default), as in flight, or reference, an extended Kalman"
            " filter of filterpy for comparison."
        ),
    ] = None,
    every: Annotated[
        float, typer.Option(min=0.1, help="Interval between gate decisions, s.")
    ] = 5.0,
    params: Annotated[
        Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
    ] = None,
) -> None:
    """Replay a log through the estimators, energy ledger and gate.

    Prints the decisions that Leeway would have made. The log is only read. Faults of the log
    (truncation, gaps, time jumps, NaN, units, another vehicle) are reported with their position,
    and the valid part is used.
    """
    from companion.app.cli.replay_log import ReplayRequest, replay_log_and_write_outputs

    request = ReplayRequest(
        log,
        airframe,
        flight,
        payload,
        max_loss,
        reserve,
        every,
        wind_process,
        params,
        None if estimator is None else estimator.value,
        mass,
    )
    try:
        replay_log_and_write_outputs(request, out, json_out, picture)
    except LeewayError as error:
        from companion.app.flight.run import USAGE

        typer.echo(f"companion replay: {error}", err=True)
        raise typer.Exit(USAGE) from error
    except KeyboardInterrupt:
        typer.echo("companion replay: interrupted; no partial output files remain", err=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
