"""Help at 80 columns truncates no name: truncated names may be indistinguishable."""

from collections.abc import Iterator

import pytest
import typer
from typer.core import TyperGroup
from typer.testing import CliRunner

from companion.app.cli.main import app as companion
from ground_station.app.cli.main import app as ground_station
from sim_bridge.main import app as sim_bridge

PROGRAMS = {"companion": companion, "ground-station": ground_station, "sim-bridge": sim_bridge}
CUT = "…"

Words = tuple[str, ...]


def commands(command: object, words: Words = ()) -> Iterator[Words]:
    yield words
    if isinstance(command, TyperGroup):
        context = typer.Context(command)
        for name in command.list_commands(context):
            yield from commands(command.get_command(context, name), (*words, name))


def cut_lines(app: typer.Typer, words: Words) -> list[str]:
    shown = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "80"})
    assert shown.exit_code == 0, shown.output
    return [f"{' '.join(words)}: {line}" for line in shown.output.split("\n") if CUT in line]


@pytest.mark.parametrize("program", PROGRAMS)
def test_no_help_cuts_a_word_at_80_columns(program: str) -> None:
    app = PROGRAMS[program]
    found = list(commands(typer.main.get_command(app)))
    assert len(found) > 5
    cut = [line for words in found for line in cut_lines(app, words)]
    assert not cut, "\n".join(cut)


def test_canary_a_word_too_long_for_its_column_is_cut() -> None:
    app = typer.Typer()

    @app.command()
    def long(there: str = typer.Option("", help="x" * 90)) -> None:
        """Print nothing."""

    assert cut_lines(app, ())
