"""Runs a study: its cases on processes or a Ray cluster, then tables, JSON and pictures.

A journal stores finished cases until the result is written, so that the same command resumes an
interrupted run.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.journal import ProgressLog, work_digest
from ground_station.adapters.workers.side_by_side import ItemLost, WorkerOptions, run_parallel
from sim_bridge.adapters.json_result import write_json_result

if TYPE_CHECKING:
    from rich.progress import Progress

    from sim_bridge.research.study.sheet import Sheet

Case = TypeVar("Case")
Result = TypeVar("Result")

INTERRUPTED_EXIT_CODE = 130
"""The shell's exit code for a program that Ctrl-C ended."""

LOST_EXIT_CODE = 1
"""Exit code if workers were killed and cases are missing."""


@dataclass(frozen=True, slots=True)
class Experiment(Generic[Case, Result]):
    """Cases that are independent of one another, and the function that evaluates one.

    `evaluate` is a module-level function, so that other processes can import it; `result` is its
    return type, as msgspec decodes it from the journal. The `repr` of the cases identifies the
    study. `note` of a result is printed once above the progress bar, unless empty.
    """

    title: str
    cases: Sequence[Case]
    evaluate: Callable[[Case], Result]
    result: Any
    note: Callable[[Result], str] = lambda _: ""


@dataclass(frozen=True, slots=True)
class Report:
    """Tables by file stem, a JSON document (default: the tables), and pictures by file name."""

    sheets: Mapping[str, "Sheet"]
    document: object | None = None
    pictures: Mapping[str, Callable[[Path], None]] = field(default_factory=dict)


class ExperimentRun:
    """Run of one command: output folder, workers and journals."""

    def __init__(
        self, out: Path, workers: WorkerOptions | None = None, json: Path | None = None
    ) -> None:
        """Raises LeewayError if the folder of the JSON file does not exist."""
        if json is not None and not json.parent.is_dir():
            raise LeewayError(f"{json}: its folder does not exist")
        self._out, self._json, self._workers = out, json, workers or WorkerOptions()
        self._journals: list[ProgressLog[Any]] = []

    def print_message(self, message: str) -> None:
        """Print a message on stderr: progress, or a part of the input that is not used."""
        typer.echo(message, err=True)

    def run_cases_and_return_results(self, experiment: Experiment[Case, Result]) -> list[Result]:
        """Return the results of all cases in order; exits 1 if workers were lost, 130 on Ctrl-C."""
        digest = work_digest(experiment.cases)
        case_store = ProgressLog(self._out / f"{digest[:12]}.partial", digest, experiment.result)
        self._journals.append(case_store)
        done, lost = case_store.read_finished_results(), dict[int, str]()
        pending = [k for k in range(len(experiment.cases)) if k not in done]
        notes: set[str] = set()
        with create_progress_bar() as bar, case_store.rewrite_and_open_writer(done) as keep:
            shown = bar.add_task(experiment.title, total=len(experiment.cases), completed=len(done))

            def print_line(line: str) -> None:
                bar.console.print(line, highlight=False, markup=False)

            cases = (experiment.cases[k] for k in pending)
            try:
                for ended in run_parallel(cases, experiment.evaluate, self._workers, print_line):
                    index = pending[ended.index]
                    if isinstance(ended, ItemLost):
                        lost[index] = ended.reason
                        continue
                    keep(index, ended.result)
                    done[index] = ended.result
                    if (words := experiment.note(ended.result)) and words not in notes:
                        notes.add(words)
                        print_line(words)
                    bar.update(shown, completed=len(done))
            except KeyboardInterrupt:
                typer.echo(
                    f"stopped; {case_store.path} keeps finished cases; run the same command to"
                    " resume",
                    err=True,
                )
                raise typer.Exit(INTERRUPTED_EXIT_CODE) from None
        for index, reason in sorted(lost.items()):
            name = f"{experiment.title}, {index + 1} of {len(experiment.cases)}"
            typer.echo(f"lost: {name}: {reason}: {str(experiment.cases[index])[:200]}", err=True)
        if lost:
            kept = f"{case_store.path} keeps the other {len(done)}; run the same command to retry"
            typer.echo(kept, err=True)
            raise typer.Exit(LOST_EXIT_CODE)
        return [done[k] for k in range(len(experiment.cases))]

    def print_and_write_report(self, report: Report) -> None:
        """Print the tables, write everything, and remove the journals."""
        self._out.mkdir(parents=True, exist_ok=True)
        output_paths: list[Path] = []
        for stem, sheet in report.sheets.items():
            output_paths += sheet.write_markdown_and_csv(self._out, stem)
            typer.echo(sheet.to_markdown())
        for name, draw in report.pictures.items():
            draw(self._out / name)
            output_paths.append(self._out / name)
        if self._json is not None:
            tables = {stem: sheet.to_records() for stem, sheet in report.sheets.items()}
            write_json_result(self._json, report.document or tables, indent=1)
            output_paths.append(self._json)
        typer.echo("wrote " + ", ".join(str(path) for path in output_paths), err=True)
        for case_store in self._journals:
            case_store.remove_file()


def create_progress_bar(transient: bool = True) -> "Progress":
    """Return a progress bar on stderr with completed and total cases and time left."""
    from rich import progress
    from rich.console import Console

    return progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=transient,
    )
