"""The desk's terminal: text is shown verbatim, without markup."""

from typing import IO, Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from companion.core.base.safe_text import harmless_lines


class _PlainConsole(Console):
    """A console whose texts cannot move the cursor or change colours."""

    def render_str(self, text: str, *arguments: Any, **options: Any) -> Text:
        return super().render_str(harmless_lines(text), *arguments, **options)


def plain_console(file: IO[str] | None = None, width: int | None = None) -> Console:
    """Return a console that does not interpret markup, emoji names or numbers to highlight."""
    return _PlainConsole(file=file, width=width, markup=False, emoji=False, highlight=False)


def plain_table(*columns: str, title: str | None = None) -> Table:
    """Return an empty table that truncates no text: long cells continue on the next line."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    table.show_edge = table.pad_edge = False
    for name in columns:
        table.add_column(name, overflow="fold")
    return table
