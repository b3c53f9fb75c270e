"""The suite as a command flies it: shown as it goes, kept flight by flight, gone on with later."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from sim_bridge.adapters.journal import Journal, digest_of
from sim_bridge.app.fault_suite import report
from sim_bridge.app.fault_suite.suite import run_all
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.trials.trial import Bounds


def journal_of(json_out: Path, todo: Sequence[FaultTask]) -> Journal[FaultRow]:
    """Which of these flights have been flown: a file beside the result until all have been."""
    tight = ["tight"] if any(task.tight for task in todo) else []
    flights = [(task.fault, task.autopilot, task.phase, task.seed, *tight) for task in todo]
    path = json_out.with_name(json_out.name + ".partial")
    return Journal(path, digest_of(flights), FaultRow)


@dataclass(slots=True)
class Session:
    """All of `todo`, or what there is time for. `json_out` None: nothing is kept."""

    todo: Sequence[FaultTask]
    bounds: Bounds
    json_out: Path | None
    console: Console = field(default_factory=Console)
    journal: Journal[FaultRow] | None = field(init=False)
    """What has been flown of it."""
    lost: list[str] = field(default_factory=list)
    """Flights whose workers were killed twice: they are no row, and flown by the same command."""

    @property
    def is_tight(self) -> bool:
        """P(home) is judged over its flights."""
        return any(task.tight for task in self.todo)

    def __post_init__(self) -> None:
        self.journal = None if self.json_out is None else journal_of(self.json_out, self.todo)

    def run(self) -> list[FaultRow]:
        """Fly, and sum up; in the order of `todo` all that have been flown, earlier ones too."""
        done = {} if self.journal is None else self.journal.read()
        with self._keeping(done) as keep, Progress(console=self.console, transient=True) as bar:
            total = len(self.todo)
            flights = bar.add_task(f"{total} flights", total=total, completed=len(done))

            def flown(index: int, row: FaultRow) -> None:
                report.broke(self.console, row)
                bar.advance(flights)
                keep(index, row)

            def lost(index: int, why: str) -> None:
                task = self.todo[index]
                name = f"{task.fault} {task.autopilot} {task.phase} seed {task.seed}"
                self.lost.append(f"{name}: {why}")
                report.lost(self.console, self.lost[-1])
                bar.advance(flights)

            rows = run_all(self.todo, self.bounds, done, flown, lost, self.console.print)
        self._end(rows)
        return rows

    @contextlib.contextmanager
    def _keeping(self, done: dict[int, FaultRow]) -> Iterator[Callable[[int, FaultRow], None]]:
        if self.journal is None:
            yield lambda index, row: None
            return
        rows = dict(done)
        with self.journal.writing(done) as add:

            def keep(index: int, row: FaultRow) -> None:
                rows[index] = row
                add(index, row)
                self._write([rows[number] for number in sorted(rows)])

            yield keep

    def _write(self, rows: Sequence[FaultRow]) -> None:
        if self.json_out is not None:
            report.write(self.json_out, rows, len(self.todo) - len(rows), self.lost)

    def _end(self, rows: Sequence[FaultRow]) -> None:
        self._write(rows)
        self.console.print(report.summary(rows))
        for table in report.promises(rows, by_fault=self.is_tight):
            self.console.print(table)
        self.console.print(report.spent(rows), highlight=False)
        for words in self.lost:
            report.lost(self.console, words)
        if len(rows) < len(self.todo):
            again = "" if self.journal is None else "; the same command goes on"
            words = f"{len(rows)} of {len(self.todo)} flown{again}"
            self.console.print(words, highlight=False)
        elif self.journal is not None:
            self.journal.remove()
