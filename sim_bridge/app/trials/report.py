"""A trial on the terminal: progress, a line for what did not hold, its case's file, the result."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from sim_bridge.app.trials.trial import TrialRow, write_case, write_result

CASES = "cases"
COUNTED = ("ended", "home", "phase", "then", "kind")
"""Of what rows tell: counted at the end."""

SUMMED = ("vehicle_h", "flown_h", "flights", "delivered", "orders", "taken_over")
EACH = ("desk_kills", "companion_kills", "store_outages", "network_cuts", "member_cuts")
"""Summed, with the least of any row."""

LEAST = ("longest_cut_s",)
HIGHEST = ("cpu_s", "grown_mb")
TOLD = ("flights", "memory_mb", "growth_mb", "slope_mb_per_h", "files", "threads",
        "disk_mb_per_flight")  # fmt: skip


@dataclass(frozen=True, slots=True)
class TrialReport:
    """Where a trial's words, cases and rows go."""

    trial: str
    seed: int
    runs: Path
    json_out: Path | None

    def follow(self, rows: Iterable[TrialRow], total: int | None) -> list[TrialRow]:
        """Show and keep each row as it comes; all of them at the end. `total` None: not known."""
        console = Console()
        done: list[TrialRow] = []
        with _bar(console) as bar:
            task = bar.add_task(self.trial, total=total)
            for row in rows:
                done.append(row)
                self._keep(console, row)
                bar.advance(task)
                if self.json_out is not None:
                    write_result(self.json_out, self.trial, self.seed, done)
        self._sum_up(console, done)
        return done

    def _keep(self, console: Console, row: TrialRow) -> None:
        if row.held:
            return
        path = write_case(self.runs / CASES, row)
        console.print(f"broke: {row.name}: {row.why}", highlight=False, markup=False)
        again = f"  again: sim-bridge trials {self.trial} --case {path}"
        console.print(again, highlight=False, markup=False, soft_wrap=True)

    def _sum_up(self, console: Console, rows: list[TrialRow]) -> None:
        held = sum(row.held for row in rows)
        lines = [f"{self.trial}, seed {self.seed}: {held} of {len(rows)} held"]
        for key in COUNTED:
            counts = Counter(str(row.told[key]) for row in rows if key in row.told)
            if counts:
                told = ", ".join(f"{name} {n}" for name, n in counts.most_common())
                lines.append(f"  {key}: {told}")
        for key in SUMMED:
            values = [row.told[key] for row in rows if key in row.told]
            if len(values) > 1:
                lines.append(f"  {key}: {round(sum(values), 3)} in all")
        for key in EACH:
            values = [row.told[key] for row in rows if key in row.told]
            if len(values) > 1:
                lines.append(f"  {key}: {sum(values)} in all, at least {min(values)} each")
        for key in LEAST:
            values = [row.told[key] for row in rows if key in row.told]
            if values:
                lines.append(f"  {key}: at least {min(values)}")
        for key in HIGHEST:
            values = [row.told[key] for row in rows if key in row.told]
            if values:
                lines.append(f"  {key}: at most {max(values)}")
        lines += [f"  {key}: {rows[0].told[key]}" for key in TOLD if rows and key in rows[0].told]
        for line in lines:
            console.print(line, highlight=False, markup=False)


def _bar(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    return Progress(*columns, TimeElapsedColumn(), console=console, transient=True)
