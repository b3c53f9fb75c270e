"""The results pages: few, short, and every command shown exists."""

import re
import shlex
from pathlib import Path

import pytest

from sim_bridge.research.reference.programs import CONSOLE_SCRIPTS
from tests.house.parsed_command import parsed

PAGES = sorted((Path(__file__).parents[2] / "docs" / "results").glob("*.md"))
MOST_PAGES, MOST_WORDS = 10, 500


def commands(page: Path) -> list[str]:
    blocks = re.findall(r"^```\w*\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.split()[:1] and line.split()[0] in CONSOLE_SCRIPTS]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_of_a_page_is_accepted_by_its_program(page: Path) -> None:
    for line in commands(page):
        parsed(shlex.split(line, comments=True))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_is_short_outside_its_tables(page: Path) -> None:
    lines = [line for line in page.read_text().splitlines() if not line.startswith("|")]
    assert len(" ".join(lines).split()) <= MOST_WORDS


def test_there_are_few_pages() -> None:
    assert len(PAGES) <= MOST_PAGES


def test_a_command_that_does_not_exist_is_noticed() -> None:
    with pytest.raises(AssertionError, match="no command flie"):
        parsed(["sim-bridge", "flie"])
    with pytest.raises(Exception, match=r"(?i)no such option.*--sead"):
        parsed(["sim-bridge", "fly", "--sead", "1"])
