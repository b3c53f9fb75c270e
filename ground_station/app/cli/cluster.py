"""The day's customers in groups: `ground-station cluster` by any of the methods, `divide` a large
day among its trucks.
"""

import math
import os
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.cli.options import DayArgument, PolicyName, open_day

if TYPE_CHECKING:
    from rich.console import Console

    from ground_station.adapters.workers.side_by_side import Workers
    from ground_station.app.planning.region_balance import BalanceRound
    from ground_station.app.planning.region_days import PlanWork, RegionDay, RegionPlanned
    from ground_station.core.clustering.problem import Clustered, ClusteringProblem

app = typer.Typer()

LOST = 1
"""Exit code where a process that planned was killed twice."""

BY_EACH_OTHER = (
    "Near a border drones of two trucks are kept apart by each other, not by plan: each day names"
    " its neighbours, and every companion must fly with --keep-apart. With identities:"
    " `ground-station pki neighbours` first."
)


class MethodName(StrEnum):
    """The clustering method."""

    OURS = "ours"
    KMEANS = "kmeans"
    NONE = "none"
    LLM = "llm"


@app.command()
def cluster(
    day: DayArgument,
    method: Annotated[MethodName, typer.Option(help="Clustering method.")] = MethodName.OURS,
    groups: Annotated[int, typer.Option(min=1, help="Number of groups to aim at.")] = 3,
    voltage: Annotated[
        float | None, typer.Option(min=1.0, help="Resting voltage of the weakest drone, V.")
    ] = None,
    llm_url: Annotated[
        str | None, typer.Option(help="An OpenAI-compatible server: http://HOST:PORT/v1.")
    ] = None,
    llm_model: Annotated[str | None, typer.Option(help="The model's name there.")] = None,
    llm_key: Annotated[Path | None, typer.Option(help="A file with the key, if any.")] = None,
    llm_timeout: Annotated[
        float, typer.Option(min=1.0, help="Time-out of the LLM, s; then ours is used.")
    ] = 30.0,
    llm_log: Annotated[
        Path, typer.Option(help="Prompt, answer and repair are appended to this file.")
    ] = Path("llm.jsonl"),
) -> None:
    """Group the day's customers. A method's proposal is checked and repaired before it is used.

    ground-station cluster harbour --method ours --groups 2
    """
    from rich.console import Console

    from ground_station.adapters.llm import LlmParams
    from ground_station.app.planning.clusters import BUILT_IN, cluster_by_llm, problem_of

    data = open_day(day)
    console = Console()
    with console.status("energy of every delivery from every stop"):
        problem = problem_of(data, groups, voltage)
    if method is MethodName.LLM:
        if llm_url is None or llm_model is None:
            raise LeewayError("--method llm: expected --llm-url and --llm-model")
        key = _key(llm_key)
        with console.status(f"asking {llm_model}"):
            params = LlmParams(llm_url, llm_model, key, llm_timeout)
            made = cluster_by_llm(problem, params, llm_log)
    else:
        made = BUILT_IN[method.value](problem)
    _show(console, problem, made)


def _show(console: "Console", problem: "ClusteringProblem", made: "Clustered") -> None:
    from ground_station.app.views.terminal import listing

    index = problem.index()
    table = listing("stop", "customers", "kg", "mean Wh", title=f"by {made.method}")
    total_wh = 0.0
    for group in made.clusters:
        mine = [index[id_] for id_ in group.customers]
        wh = sum(float(problem.energy_wh[index[group.stop], i]) for i in mine)
        total_wh += wh
        words = f"{wh:.0f}" if math.isfinite(wh) else "out of reach"
        mass_kg = float(problem.mass_kg[mine].sum())
        table.add_row(group.stop, ", ".join(group.customers), f"{mass_kg:g}", words)
    console.print(table)
    seen = problem.conditions
    to_n, to_e = seen.wind_to_ne_mps
    typer.echo(
        f"coverage {seen.coverage_m:.0f} m, wind to ({to_n:.1f}, {to_e:.1f}) m/s,"
        f" voltage {seen.voltage_v or 'unknown'}, lines blocked {100 * seen.obstacle_frac:.0f} %"
    )
    for note in made.notes:
        typer.echo(note)


def _key(path: Path | None) -> str | None:
    if path is None:
        return None
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LeewayError(
            f"{path}: expected an ASCII key, but byte {error.start} is not ASCII"
        ) from error


@app.command()
def divide(
    days: Annotated[
        list[str],
        typer.Argument(
            metavar="DAY...",
            help="A day/1 file (or a bundled name) for each depot, its drones in it.",
        ),
    ],
    trucks: Annotated[
        list[int],
        typer.Option(
            "--trucks", min=1, help="How many start from a depot; once for each DAY, in order."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the regions' days, orders and plans.")],
    plan: Annotated[bool, typer.Option(help="Plan each region.")] = True,
    balance: Annotated[
        bool,
        typer.Option(
            help="Make short plans first and move orders from trucks that are back late to the"
            " others. Without it, or with --no-plan, regions have as much work by a measure."
        ),
    ] = True,
    policy: Annotated[
        PolicyName,
        typer.Option(help="As of `plan`; dynamic takes a tenth of the time or less."),
    ] = PolicyName.SEARCH,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials of each search. Default: by its size.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of each search.")] = 0,
    jobs: Annotated[int, typer.Option(min=0, help="Plans at a time; 0: all cores.")] = 0,
    cluster: Annotated[
        str | None,
        typer.Option(help="A Ray cluster instead of --jobs: local, auto or an address."),
    ] = None,
) -> None:
    """Divide a large day among its trucks, and plan each truck's day.

    The days' orders are pooled, and each truck gets a region of them: orders that lie together, so
    many that the trucks come back together by short plans. Each depot's drones are dealt out to its
    trucks. Writes NAME-K.toml with its orders and its plan for each truck; `ground-station
    dispatch` takes them, a desk for each. The same days give the same regions and plans, whatever
    --jobs.

    ground-station divide north.toml south.toml --trucks 5 --trucks 5 --out regions

    Exit code 0, 1 where a process that planned was killed twice, 2 for a mistake in the input.
    """
    from rich.console import Console

    from ground_station.adapters.files.day_files import read_day
    from ground_station.adapters.files.params import day_file
    from ground_station.adapters.workers.side_by_side import Workers
    from ground_station.app.planning.region_balance import ShortPlans, balanced
    from ground_station.app.planning.region_days import PlanWork, divided, write_region

    if len(trucks) != len(days):
        raise LeewayError(f"--trucks: {len(trucks)} for {len(days)} days: expected one for each")
    paths = [day_file(day) for day in days]
    read = [read_day(path) for path in paths]
    regions = divided(read, trucks)
    out.mkdir(parents=True, exist_ok=True)
    beside = [path for path, count in zip(paths, trucks, strict=True) for _ in range(count)]
    workers = Workers(jobs or len(os.sched_getaffinity(0)), cluster)
    console = Console()
    if plan and balance and len(regions) > 1:
        console.print("short plans of all regions:", highlight=False)
        short = ShortPlans(trials, seed, workers, out, beside)
        regions = balanced(read, trucks, regions, short, partial(_show_round, console))
    files = [write_region(out, region, path) for region, path in zip(regions, beside, strict=True)]
    if not plan:
        _show_regions(console, regions, None)
        return
    work = [PlanWork(str(file.resolve()), policy.value, trials, seed) for file in files]
    done = _with_progress(console, regions, work, workers)
    _show_regions(console, regions, done)
    lost = [one for one in done if one.plan is None]
    for one in lost:
        console.print(f"lost: {one.region.name}: {one.lost}", highlight=False, markup=False)
    if lost:
        raise typer.Exit(LOST)


def _show_round(console: "Console", one: "BalanceRound") -> None:
    last, mean = one.last_s / 60.0, one.mean_s / 60.0
    words = f"  round {one.number}: last truck back after {last:.0f} min, the mean one {mean:.0f}"
    if one.nobody:
        words += f"; {one.nobody} orders that nobody brings"
    console.print(words, highlight=False)


def _with_progress(
    console: "Console",
    regions: "list[RegionDay]",
    work: "list[PlanWork]",
    workers: "Workers",
) -> "list[RegionPlanned]":
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from ground_station.app.planning.region_days import planned

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bar:
        task = bar.add_task("regions planned", total=len(regions))

        def tell(one: "RegionPlanned") -> None:
            bar.advance(task)
            if not console.is_terminal:
                typer.echo(f"planned: {one.region.name}", err=True)

        return planned(regions, work, workers, tell, bar.console.print)


def _show_regions(
    console: "Console", regions: "list[RegionDay]", done: "list[RegionPlanned] | None"
) -> None:
    from ground_station.app.views.terminal import listing

    table = listing(
        "region", "orders", "drones", "work min", "plan min", "by drone", "nobody", "CPU s"
    )
    for number, region in enumerate(regions):
        counts = (str(len(region.data.orders)), str(len(region.data.day.drones)))
        words = ("", "", "", "")
        plan = None if done is None else done[number].plan
        if done is not None and plan is not None:
            spent = f"{done[number].cpu_s:.1f}"
            nobody = str(len(plan.unplanned))
            words = (f"{plan.makespan_s / 60.0:.1f}", str(len(plan.sorties)), nobody, spent)
        table.add_row(region.name, *counts, f"{region.work_s / 60.0:.1f}", *words)
    console.print(table)
    if len(regions) > 1:
        console.print(BY_EACH_OTHER, highlight=False, markup=False)
