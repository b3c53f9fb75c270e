"""`ground-station benchmark`: the planner against published results, and its speed."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.atomic_file import write_file_atomically

if TYPE_CHECKING:
    from rich.console import Console

    from ground_station.adapters.workers.journal import ProgressLog
    from ground_station.app.benchmarks.mfstsp_bench import BenchParams, BenchRow, Row

benchmark = typer.Typer(no_args_is_help=True, help="Compare the planner with published results.")
POLICY_NAMES = ("search", "dynamic-assignment")

Seconds = Annotated[
    float | None,
    typer.Option(
        min=0.05,
        help="Processor seconds for each row. Default: a fixed number of trials, which gives "
        "the same plan every time.",
    ),
]
JsonFile = Annotated[
    Path | None,
    typer.Option("--json", help="Write the rows into this file; also makes the run resumable."),
]
Instances = Annotated[
    str | None,
    typer.Option(help="Only these: patterns of names with commas between, as in uniform-*-n50."),
]
Seed = Annotated[int, typer.Option(help="Seed of the search.")]


@contextmanager
def _resumable(console: "Console", json_out: Path | None) -> Iterator[None]:
    """Exit with code 130 at Ctrl-C, and print whether the same command continues."""
    try:
        yield
    except KeyboardInterrupt:
        resume_hint = (
            "the same command continues from there" if json_out else "nothing kept without --json"
        )
        console.print(f"stopped; {resume_hint}", highlight=False)
        raise typer.Exit(130) from None


def _write_rows(json_out: Path | None, rows: "list[Row]", progress_log: "ProgressLog[Row]") -> None:
    if json_out is not None:
        write_file_atomically(json_out, f"{json.dumps({'rows': rows})}\n".encode())
        progress_log.remove_file()


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
    seconds: Seconds = None,
    json_out: JsonFile = None,
    jobs: Annotated[int, typer.Option(min=1, help="Rows at a time, each on one core.")] = 1,
    seed: Seed = 0,
    policy: Annotated[str, typer.Option(help=f"One of {', '.join(POLICY_NAMES)}.")] = "search",
    problems: Annotated[
        str | None, typer.Option(help="Only these problems: names, or first:step as in 1:3.")
    ] = None,
) -> None:
    """Murray and Raj's mFSTSP: plan every row, check it, compare it with the published makespans.

    ground-station benchmark mfstsp mfstsp/ --seconds 60 --json mfstsp.json

    Ctrl-C keeps the completed rows in a journal next to the JSON file; the same command continues
    from there.
    """
    if policy not in POLICY_NAMES:
        raise LeewayError(f"--policy {policy}: expected one of {', '.join(POLICY_NAMES)}")

    from rich.console import Console

    from ground_station.adapters.files.benchmarks.mfstsp_files import (
        RESULTS_FILE,
        find_problem_folders,
        read_reference_results,
    )
    from ground_station.adapters.files.compiled_code import enable_compile_cache_and_print_notice
    from ground_station.app.benchmarks.mfstsp_bench import (
        BenchParams,
        RowsLostError,
        inputs_and_planner_source_digest,
        row_progress_log,
        rows_to_plan,
    )
    from ground_station.app.benchmarks.mfstsp_report import print_report

    console = Console()
    folders = _select_problems(find_problem_folders(folder), problems)
    rows = rows_to_plan(folders, _split_comma_separated(vehicles), _parse_drone_counts(drones))
    params = BenchParams(seconds, seed, policy)
    heuristic, program = read_reference_results(folder / RESULTS_FILE)
    enable_compile_cache_and_print_notice(console)
    progress_log = row_progress_log(json_out, inputs_and_planner_source_digest(rows, params))
    try:
        with _resumable(console, json_out):
            done = _plan_rows_with_progress(console, rows, params, jobs, progress_log)
    except RowsLostError as error:
        console.print(str(error), highlight=False, markup=False)
        raise typer.Exit(1) from None
    _write_rows(json_out, done, progress_log)
    print_report(console, done, heuristic, program)


def _plan_rows_with_progress(
    console: "Console",
    rows: "list[BenchRow]",
    params: "BenchParams",
    jobs: int,
    progress_log: "ProgressLog[Row]",
) -> "list[Row]":
    from rich.progress import Progress

    from ground_station.app.benchmarks.mfstsp_bench import plan_remaining_rows

    with Progress(console=console) as progress:
        bar = progress.add_task("planning", total=len(rows))

        def show_row(number: int, row: "Row") -> None:
            description = (
                f"{row['problem']} {row['vehicles']} x{row['drones']}: {row['makespan_s']:.0f} s"
            )
            progress.update(bar, advance=1, description=description)

        return plan_remaining_rows(rows, params, jobs, progress_log, show_row)


def _split_comma_separated(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _parse_drone_counts(text: str) -> list[int]:
    try:
        numbers = [int(part) for part in _split_comma_separated(text)]
    except ValueError as error:
        raise LeewayError(f"--drones {text}: expected numbers, as in 1,2,3,4") from error
    if not numbers or min(numbers) < 1:
        raise LeewayError(f"--drones {text}: expected one drone at least")
    return numbers


def _select_problems(folders: list[Path], selection: str | None) -> list[Path]:
    """All, those named, or first:step: every step-th, counted from 0 in order of names."""
    if selection is None:
        return folders
    if ":" in selection:
        try:
            first, step = (int(part) for part in selection.split(":"))
            selected = folders[first::step]
        except ValueError as error:
            raise LeewayError(f"--problems {selection}: expected first:step, as in 1:3") from error
    else:
        by_name = {folder.name: folder for folder in folders}
        unknown = [name for name in _split_comma_separated(selection) if name not in by_name]
        if unknown:
            raise LeewayError(f"--problems: no folder {unknown[0]} in {folders[0].parent}")
        selected = [by_name[name] for name in _split_comma_separated(selection)]
    if not selected:
        raise LeewayError(f"--problems {selection}: names none of {len(folders)} problems")
    return selected


@benchmark.command()
def tspd(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Instances (*.txt), reference_means.csv."),
    ],
    seconds: Seconds = None,
    published_times: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Seconds for each row as a multiple of the published solver's (ICP), where known.",
        ),
    ] = None,
    json_out: JsonFile = None,
    seed: Seed = 0,
    instances: Instances = None,
) -> None:
    """One truck and one drone (Agatz, Bouman and Schmidt): plan every instance, check it, compare
    with published means and proven optima.

    ground-station benchmark tspd tspd/ --seconds 10 --json tspd.json

    Ctrl-C keeps the completed rows in a journal next to the JSON file; the same command continues
    from there.
    """
    from rich.console import Console
    from rich.progress import track

    from ground_station.adapters.files.benchmarks.tspd_files import (
        REFERENCE_FILE,
        find_instance_files,
        read_optimum_cost_or_none,
        read_reference_costs,
    )
    from ground_station.adapters.files.compiled_code import enable_compile_cache_and_print_notice

    console = Console()
    files = _select_instances(find_instance_files(folder), instances)
    found = (
        one / REFERENCE_FILE for one in (folder, folder.parent) if (one / REFERENCE_FILE).exists()
    )
    mean_costs = read_reference_costs(next(found, folder / REFERENCE_FILE))
    optima = {
        path.stem: cost for path in files if (cost := read_optimum_cost_or_none(path)) is not None
    }
    enable_compile_cache_and_print_notice(console)
    from ground_station.app.benchmarks.mfstsp_bench import row_progress_log
    from ground_station.app.benchmarks.tspd_bench import (
        TspdParams,
        inputs_and_planner_source_digest,
        plan_or_load_instance_rows,
        read_instances,
    )
    from ground_station.app.benchmarks.tspd_report import print_tspd_report

    params = TspdParams(seconds, published_times, seed)
    read = read_instances(files)
    progress_log = row_progress_log(json_out, inputs_and_planner_source_digest(files, params))
    with _resumable(console, json_out):
        solved = plan_or_load_instance_rows(read, mean_costs, params, progress_log)
        rows = list(track(solved, "planning", total=len(files), console=console))
    _write_rows(json_out, rows, progress_log)
    print_tspd_report(console, rows, mean_costs, optima)


@benchmark.command()
def tsptw(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Instances (*.txt, *.tw).")],
    seconds: Seconds = None,
    best_known: Annotated[
        Path | None, typer.Option(help="Best known makespans: lines of instance and value.")
    ] = None,
    json_out: JsonFile = None,
    seed: Seed = 0,
    instances: Instances = None,
) -> None:
    """Time windows without drones: plan every instance, check it, compare it with the best known.

    ground-station benchmark tsptw Dumas/ --best-known Dumas-makespan.txt --json tsptw.json

    Ctrl-C keeps the completed rows in a journal next to the JSON file; the same command continues
    from there.
    """
    from rich.console import Console
    from rich.progress import track

    from ground_station.adapters.files.benchmarks import tsptw_files
    from ground_station.adapters.files.compiled_code import enable_compile_cache_and_print_notice

    console = Console()
    files = _select_instances(tsptw_files.find_instance_files(folder), instances)
    read = [tsptw_files.read_instance(path) for path in files]
    best_s = tsptw_files.read_best_known(best_known) if best_known else {}
    enable_compile_cache_and_print_notice(console)
    from ground_station.app.benchmarks.mfstsp_bench import row_progress_log
    from ground_station.app.benchmarks.tsptw_bench import (
        plan_or_load_rows,
        print_tsptw_report,
        rows_digest,
    )

    progress_log = row_progress_log(json_out, rows_digest(files, seconds, seed))
    with _resumable(console, json_out):
        planned = plan_or_load_rows(read, best_s, seconds, seed, progress_log)
        rows = list(track(planned, "planning", total=len(files), console=console))
    _write_rows(json_out, rows, progress_log)
    print_tsptw_report(console, rows)


def _select_instances(files: list[Path], patterns: str | None) -> list[Path]:
    """All, or those whose name fits one of the patterns."""
    if patterns is None:
        return files
    selected = [
        path
        for path in files
        if any(fnmatch(path.stem, one) for one in _split_comma_separated(patterns))
    ]
    if not selected:
        raise LeewayError(f"--instances {patterns}: fits none of {len(files)} instances")
    return selected
