"""The command line of `companion replay`; what it does is imported when it runs."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()


class Estimator(StrEnum):
    """Who estimates the wind."""

    LEEWAY = "leeway"
    REFERENCE = "reference"


STOPPED_BY_HAND = 130

EPILOG = """Example: companion replay flight.ulg --airframe m100 --out wind.csv --picture flight.png

Formats, columns and the JSON record: docs/reference/replay-json.md. Exit codes: 0 replayed
(whatever was wrong with the log is listed); 2 a mistake in the input, or a file that is no log;
130 stopped."""


@app.command(name="replay", epilog=EPILOG)
def replay_command(
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG",
            help="PX4 ULog (.ulg), ArduPilot dataflash (.bin), .tlog, our .mcap, or CSV telemetry.",
        ),
    ],
    airframe: Annotated[
        str | None,
        typer.Option(
            help="An airframe in params/airframes, or a .toml file. Without one the wind is"
            " estimated with a generic multirotor's drag, and energy is not judged."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the wind here, as CSV.")] = None,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write decisions, time line and findings here.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draw wind, energy and promise over the flight here (.png, .svg, .pdf)."),
    ] = None,
    flight: Annotated[
        Path | None,
        typer.Option(
            help="The flight that was flown, a flight/1 TOML file or a name in params/flights: its"
            " route, limits and parcel. Without it home is the take-off point, straight."
        ),
    ] = None,
    payload: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Parcel aboard the whole flight, kg; without --flight. Default: by parameters.csv"
            " beside the log, else 0.",
        ),
    ] = None,
    max_loss: Annotated[
        float | None,
        typer.Option(help="The loss probability that is accepted; default: the flight's, or 0.01."),
    ] = None,
    reserve: Annotated[
        float | None,
        typer.Option(help="Share of the usable energy to land with; default: the flight's, 0.15."),
    ] = None,
    wind_process: Annotated[
        str | None,
        typer.Option(
            help="How the wind may change: a name in params/wind or a file, from `companion"
            " fit-wind`; default: the flight's mission.wind_process."
        ),
    ] = None,
    estimator: Annotated[
        Estimator | None,
        typer.Option(
            help="Who estimates the wind: leeway, the estimator that flies (default), or reference,"
            " a plain extended Kalman filter (filterpy) to compare it with."
        ),
    ] = None,
    every: Annotated[
        float, typer.Option(min=0.1, help="Ask the gate every so many seconds of the flight.")
    ] = 5.0,
    params: Annotated[
        Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
    ] = None,
) -> None:
    """Run the companion's estimators, energy ledger and gate over a recorded flight.

    Prints what Leeway would have said, and when. Nothing is flown, and nothing of the log is
    changed. What is wrong with a log (cut off, gaps, jumps in time, NaN, units, another vehicle)
    is said with its place, and the log is used as far as it goes.
    """
    from companion.app.cli.replay_log import ReplayRequest, replay_log

    asked = ReplayRequest(
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
    )
    try:
        replay_log(asked, out, json_out, picture)
    except LeewayError as error:
        from companion.app.flight.run import USAGE

        typer.echo(f"companion replay: {error}", err=True)
        raise typer.Exit(USAGE) from error
    except KeyboardInterrupt:
        typer.echo("companion replay: stopped; nothing half-written is left", err=True)
        raise typer.Exit(STOPPED_BY_HAND) from None
