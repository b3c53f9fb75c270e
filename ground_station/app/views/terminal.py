"""The desk's terminal: words are shown as they are, never obeyed."""

from typing import IO

from rich.console import Console


def terminal(file: IO[str] | None = None, width: int | None = None) -> Console:
    """A console that takes no word for markup, an emoji's name or a number to colour."""
    return Console(file=file, width=width, markup=False, emoji=False, highlight=False)
