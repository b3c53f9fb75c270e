"""README has the commands that `deploy/check-newcomer` extracts and runs each night."""

from pathlib import Path
from runpy import run_path
from types import SimpleNamespace

import pytest

from tests.house.parsed_command import parsed

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
newcomer = SimpleNamespace(**run_path(str(ROOT / "deploy" / "check-newcomer")))


def test_readme_has_a_first_flight_a_day_and_the_map_that_shows_it() -> None:
    assert newcomer.blocks(README, "make fly")[0] == "make fly"
    into, day, shown = newcomer.blocks(README, "sim-bridge day")
    assert into == ". .venv/bin/activate"
    parsed(day.split())
    parsed(shown.split())
    assert shown.split()[:2] == ["ground-station", "map"]
    with pytest.raises(newcomer.NotSo, match="no block with ground-station fly"):
        newcomer.blocks(README, "ground-station fly")


def test_what_readme_shows_of_a_flight_is_held_against_what_was_printed() -> None:
    shown = "\n".join(newcomer.blocks(README, "gate on"))
    newcomer.check_printed(README, f"installing ...\n{shown}\nrun folder: logs/a")
    with pytest.raises(newcomer.NotSo, match="did not print: 1 px4"):
        newcomer.check_printed(README, shown.replace("+21.8", "+20.8"))
