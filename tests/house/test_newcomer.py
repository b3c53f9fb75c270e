"""What `deploy/check-newcomer` takes from README is there: it tries these commands each night."""

import importlib.util
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType

import pytest

from tests.house.test_results import parsed

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


@pytest.fixture(scope="module")
def newcomer() -> ModuleType:
    loader = SourceFileLoader("check_newcomer", str(ROOT / "deploy" / "check-newcomer"))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    made = importlib.util.module_from_spec(spec)
    loader.exec_module(made)
    return made


def test_readme_has_a_first_flight_a_day_and_the_map_that_shows_it(newcomer: ModuleType) -> None:
    assert newcomer.blocks(README, "make fly")[0] == "make fly"
    into, day, shown = newcomer.blocks(README, "sim-bridge day")
    assert into == ". .venv/bin/activate"
    parsed(day.split())
    parsed(shown.split())
    assert shown.split()[:2] == ["ground-station", "map"]
    with pytest.raises(newcomer.NotSo, match="no block with ground-station fly"):
        newcomer.blocks(README, "ground-station fly")


def test_what_readme_shows_of_a_flight_is_held_against_what_was_printed(
    newcomer: ModuleType,
) -> None:
    shown = "\n".join(newcomer.blocks(README, "gate on"))
    newcomer.check_printed(README, f"installing ...\n{shown}\nrun folder: logs/a")
    with pytest.raises(newcomer.NotSo, match="did not print: 1 px4"):
        newcomer.check_printed(README, shown.replace("+21.8", "+20.8"))
