"""`sim-bridge research real-flights`: energy and wind on recorded delivery flights."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.research.cli.running import (
    Cluster,
    Jobs,
    run_journaled,
    workers_of,
    write_whole,
)

app = typer.Typer(add_completion=False)


@app.command("real-flights")
def real_flights(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Flights with parameters.csv: they are judged.")
    ],
    fit: Annotated[
        Path | None,
        typer.Option(help="Flights to fit to. Without it each day is predicted from the others."),
    ] = None,
    airframe: Annotated[
        str, typer.Option(help="What is believed before: a name in params/airframes or a .toml.")
    ] = "m100",
    climate: Annotated[
        bool,
        typer.Option(
            help="Where no temperature is stated: the usual one near Pittsburgh, or 20 C."
        ),
    ] = True,
    json: Annotated[Path | None, typer.Option(help="Every figure as JSON.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for tables and picture.")] = Path(
        "logs/real_flights"
    ),
    jobs: Jobs = 0,
    cluster: Cluster = None,
) -> None:
    """Predict recorded flights from those of other days: energy with its bound, and the wind.

    The airframe is fitted by `companion calibrate`'s own code; nothing is fitted to a day that
    judges it. What is wrong with a flight is said by its name and row on stderr.

    Example: sim-bridge research real-flights m100_flights --json real.json
    """
    import msgspec

    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.real_flights.figures import figures
    from sim_bridge.research.real_flights.fold import FoldResult, run_fold
    from sim_bridge.research.real_flights.folder import read_folder
    from sim_bridge.research.real_flights.folds import folds_of
    from sim_bridge.research.real_flights.sheets import draw, sheets_of

    for one in (folder, *((fit,) if fit else ())):
        if not one.is_dir():
            raise LeewayError(f"{one}: no such folder")
    judged = read_folder(folder.resolve(), airframe, climate)
    work = folds_of(judged, folder.resolve(), fit.resolve() if fit else None, airframe, climate)
    out.mkdir(parents=True, exist_ok=True)
    name = digest_of(work)[:12]
    kept = Journal(out / f"{name}.partial", digest_of(work), FoldResult)
    done = run_journaled("days", work, run_fold, workers_of(jobs, cluster), kept)
    found = figures(done, [*judged.left_out, *judged.findings])
    for words in found.words:
        typer.echo(words, err=True)
    written = []
    for stem, sheet in sheets_of(found):
        written += sheet.write(out, stem)
        typer.echo(sheet.markdown())
    picture = out / "real_flights.png"
    draw(found, picture)
    if json is not None:
        write_whole(json, msgspec.json.format(msgspec.json.encode(found), indent=1) + b"\n")
        written.append(json)
    typer.echo("wrote " + ", ".join(str(path) for path in (*written, picture)), err=True)
    kept.remove()
