"""Plain Markdown from what commands print: their tables of a terminal, and their own sheets."""

import re
from collections.abc import Collection
from typing import Any

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text


class MarkdownConsole(Console):
    """A console that keeps what is printed on it, as Markdown."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self._parts: list[str] = []

    def print(self, *objects: Any, **_: Any) -> None:
        """Keep tables as tables and words as a paragraph each."""
        for one in objects:
            self._keep(one)

    @property
    def markdown(self) -> str:
        """Everything so far."""
        return "\n\n".join(self._parts)

    def _keep(self, one: Any) -> None:
        if isinstance(one, Group):
            for part in one.renderables:
                self._keep(part)
        elif isinstance(one, Table):
            self._parts.append(table_markdown(one))
        elif words := plain(one):
            self._parts.append(words)


def table_markdown(table: Table) -> str:
    """A table of a terminal as a Markdown table, its title above and its caption below."""
    columns = table.columns
    lines = [_row([column.header for column in columns])]
    lines.append(_row(["---:" if c.justify == "right" else "---" for c in columns]))
    lines += [_row(cells) for cells in zip(*(column.cells for column in columns), strict=True)]
    parts = ["\n".join(lines)]
    if table.title:
        parts.insert(0, f"**{plain(table.title)}**")
    if table.caption:
        parts.append(plain(table.caption))
    return "\n\n".join(parts)


def sheet_markdown(printed: str) -> str:
    """A printed sheet a level deeper, since the page has a title of its own."""
    lines = [re.sub(r"^(#+ )", r"#\1", line) for line in printed.strip().splitlines()]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines))


def without_title(body: str, titles: Collection[str]) -> str:
    """A sheet without its own title where that stands above it already."""
    first, _, rest = body.partition("\n")
    return rest.lstrip("\n") if first.lstrip("# ") in titles and first.startswith("#") else body


def _row(cells: Any) -> str:
    return "| " + " | ".join(plain(cell).replace("|", "\\|") for cell in cells) + " |"


def plain(one: Any) -> str:
    """Words of a terminal on one line, without marks of colour."""
    text = one.plain if isinstance(one, Text) else Text.from_markup(str(one)).plain
    return " ".join(text.replace("-\n", "").replace("/\n", "/").split())
