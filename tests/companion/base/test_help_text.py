"""Help texts of all three programs are wrapped to the terminal's width."""

from collections.abc import Iterator
from typing import Any

import pytest

from companion.app.cli.main import app as companion
from companion.core.base.help_text import (
    COMMAND_PREFIXES,
    KEPT_LINE_PREFIXES,
    join_lines_of_paragraphs,
)
from ground_station.app.cli.main import app as ground_station
from sim_bridge.main import app as sim_bridge


def commands(app: Any) -> Iterator[Any]:
    yield from app.registered_commands
    for group in app.registered_groups:
        yield from commands(group.typer_instance)


@pytest.mark.parametrize("app", [companion, ground_station, sim_bridge])
def test_no_paragraph_of_a_commands_help_is_broken_where_its_source_is(app):
    seen = 0
    for command in commands(app):
        for paragraph in f"{command.help or ''}\n\n{command.epilog or ''}".split("\n\n"):
            lines = paragraph.split("\n")
            listed = all(line.startswith(COMMAND_PREFIXES) for line in lines)
            if not listed and not any(line.startswith(KEPT_LINE_PREFIXES) for line in lines):
                assert len(lines) == 1, f"{command.callback.__name__}: {paragraph}"
            seen += 1
    assert seen > 5


def test_lists_and_examples_keep_their_lines():
    words = """First line.

    One sentence
    on two lines.

    - a point
    - another
    """
    assert (
        join_lines_of_paragraphs(words)
        == "First line.\n\nOne sentence on two lines.\n\n- a point\n- another"
    )


def test_commands_one_below_the_other_stay_so():
    commands = "companion check --link x\nsim-bridge fly"
    assert join_lines_of_paragraphs(f"First line.\n\n{commands}") == f"First line.\n\n{commands}"
    prose = "companion and desk\nmeet."
    assert join_lines_of_paragraphs(f"First line.\n\n{prose}").endswith("companion and desk meet.")
