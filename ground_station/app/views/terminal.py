"""The desk's terminal: words are shown as they are, never obeyed."""

from typing import IO

from rich import box
from rich.console import Console
from rich.table import Table


def terminal(file: IO[str] | None = None, width: int | None = None) -> Console:
    """A console that takes no word for markup, an emoji's name or a number to colour."""
    return Console(file=file, width=width, markup=False, emoji=False, highlight=False)


def listing(*columns: str, title: str | None = None) -> Table:
    """An empty table in which nothing is cut: a cell without room goes on in its next line."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    table.show_edge = table.pad_edge = False
    for name in columns:
        table.add_column(name, overflow="fold")
    return table
