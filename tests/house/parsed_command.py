"""Parses the command lines of documents and units with the programs' own parsers."""

from functools import cache

from sim_bridge.research.reference.programs import load_root_command

_program = cache(load_root_command)


def parsed(words: list[str]) -> None:
    """Parse the command with the program's own parser, without running it."""
    command = _program(words[0])
    context, left = None, words[1:]
    while hasattr(command, "get_command"):
        own, left = command.split_args(left) if hasattr(command, "split_args") else ([], left)
        name, *left = left
        context = command.make_context(words[0], [*own, name], parent=context)
        command = command.get_command(context, name)
        assert command is not None, f"{' '.join(words)}: no command {name}"
    command.make_context(words[-1], left, parent=context)
