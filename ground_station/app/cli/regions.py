"""`ground-station plan --trucks`: divide large days among their trucks and plan each region."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.desk_options import read_day_and_warn, with_start_if_windows

if TYPE_CHECKING:
    from rich.console import Console

    from ground_station.adapters.workers.side_by_side import WorkerOptions
    from ground_station.app.options.desk_options import PolicyName
    from ground_station.app.planning.region_days import PlanTask, RegionDay, RegionResult

EXIT_LOST = 1
"""Exit code if a planning process was killed twice."""

NEIGHBOUR_NOTE = (
    "Near a border drones of two trucks are separated by their companions, not by the plan: each"
    " day names its neighbours; run every companion with --keep-apart. With identities:"
    " `ground-station pki add FOLDER --role neighbour` first."
)


def divide_and_plan_days(
    console: "Console",
    days: list[str],
    trucks: list[int],
    out: Path,
    workers: "WorkerOptions",
    *,
    policy: "PolicyName",
    trials: int | None,
    seed: int,
    strict: bool,
    at: str | None,
) -> None:
    """Divide `days` among `trucks` of each, write the regions into `out` and plan each one.

    Exits with LOST if a region could not be planned.
    """
    from ground_station.adapters.files.params import resolve_day_file_path
    from ground_station.app.planning.region_days import (
        PlanTask,
        divide_days_among_trucks,
        write_region_day_and_orders,
    )

    if len(trucks) != len(days):
        raise LeewayError(f"--trucks: {len(trucks)} for {len(days)} days: expected one for each")
    paths = [resolve_day_file_path(day) for day in days]
    data = [read_day_and_warn(str(path), strict=strict) for path in paths]
    timed = (one for one in data if any(order.window != (None, None) for order in one.orders))
    start_us = with_start_if_windows(next(timed, data[0]), at).start_us
    data = [replace(one, start_us=start_us) for one in data]
    regions = divide_days_among_trucks(data, trucks)
    out.mkdir(parents=True, exist_ok=True)
    source = [path for path, count in zip(paths, trucks, strict=True) for _ in range(count)]
    files = [
        write_region_day_and_orders(out, region, path)
        for region, path in zip(regions, source, strict=True)
    ]
    work = [
        PlanTask(str(file.resolve()), policy.value, trials, seed, region.data.start_us)
        for file, region in zip(files, regions, strict=True)
    ]
    results = _plan_regions_with_progress(console, regions, work, workers)
    _print_regions(console, regions, results)
    lost = [one for one in results if one.plan is None]
    for one in lost:
        typer.echo(f"not planned: {one.region.name}: {one.error_text}")
    if lost:
        raise typer.Exit(EXIT_LOST)


def _plan_regions_with_progress(
    console: "Console",
    regions: "list[RegionDay]",
    plan_tasks: "list[PlanTask]",
    workers: "WorkerOptions",
) -> "list[RegionResult]":
    from rich.progress import Progress

    from ground_station.app.planning.region_days import plan_and_write_regions

    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("regions planned", total=len(regions))

        def show_planned(region_result: "RegionResult") -> None:
            bar.advance(task)
            if not console.is_terminal:
                typer.echo(f"planned: {region_result.region.name}", err=True)

        return plan_and_write_regions(regions, plan_tasks, workers, show_planned, bar.console.print)


def _print_regions(
    console: "Console", regions: "list[RegionDay]", results: "list[RegionResult]"
) -> None:
    from ground_station.app.views.terminal import plain_table

    table = plain_table(
        "region", "orders", "drones", "work min", "plan min", "by drone", "unplanned", "CPU s"
    )
    for number, region in enumerate(regions):
        counts = (str(len(region.data.orders)), str(len(region.data.day.drones)))
        cells = ("", "", "", "")
        plan = results[number].plan
        if plan is not None:
            cpu_text = f"{results[number].cpu_s:.1f}"
            unplanned = str(len(plan.unplanned))
            cells = (f"{plan.makespan_s / 60.0:.1f}", str(len(plan.sorties)), unplanned, cpu_text)
        table.add_row(region.name, *counts, f"{region.work_s / 60.0:.1f}", *cells)
    console.print(table)
    if len(regions) > 1:
        console.print(NEIGHBOUR_NOTE, highlight=False, markup=False)
