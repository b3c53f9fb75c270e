"""`sim-bridge paths-bench` and `sim-bridge paths`: Dubins paths in wind, measured and drawn."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.experiments import OUT, finish, progress_bar

app = typer.Typer(add_completion=False, no_args_is_help=True)

Out = Annotated[Path, typer.Option(help="folder for the table or picture")]


@app.command()
def paths_bench(
    out: Out = OUT,
    paths: Annotated[int, typer.Option(help="pairs of poses in each wind", min=1)] = 20_000,
    seed: Annotated[int, typer.Option(help="of the poses", min=0)] = 1,
) -> None:
    """Paths a second and their lengths, beside OMPL's Dubins and trochoids (pip install ompl).

    Example: sim-bridge paths-bench --paths 5000
    """
    from sim_bridge.research.benchmarks import paths_bench as experiment

    rows: list[experiment.Compared] = []
    with progress_bar() as shown:
        task = shown.add_task("paths", total=len(experiment.WINDS_MPS))
        for wind_mps in experiment.WINDS_MPS:
            rows.append(experiment.compare(wind_mps, paths, seed))
            shown.advance(task)
    finish(experiment.sheet(rows), out, "paths_bench")


@app.command()
def paths(
    out: Out = OUT,
    airspeed: Annotated[float, typer.Option(help="m/s")] = 15.0,
    bank: Annotated[float, typer.Option(help="bank limit, degrees")] = 25.0,
    wind: Annotated[float, typer.Option(help="m/s")] = 7.0,
    wind_from: Annotated[float, typer.Option(help="degrees, where it blows from")] = 270.0,
) -> None:
    """Draw a path between two poses in calm air and in wind, around buildings, and as items.

    Example: sim-bridge paths --wind 10 --wind-from 180
    """
    from sim_bridge.research.dubins.picture import draw

    try:
        path = draw(out / "paths.png", airspeed, bank, wind, wind_from)
    except LeewayError as error:
        typer.echo(f"sim-bridge: {error}", err=True)
        raise typer.Exit(2) from None
    typer.echo(f"wrote {path}")
