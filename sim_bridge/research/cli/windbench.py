"""`sim-bridge research windbench`: wind estimators by one rule on recorded flights."""

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


@app.command("windbench")
def windbench(
    folders: Annotated[
        list[str],
        typer.Argument(
            metavar="DIR[=AIRFRAME]...",
            help="Folders of flights with an anemometer: parameters.csv and N.csv(.gz), or CSV logs"
            " with airspeed_mps or wind_to_n_ref_mps and wind_to_e_ref_mps. After = the airframe of"
            " this folder.",
        ),
    ],
    estimator: Annotated[
        list[str] | None,
        typer.Option(help="MODULE:CLASS of an estimator of your own; once or more."),
    ] = None,
    airframe: Annotated[
        str,
        typer.Option(
            help="What is believed before: a name in params/airframes or a .toml. Fitted to a"
            " folder's other days where there are three or more."
        ),
    ] = "m100",
    study: Annotated[
        str,
        typer.Option(
            help="board: everybody. states: ours without each of its states. cold-starts: begun at"
            " each full minute in the air."
        ),
    ] = "board",
    symmetric: Annotated[
        bool,
        typer.Option(
            "--symmetric",
            help="The airframes look alike from ahead and from the side (companion calibrate).",
        ),
    ] = False,
    json: Annotated[Path | None, typer.Option(help="Standings and all windows as JSON.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = Path("logs/windbench"),
    jobs: Jobs = 0,
    cluster: Cluster = None,
) -> None:
    """Score multirotor wind estimators on real flights by one rule, each day from the others.

    They hear velocity and attitude; an anemometer judges the airspeed. What cannot be used is said
    by name on stderr. How to add an estimator: docs/how-to/wind-benchmark.md.

    Example: sim-bridge research windbench m100_flights my_flights --estimator mine:MyFilter
    """
    import msgspec

    from sim_bridge.adapters.journal import Journal, digest_of
    from sim_bridge.research.windbench.contest import BenchDay, DayResult, run_day
    from sim_bridge.research.windbench.estimators import COLD_STARTS, OURS, STATES, in_study
    from sim_bridge.research.windbench.flights import read_bench_folder
    from sim_bridge.research.windbench.score import standing
    from sim_bridge.research.windbench.sheets import cold_starts_sheet, leader_board, states_sheet

    own = tuple(estimator or ())
    names = list(in_study(study, own))
    asked = [(Path(words.partition("=")[0]), words.partition("=")[2]) for words in folders]
    if len({one.name for one, _ in asked}) < len(asked):
        raise LeewayError("DIR: two folders of one name; expected names of their own")
    work: list[BenchDay] = []
    for one, known in asked:
        read = read_bench_folder(one, known or airframe)
        for words in read.left_out:
            typer.echo(f"{read.name}: {words}", err=True)
        work += [
            BenchDay(one.resolve(), day, known or airframe, own, study, symmetric)
            for day in read.days
        ]
    out.mkdir(parents=True, exist_ok=True)
    kept = Journal(out / f"{digest_of(work)[:12]}.partial", digest_of(work), DayResult)
    done = run_journaled("days", work, run_day, workers_of(jobs, cluster), kept)
    rows = {name: [row for day in done for row in day.rows.get(name, [])] for name in names}
    standings = [standing(name, rows[name]) for name in names]
    if study == STATES:
        sheet = states_sheet(rows, OURS)
    elif study == COLD_STARTS:
        sheet = cold_starts_sheet(rows)
    else:
        sheet = leader_board(standings, len(rows[names[0]]), len(work))
    written = sheet.write(out, "windbench" if study == "board" else study.replace("-", "_"))
    typer.echo(sheet.markdown())
    if json is not None:
        content = {"format": "windbench/1", "standings": standings, "windows": rows}
        write_whole(json, msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n")
        written.append(json)
    typer.echo("wrote " + ", ".join(str(path) for path in written), err=True)
    kept.remove()
