"""What the research commands share: progress on stderr, work that survives Ctrl-C, their output."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

if TYPE_CHECKING:
    from rich.progress import Progress

    from sim_bridge.adapters.journal import Journal
    from sim_bridge.research.results.sheet import Sheet

Work = TypeVar("Work")
Result = TypeVar("Result")

INTERRUPTED = 130
"""The shell's exit code for a program that Ctrl-C ended."""

OUT = Path("logs/experiments")
Out = Annotated[Path, typer.Option(help="folder for the tables and pictures")]
Jobs = Annotated[int, typer.Option(help="processes; 0: all cores")]


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


def run_journaled(
    title: str,
    work: Sequence[Work],
    do: Callable[[Work], Result],
    jobs: int,
    kept: "Journal[Result]",
) -> list[Result]:
    """`do` of every piece of work, with progress; Ctrl-C leaves what is done in the journal."""
    from sim_bridge.adapters.journal import journaled_map

    cores = jobs or len(os.sched_getaffinity(0))
    with progress_bar() as bar:
        shown = bar.add_task(title, total=len(work))
        try:
            return journaled_map(
                work, do, cores, kept, lambda done, _: bar.update(shown, completed=done)
            )
        except KeyboardInterrupt:
            typer.echo(f"stopped; {kept.path} keeps what is done, the same command goes on")
            raise typer.Exit(INTERRUPTED) from None
