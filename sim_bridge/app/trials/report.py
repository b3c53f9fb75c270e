"""Terminal output of a trial: progress, failed cases with their files, and the result."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from sim_bridge.adapters.json_result import write_json_result
from sim_bridge.app.trials.trial import TrialRow, build_trial_result, write_case_file

CASES_FOLDER = "cases"


def _format_counts(values: list[Any]) -> str:
    counts = Counter(map(str, values)).most_common()
    return ", ".join(f"{name} {n}" for name, n in counts)


SUMMARIES: tuple[tuple[tuple[str, ...], int, Callable[[list[Any]], str]], ...] = (
    (("ended", "home", "phase", "then", "kind"), 1, _format_counts),
    (
        ("vehicle_h", "flown_h", "flights", "delivered", "orders", "taken_over"),
        2,
        lambda values: f"{round(sum(values), 3)} in total",
    ),
    (
        ("desk_kills", "companion_kills", "store_outages", "network_cuts", "member_cuts"),
        2,
        lambda values: f"{sum(values)} in total, at least {min(values)} each",
    ),
    (("longest_cut_s",), 1, lambda values: f"at least {min(values)}"),
    (("cpu_s", "grown_mb"), 1, lambda values: f"at most {max(values)}"),
)
"""Keys of metrics, least number of rows, and how their values are summarised at the end."""

FIRST_ROW_KEYS = ("flights", "memory_mb", "growth_mb", "slope_mb_per_h", "files", "threads",
        "disk_mb_per_flight")  # fmt: skip


def show_and_save_rows(
    trial: str,
    seed: int,
    rows: Iterable[TrialRow],
    total: int | None,
    run_root: Path,
    json_out: Path | None,
) -> bool:
    """Show and save each row as it arrives; return whether all passed. `total` None: unknown."""
    console = Console()
    done: list[TrialRow] = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bar:
        task = bar.add_task(trial, total=total)
        for row in rows:
            done.append(row)
            if not row.passed:
                path = write_case_file(run_root / CASES_FOLDER, row)
                console.print(f"failed: {row.name}: {row.reason}", highlight=False, markup=False)
                rerun_hint = f"  rerun: sim-bridge trials {trial} --case {path}"
                console.print(rerun_hint, highlight=False, markup=False, soft_wrap=True)
            bar.advance(task)
            if json_out is not None:
                write_json_result(json_out, build_trial_result(trial, seed, done))
    for line in _summary_lines(f"{trial}, seed {seed}", done):
        console.print(line, highlight=False, markup=False)
    return all(row.passed for row in done)


def _summary_lines(title: str, rows: list[TrialRow]) -> Iterator[str]:
    yield f"{title}: {sum(row.passed for row in rows)} of {len(rows)} passed"
    for keys, least_rows, summarise in SUMMARIES:
        for key in keys:
            values = [row.metrics[key] for row in rows if key in row.metrics]
            if len(values) >= least_rows:
                yield f"  {key}: {summarise(values)}"
    first = rows[0].metrics if rows else {}
    yield from (f"  {key}: {first[key]}" for key in FIRST_ROW_KEYS if key in first)
