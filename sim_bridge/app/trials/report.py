"""Terminal output of a trial: progress, failed cases with their files, and the result."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class TrialReport:
    """Output folders and settings for a trial's messages, cases and rows."""

    trial: str
    seed: int
    run_root: Path
    json_out: Path | None

    def show_and_save_rows(self, rows: Iterable[TrialRow], total: int | None) -> list[TrialRow]:
        """Show and save each row as it arrives; return all rows. `total` None: unknown."""
        console = Console()
        done: list[TrialRow] = []
        with _progress_bar(console) as bar:
            task = bar.add_task(self.trial, total=total)
            for row in rows:
                done.append(row)
                self._save_and_print_if_failed(console, row)
                bar.advance(task)
                if self.json_out is not None:
                    write_json_result(
                        self.json_out, build_trial_result(self.trial, self.seed, done)
                    )
        self._print_summary(console, done)
        return done

    def _save_and_print_if_failed(self, console: Console, row: TrialRow) -> None:
        if row.passed:
            return
        path = write_case_file(self.run_root / CASES_FOLDER, row)
        console.print(f"failed: {row.name}: {row.reason}", highlight=False, markup=False)
        rerun_hint = f"  rerun: sim-bridge trials {self.trial} --case {path}"
        console.print(rerun_hint, highlight=False, markup=False, soft_wrap=True)

    def _print_summary(self, console: Console, rows: list[TrialRow]) -> None:
        passed_count = sum(row.passed for row in rows)
        lines = [f"{self.trial}, seed {self.seed}: {passed_count} of {len(rows)} passed"]
        for keys, least_rows, summarise in SUMMARIES:
            for key in keys:
                values = [row.metrics[key] for row in rows if key in row.metrics]
                if len(values) >= least_rows:
                    lines.append(f"  {key}: {summarise(values)}")
        lines += [
            f"  {key}: {rows[0].metrics[key]}"
            for key in FIRST_ROW_KEYS
            if rows and key in rows[0].metrics
        ]
        for line in lines:
            console.print(line, highlight=False, markup=False)


def _progress_bar(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    return Progress(*columns, TimeElapsedColumn(), console=console, transient=True)
