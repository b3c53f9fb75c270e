"""What the research commands share: progress on stderr, work that survives Ctrl-C, their output."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

if TYPE_CHECKING:
    from rich.progress import Progress

    from ground_station.adapters.workers.side_by_side import Workers
    from sim_bridge.adapters.journal import Journal
    from sim_bridge.research.results.sheet import Sheet

Work = TypeVar("Work")
Result = TypeVar("Result")

INTERRUPTED = 130
"""The shell's exit code for a program that Ctrl-C ended."""

LOST = 1
"""Exit code where workers were killed, and pieces of work are missing."""

OUT = Path("logs/experiments")
Out = Annotated[Path, typer.Option(help="folder for the tables and pictures")]
Jobs = Annotated[int, typer.Option(help="processes; 0: all cores")]
Cluster = Annotated[
    str | None,
    typer.Option(help="Ray instead of processes: local, auto, or a cluster's address"),
]


def finish(sheet: "Sheet", out: Path, stem: str) -> None:
    """Write the table as Markdown and CSV, and print it."""
    written = sheet.write(out, stem)
    typer.echo(sheet.markdown())
    typer.echo("wrote " + ", ".join(str(path) for path in written), err=True)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file at once: a reader sees the old one or the new one."""
    part = path.with_name(path.name + ".part")
    part.write_bytes(content)
    part.replace(path)


def progress_bar(transient: bool = True) -> "Progress":
    """A bar on stderr with the pieces done, their number and the time left."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=transient,
    )


def workers_of(jobs: int, cluster: str | None) -> "Workers":
    """As `--jobs` and `--cluster` ask."""
    from ground_station.adapters.workers.side_by_side import Workers

    return Workers(jobs or len(os.sched_getaffinity(0)), cluster)


def run_journaled(
    title: str,
    work: Sequence[Work],
    do: Callable[[Work], Result],
    workers: "Workers",
    kept: "Journal[Result]",
) -> list[Result]:
    """`do` of every piece of work, with progress; Ctrl-C leaves what is done in the journal.

    Where workers were killed, what is lost is named once all else is done; exit code 1.
    """
    from sim_bridge.adapters.journal import PiecesLost, journaled_map

    with progress_bar() as bar:
        shown = bar.add_task(title, total=len(work))

        def advance(done: int, total: int) -> None:
            bar.update(shown, completed=done, total=total)

        try:
            return journaled_map(work, do, workers, kept, advance, say_of(bar))
        except KeyboardInterrupt:
            typer.echo(f"stopped; {kept.path} keeps what is done, the same command goes on")
            raise typer.Exit(INTERRUPTED) from None
        except PiecesLost as error:
            for one in error.lost:
                name = f"{title}, {one.index + 1} of {len(work)}"
                typer.echo(f"lost: {name}: {one.why}: {str(one.piece)[:200]}", err=True)
            words = f"{kept.path} keeps the other {error.kept}; the same command tries again"
            typer.echo(words, err=True)
            raise typer.Exit(LOST) from None


def say_of(bar: "Progress") -> Callable[[str], None]:
    """Says something above a bar."""
    return lambda words: bar.console.print(words, highlight=False, markup=False)
