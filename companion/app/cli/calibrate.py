"""The command lines of `companion calibrate` and `calibrate-plan`.

What they do is imported when they run, not with `companion run`.
"""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()

EPILOG = """Exit codes: 0 done; 2 a log or an option cannot be used (said by name and row); 3 a
number that flight safety needs is not identified, and the flight that would is named."""


@app.command(name="calibrate", epilog=EPILOG)
def calibrate_command(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Flight logs: .ulg, .bin, .tlog, .mcap or CSV; three or more."),
    ],
    airframe: Annotated[
        str, typer.Option(help="What is believed so far: a name in params/airframes or a .toml.")
    ],
    out: Annotated[Path, typer.Option(help="The airframe file to write.")] = Path(
        "my_airframe.toml"
    ),
    payload_kg: Annotated[
        str,
        typer.Option(
            help="Parcel aboard in each log, in their order: 0,0.8,0.4. Default: by parameters.csv"
            " beside the log, else 0."
        ),
    ] = "",
    holdout: Annotated[
        list[str] | None,
        typer.Option(help="LOG or LOG:KG, not fitted, only predicted; once or more."),
    ] = None,
    temperature_c: Annotated[float, typer.Option(help="Of the air, for its density.")] = 20.0,
    allow_priors: Annotated[
        bool,
        typer.Option("--allow-priors", help="Write the file even where numbers stay as believed."),
    ] = False,
    symmetric: Annotated[
        bool,
        typer.Option(
            "--symmetric",
            help="The airframe looks alike from ahead and from the side: drag to the right is held"
            " to 5 % of what drag ahead makes of it, instead of 25 %.",
        ),
    ] = False,
    json_out: Annotated[Path | None, typer.Option("--json", help="Every figure as JSON.")] = None,
    plots: Annotated[
        Path | None, typer.Option(help="A folder for residual plots (needs matplotlib).")
    ] = None,
) -> None:
    """Fit drag, power and battery of an airframe to flight logs, and say how sure each is.

    Example: companion calibrate square1.tlog square2.tlog square3.tlog --airframe m100
    --payload-kg 0,0.8,0.4 --out my_airframe.toml
    """
    from companion.app.tools.calibrate import CalibrateOptions, run_calibration

    run_calibration(
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
            plots,
        )
    )


@app.command(name="calibrate-plan")
def plan_command(
    home: Annotated[str, typer.Option(help="LAT,LON,ALT of the take-off place: 55.47,8.45,12.")],
    airframe: Annotated[str, typer.Option(help="A name in params/airframes or a .toml.")],
    out: Annotated[Path, typer.Option(help="The QGroundControl plan to write.")] = Path(
        "calibration.plan"
    ),
    autopilot: Annotated[str, typer.Option(help="px4 or ardupilot.")] = "px4",
    side_m: Annotated[float, typer.Option(min=60.0, max=600.0, help="Side of the square.")] = 150.0,
    height_m: Annotated[float, typer.Option(min=15.0, max=90.0, help="Above take-off.")] = 40.0,
    duration_s: Annotated[float, typer.Option(min=240.0, max=2400.0, help="About so long.")] = (
        600.0
    ),
    mirrored: Annotated[
        bool, typer.Option("--mirrored", help="The square south-west of the place instead.")
    ] = False,
    fast: Annotated[
        bool,
        typer.Option(
            "--fast",
            help="Sides at max_ground_mps, as long as that takes: tells drag and power up there.",
        ),
    ] = False,
    discharge: Annotated[
        bool,
        typer.Option(
            "--discharge",
            help="Instead: a low hover from full to 10 %, which tells usable energy.",
        ),
    ] = False,
    payload_kg: Annotated[float, typer.Option(min=0.0, help="Aboard, with --discharge.")] = 0.0,
) -> None:
    """Write the flight that calibration needs as a QGroundControl plan: a square at three speeds.

    Fly it three times: empty, with the heaviest parcel, and with a lighter one and the nose held
    on one heading (docs/how-to/calibrate.md). Example:
    companion calibrate-plan --home 55.47,8.45,12 --airframe m100 --autopilot px4

    With --fast, a fourth flight, empty, where calibrate asks for it.
    With --discharge, the hover that tells usable energy; fly it empty and with --payload-kg.
    """
    from companion.app.tools.calibrate import write_calibration_plan, write_discharge_plan
    from companion.core.calibration.flight import PlanOptions

    if discharge:
        write_discharge_plan(out, home, airframe, autopilot, payload_kg)
        return
    options = PlanOptions(height_m, side_m, duration_s, mirrored, fast)
    write_calibration_plan(out, home, airframe, autopilot, options)
