"""Command lines of `companion calibrate` and `companion calibrate-plan`.

The implementation is imported when a command runs, so that `companion run` does not load it.
"""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()

EPILOG = """Exit codes: 0 success; 2 a log or option is invalid (the message states file and row); 3
the logs do not identify a required parameter (the message states the flight that would)."""


@app.command(name="calibrate", epilog=EPILOG)
def calibrate_command(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Three or more flight logs: .ulg, .bin, .tlog, .mcap or CSV."),
    ],
    airframe: Annotated[
        str, typer.Option(help="Prior airframe: a name in params/airframes or a .toml file.")
    ],
    out: Annotated[Path, typer.Option(help="Airframe file to write.")] = Path("my_airframe.toml"),
    payload_kg: Annotated[
        str,
        typer.Option(
            help="Payload mass of each log in kg, in order, for example 0,0.8,0.4. Default: from"
            " parameters.csv in the log's folder, else 0."
        ),
    ] = "",
    holdout: Annotated[
        list[str] | None,
        typer.Option(help="LOG or LOG:KG used for validation, not for the fit; repeatable."),
    ] = None,
    temperature_c: Annotated[
        float, typer.Option(help="Air temperature in °C, for the air density.")
    ] = 20.0,
    allow_priors: Annotated[
        bool,
        typer.Option("--allow-priors", help="Write the file even if parameters keep their priors."),
    ] = False,
    symmetric: Annotated[
        bool,
        typer.Option(
            "--symmetric",
            help="Front and side of the airframe have equal drag area: lateral drag may differ by"
            " 5 % from the value derived from frontal drag, instead of 25 %.",
        ),
    ] = False,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write all results as JSON.")
    ] = None,
) -> None:
    """Fit drag, power and battery parameters to flight logs.

    Example: companion calibrate square1.tlog square2.tlog square3.tlog --airframe m100
    --payload-kg 0,0.8,0.4 --out my_airframe.toml
    """
    from companion.app.tools.calibrate import CalibrateOptions, fit_airframe_to_logs_and_write

    fit_airframe_to_logs_and_write(
        CalibrateOptions(
            tuple(logs),
            airframe,
            out,
            payload_kg,
            tuple(holdout or ()),
            temperature_c,
            allow_priors,
            symmetric,
            json_out,
        )
    )


@app.command(name="calibrate-plan")
def plan_command(
    home: Annotated[str, typer.Option(help="Take-off LAT,LON,ALT, degrees, m: 55.47,8.45,12.")],
    airframe: Annotated[str, typer.Option(help="A name in params/airframes, or a .toml file.")],
    out: Annotated[Path, typer.Option(help="QGroundControl plan to write.")] = Path(
        "calibration.plan"
    ),
    autopilot: Annotated[str, typer.Option(help="Autopilot: px4 or ardupilot.")] = "px4",
    side_m: Annotated[
        float, typer.Option(min=60.0, max=600.0, help="Side of the square, m.")
    ] = 150.0,
    height_m: Annotated[
        float, typer.Option(min=15.0, max=90.0, help="Height above take-off, m.")
    ] = 40.0,
    duration_s: Annotated[float, typer.Option(min=240.0, max=2400.0, help="Duration, s.")] = (
        600.0
    ),
    mirrored: Annotated[
        bool, typer.Option("--mirrored", help="Place the square south-west of the home position.")
    ] = False,
    fast: Annotated[
        bool,
        typer.Option(
            "--fast",
            help="Fly the sides at max_ground_mps, to identify drag and power at high speed.",
        ),
    ] = False,
    discharge: Annotated[
        bool,
        typer.Option(
            "--discharge",
            help="Write a low hover from full charge to 10 %, to identify usable energy.",
        ),
    ] = False,
    payload_kg: Annotated[float, typer.Option(min=0.0, help="Payload of --discharge, kg.")] = 0.0,
) -> None:
    """Write a calibration flight as a QGroundControl plan.

    The plan is a square at three speeds. Fly it three times: without payload, with maximum payload,
    and with a smaller payload at a fixed heading (docs/how-to/calibrate.md). --fast: a fourth
    flight, without payload, if `calibrate` requests it. --discharge: a hover that identifies usable
    energy; fly it without payload and with --payload-kg.

    companion calibrate-plan --home 55.47,8.45,12 --airframe m100 --autopilot px4
    """
    from companion.analysis.calibration.flight import PlanOptions
    from companion.app.tools.calibrate import (
        write_calibration_flight_plan,
        write_discharge_hover_plan,
    )

    if discharge:
        write_discharge_hover_plan(out, home, airframe, autopilot, payload_kg)
        return
    options = PlanOptions(height_m, side_m, duration_s, mirrored, fast)
    write_calibration_flight_plan(out, home, airframe, autopilot, options)
