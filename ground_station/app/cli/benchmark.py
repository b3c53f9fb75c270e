"""`ground-station benchmark`: the planner against published results, and its speed."""

import json
from dataclasses import asdict
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError

if TYPE_CHECKING:
    from rich.console import Console

    from ground_station.app.benchmarks.mfstsp_bench import BenchParams, BenchRow, Row, RowJournal
    from ground_station.core.planning.day_planner import PlanParams

benchmark = typer.Typer(no_args_is_help=True, help="The planner against published results.")
POLICIES = ("search", "dynamic-assignment")


@benchmark.command()
def mfstsp(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Problem folders, tbl_vehicles_*.csv, reference_results.csv."
        ),
    ],
    vehicles: Annotated[str, typer.Option(help="Vehicle files.")] = "101,102,103,104",
    drones: Annotated[str, typer.Option(help="Numbers of drones.")] = "1,2,3,4",
    seconds: Annotated[
        float | None,
        typer.Option(
            min=0.05,
            help="Processor seconds for each row. Default: a fixed number of trials, which gives "
            "the same plan every time.",
        ),
    ] = None,
    json_out: Annotated[
        Path | None,
        typer.Option("--json", help="Write the rows into this file; also makes the run resumable."),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Rows at a time, each on one core.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the search.")] = 0,
    policy: Annotated[str, typer.Option(help=f"One of {', '.join(POLICIES)}.")] = "search",
    problems: Annotated[
        str | None, typer.Option(help="Only these problems: names, or first:step as in 1:3.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the last row's plan into this PNG.")
    ] = None,
) -> None:
    """Murray and Raj's mFSTSP: plan every row, check it, compare it with the published makespans.

    ground-station benchmark mfstsp mfstsp/ --seconds 60 --json mfstsp.json

    Ctrl-C keeps the rows that are done in a journal beside the JSON file; the same command goes on
    from there.
    """
    if policy not in POLICIES:
        raise LeewayError(f"--policy {policy}: expected one of {', '.join(POLICIES)}")

    from rich.console import Console

    from ground_station.adapters.files.compiled_code import keep_compiled_code
    from ground_station.adapters.files.mfstsp_files import RESULTS, problem_folders, read_published
    from ground_station.app.benchmarks.mfstsp_bench import (
        BenchParams,
        RowJournal,
        RowsLost,
        rows_to_plan,
        settings_of,
    )
    from ground_station.app.benchmarks.mfstsp_report import print_report

    console = Console()
    folders = _chosen(problem_folders(folder), problems)
    rows = rows_to_plan(folders, _names(vehicles), _numbers(drones))
    params = BenchParams(seconds, seed, policy)
    heuristic, program = read_published(folder / RESULTS)
    if not keep_compiled_code():
        console.print("first run: compiling the planner, some 20 s", highlight=False)
    journal = RowJournal(json_out, settings_of(rows, params))
    try:
        done = _with_progress(console, rows, params, jobs, journal)
    except KeyboardInterrupt:
        kept = "the same command goes on from there" if json_out else "nothing kept without --json"
        console.print(f"stopped; {kept}", highlight=False)
        raise typer.Exit(130) from None
    except RowsLost as error:
        console.print(str(error), highlight=False, markup=False)
        raise typer.Exit(1) from None
    if json_out is not None:
        _write(json_out, done)
        journal.remove()
    print_report(console, done, heuristic, program)
    if picture is not None:
        from ground_station.app.pictures.tour_picture import draw_row

        draw_row(folder, done[-1], picture)
        console.print(f"{picture}: {done[-1]['problem']}", highlight=False)


def _with_progress(
    console: "Console",
    rows: "list[BenchRow]",
    params: "BenchParams",
    jobs: int,
    journal: "RowJournal",
) -> "list[Row]":
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from ground_station.app.benchmarks.mfstsp_bench import run_rows

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
    ) as progress:
        bar = progress.add_task("planning", total=len(rows))

        def tell(number: int, row: "Row") -> None:
            said = f"{row['problem']} {row['vehicles']} x{row['drones']}: {row['makespan_s']:.0f} s"
            progress.update(bar, advance=1, description=said)

        return run_rows(rows, params, jobs, journal, tell)


def _write(path: Path, rows: "list[Row]") -> None:
    """Write the file whole or not at all."""
    fresh = path.with_name(path.name + ".new")
    fresh.write_text(json.dumps({"rows": rows}) + "\n", encoding="utf-8")
    fresh.replace(path)


def _names(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _numbers(text: str) -> list[int]:
    try:
        numbers = [int(part) for part in _names(text)]
    except ValueError as error:
        raise LeewayError(f"--drones {text}: expected numbers, as in 1,2,3,4") from error
    if not numbers or min(numbers) < 1:
        raise LeewayError(f"--drones {text}: expected one drone at least")
    return numbers


def _chosen(folders: list[Path], text: str | None) -> list[Path]:
    """All, those named, or first:step: every step-th, counted from 0 in order of names."""
    if text is None:
        return folders
    if ":" in text:
        try:
            first, step = (int(part) for part in text.split(":"))
            chosen = folders[first::step]
        except ValueError as error:
            raise LeewayError(f"--problems {text}: expected first:step, as in 1:3") from error
    else:
        by_name = {folder.name: folder for folder in folders}
        unknown = [name for name in _names(text) if name not in by_name]
        if unknown:
            raise LeewayError(f"--problems: no folder {unknown[0]} in {folders[0].parent}")
        chosen = [by_name[name] for name in _names(text)]
    if not chosen:
        raise LeewayError(f"--problems {text}: names none of {len(folders)} problems")
    return chosen


@benchmark.command()
def tspd(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Instances (*.txt), reference_means.csv."),
    ],
    seconds: Annotated[
        float | None,
        typer.Option(
            min=0.05,
            help="Processor seconds for each row. Default: a fixed number of trials, which gives "
            "the same plan every time.",
        ),
    ] = None,
    published_times: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Seconds for each row as a multiple of the published solver's (ICP), where known.",
        ),
    ] = None,
    json_out: Annotated[
        Path | None,
        typer.Option("--json", help="Write the rows into this file; also makes the run resumable."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the search.")] = 0,
    instances: Annotated[
        str | None,
        typer.Option(
            help="Only these: patterns of names with commas between, as in uniform-*-n50."
        ),
    ] = None,
) -> None:
    """One truck and one drone (Agatz, Bouman and Schmidt): plan every instance, check it, compare
    with published means and proven optima.

    ground-station benchmark tspd tspd/ --seconds 10 --json tspd.json

    Ctrl-C keeps the rows that are done in a journal beside the JSON file; the same command goes on
    from there.
    """
    from rich.console import Console
    from rich.progress import track

    from ground_station.adapters.files.compiled_code import keep_compiled_code
    from ground_station.adapters.files.tspd_files import (
        MEANS,
        instance_files,
        read_means,
        read_optimum,
    )

    console = Console()
    files = _matching(instance_files(folder), instances)
    found = (one / MEANS for one in (folder, folder.parent) if (one / MEANS).exists())
    means = read_means(next(found, folder / MEANS))
    optima = {path.stem: cost for path in files if (cost := read_optimum(path)) is not None}
    if not keep_compiled_code():
        console.print("first run: compiling the planner, some 20 s", highlight=False)
    from ground_station.app.benchmarks.mfstsp_bench import RowJournal
    from ground_station.app.benchmarks.tspd_bench import (
        TspdParams,
        read_instances,
        solved_instances,
        tspd_settings,
    )
    from ground_station.app.benchmarks.tspd_report import print_tspd_report

    params = TspdParams(seconds, published_times, seed)
    read = read_instances(files)
    journal = RowJournal(json_out, tspd_settings(files, params))
    try:
        solved = solved_instances(read, means, params, journal)
        rows = list(track(solved, "planning", total=len(files), console=console))
    except KeyboardInterrupt:
        kept = "the same command goes on from there" if json_out else "nothing kept without --json"
        console.print(f"stopped; {kept}", highlight=False)
        raise typer.Exit(130) from None
    if json_out is not None:
        _write(json_out, rows)
        journal.remove()
    print_tspd_report(console, rows, means, optima)


def _matching(files: list[Path], patterns: str | None) -> list[Path]:
    """All, or those whose name fits one of the patterns."""
    if patterns is None:
        return files
    chosen = [path for path in files if any(fnmatch(path.stem, one) for one in _names(patterns))]
    if not chosen:
        raise LeewayError(f"--instances {patterns}: fits none of {len(files)} instances")
    return chosen


@benchmark.command("day-plan")
def day_plan(
    day: Annotated[
        str | None,
        typer.Option(
            help="A day instead of a random one (a day/1 TOML file, or a bundled day's name): for"
            " each plan that the search found, its promised and its driven makespan, and a time"
            " that no plan can beat."
        ),
    ] = None,
    customers: Annotated[int, typer.Option(min=1, help="Orders of the day.")] = 200,
    drones: Annotated[int, typer.Option(min=1, help="Drones on the truck.")] = 8,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials of the search. Default: by the day's size.")
    ] = None,
    drives: Annotated[
        int,
        typer.Option(
            min=0,
            help="With --day: a long search on driven plans with any stops, so many drives from"
            " each plan that the search found.",
        ),
    ] = 0,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="With --day: write what is found here as JSON.")
    ] = None,
    wind_mps: Annotated[float, typer.Option(min=0.0, help="Wind, m/s, from the west.")] = 5.0,
    seed: Annotated[int, typer.Option(help="Seed of the day.")] = 0,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the default's plan into this PNG.")
    ] = None,
) -> None:
    """How long the plan of a random day takes, and the makespan of each policy.

    ground-station benchmark day-plan --customers 1000
    ground-station benchmark day-plan --day town
    ground-station benchmark day-plan --day town --drives 4000
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    from ground_station.adapters.files.compiled_code import keep_compiled_code

    console = Console()
    if not keep_compiled_code():
        console.print("first run: compiling the planner, some 20 s", highlight=False)
    from ground_station.app.benchmarks.day_bench import DayParams, bench_day, drawn_day, print_day
    from ground_station.app.pictures.day_picture import draw_day_plan
    from ground_station.core.planning.day_planner import PlanParams

    if day is not None:
        params = PlanParams(trials=trials, seed=seed)
        _print_promises(console, day, params, drives, json_out)
        return
    drawn = DayParams(customers, drones, wind_mps, seed)
    with Progress(TextColumn("{task.description}"), BarColumn(), console=console) as progress:
        bar = progress.add_task("planning", total=1.0)
        found = bench_day(
            drawn,
            trials,
            lambda frac, best_s: progress.update(
                bar, completed=frac, description=f"best {best_s:.0f} s"
            ),
        )
    print_day(console, drawn, found)
    if picture is not None:
        draw_day_plan(drawn_day(drawn), found.search, picture)
        console.print(f"{picture}: the default policy's plan", highlight=False)


def _print_promises(
    console: "Console", day: str, params: "PlanParams", drives: int, json_out: Path | None
) -> None:
    from ground_station.app.benchmarks.day_bench import bench_promises, print_promises
    from ground_station.app.cli.options import open_day

    with console.status("planning") as status:
        found = bench_promises(
            open_day(day),
            params,
            drives,
            lambda frac, best_s: status.update(f"best {best_s:.0f} s"),
        )
    print_promises(console, found)
    if json_out is not None:
        json_out.write_text(json.dumps(asdict(found), indent=1) + "\n", encoding="utf-8")
