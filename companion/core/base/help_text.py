"""Help texts of the command lines, in paragraphs that fit the width of the terminal."""

import inspect
from typing import Any

KEPT_LINE_PREFIXES = ("- ", "* ", "    ", "\b")
"""A paragraph with a line that starts so is a list or an example, and keeps its lines."""

COMMAND_PREFIXES = ("companion ", "ground-station ", "sim-bridge ")
"""A paragraph whose lines all start so has one command per line."""


def join_lines_of_paragraphs(text: str) -> str:
    """Join the lines of each paragraph; the terminal wraps them."""
    return "\n\n".join(map(_join_lines_unless_list, inspect.cleandoc(text).split("\n\n")))


def reflow_command_help_in_place(app: Any) -> None:
    """Reflow help and epilog of every command of a Typer app, and of its nested apps.

    Typer reflows the first paragraph only.
    """
    for command in app.registered_commands:
        words = command.help or command.callback.__doc__
        command.help = join_lines_of_paragraphs(words) if words else None
        command.epilog = join_lines_of_paragraphs(command.epilog) if command.epilog else None
    for group in app.registered_groups:
        reflow_command_help_in_place(group.typer_instance)


def _join_lines_unless_list(text: str) -> str:
    lines = text.split("\n")
    if any(line.startswith(KEPT_LINE_PREFIXES) for line in lines):
        return text
    if all(line.startswith(COMMAND_PREFIXES) for line in lines):
        return text
    return " ".join(lines)
