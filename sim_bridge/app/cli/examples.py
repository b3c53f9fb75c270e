"""`sim-bridge examples`: the shipped flights, days, sites and layouts as files of one's own."""

from itertools import takewhile
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer()

FOLDERS = ("flights", "days", "sites", "layouts")
SCHEMA_LINE = "#:schema "
"""Names a schema of the repository for editors; it does not lie beside a copy."""


@app.command()
def examples(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where they go; it is made where it is missing.")
    ],
) -> None:
    """Copy the shipped flights, days, sites and layouts into DIR, to change and fly.

    DIR/flights has single deliveries (flight/1), DIR/days whole days with their orders (day/1,
    CSV), DIR/sites the obstacles and no-fly areas that they name (GeoJSON), DIR/layouts what
    Foxglove and PlotJuggler open a flight with. Airframes are named in the files and stay where
    they are. Each file's first lines say what it is for. No file is written over: where one is
    there already, nothing is copied.

    sim-bridge examples my-town
    sim-bridge fly my-town/flights/default.toml
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from companion.adapters.files.params import params_dir

    params = params_dir()
    found = [path for name in FOLDERS for path in sorted((params / name).iterdir())]
    texts = {path.relative_to(params): _read_without_schema_line(path) for path in found}
    _write_files_unless_any_exists(texts, folder)
    summary_table = Table(
        "file", "what it is for", box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False
    )
    for name, text in texts.items():
        if name.suffix == ".toml":
            summary_table.add_row(str(name), _first_comment_sentence(text))
    console = Console()
    console.print(summary_table)
    console.print(f"\n{folder}: {len(texts)} files. Change one, and run it:", highlight=False)
    for command in (
        f"sim-bridge fly {folder}/flights/default.toml",
        f"ground-station plan {folder}/days/harbour.toml --picture plan.png",
        f"sim-bridge day {folder}/days/harbour.toml",
        f"ground-station map --day {folder}/days/harbour.toml --replay logs/day-harbour-seed1",
    ):
        typer.echo(f"  {command}")  # not wrapped: it is to be copied


def _read_without_schema_line(path: Path) -> str:
    return "".join(
        line
        for line in path.read_text(encoding="utf-8").splitlines(keepends=True)
        if not line.startswith(SCHEMA_LINE)
    )


def _write_files_unless_any_exists(texts: dict[Path, str], folder: Path) -> None:
    """Raises LeewayError where a file is there already, before anything is written."""
    existing = [str(name) for name in texts if (folder / name).exists()]
    if existing:
        file_list = ", ".join(existing[:3]) + (
            f" and {len(existing) - 3} more" if len(existing) > 3 else ""
        )
        raise LeewayError(f"{folder}: {file_list}: there already; name another folder")
    try:
        for name, text in texts.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise LeewayError(f"{folder}: {error.strerror}") from error


def _first_comment_sentence(text: str) -> str:
    """The first sentence of the comment that a file begins with."""
    lines = takewhile(lambda line: line.startswith("#"), text.splitlines())
    comment = " ".join(line.removeprefix("#").strip() for line in lines)
    sentence = comment.split(". ")[0].removesuffix(".")
    return f"{sentence}."
