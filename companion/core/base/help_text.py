"""Help of the command lines: paragraphs that flow to the width of the terminal."""

import inspect
from typing import Any

KEPT = ("- ", "* ", "    ", "\b")
"""A paragraph with a line that begins so is a list or an example, and keeps its lines."""

COMMANDS = ("companion ", "ground-station ", "sim-bridge ")
"""A paragraph whose lines all begin so is one command a line."""


def flowing(text: str) -> str:
    """The same paragraphs, each on one line: the terminal breaks it where it is wide."""
    return "\n\n".join(map(_paragraph, inspect.cleandoc(text).split("\n\n")))


def flow_help(app: Any) -> None:
    """Let the help of every command of a Typer app flow, with what stands below its options, and of
    the apps in it.

    Typer itself does so for the first paragraph only.
    """
    for command in app.registered_commands:
        words = command.help or command.callback.__doc__
        command.help = flowing(words) if words else None
        command.epilog = flowing(command.epilog) if command.epilog else None
    for group in app.registered_groups:
        flow_help(group.typer_instance)


def _paragraph(text: str) -> str:
    lines = text.split("\n")
    if any(line.startswith(KEPT) for line in lines):
        return text
    if all(line.startswith(COMMANDS) for line in lines):
        return text
    return " ".join(lines)
