"""Help of all three programs flows to the terminal's width."""

from collections.abc import Iterator
from typing import Any

import pytest

from companion.app.cli.main import app as companion
from companion.core.base.help_text import KEPT, flowing
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
        for paragraph in (command.help or "").split("\n\n"):
            lines = paragraph.split("\n")
            if not any(line.startswith(KEPT) for line in lines):
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
    assert flowing(words) == "First line.\n\nOne sentence on two lines.\n\n- a point\n- another"
