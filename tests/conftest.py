"""For all tests: examples are counted, never timed, since machines are noisy; a drawn sample.

A test marked `@pytest.mark.drawn(keep=K, of="name")` is a family of equal cases. With `--draw-seed`
K of the values of `name` are run for every setting of its other parameters; without `of`, K of all
its cases. Which ones, the seed says: run after run all have their turn, and the same seed gives the
same tests. Without the option everything runs. `make test` draws, `make night` runs all.
"""

import fcntl
import getpass
import os
import secrets
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from ground_station.adapters.files.compiled_code import keep_compiled_code

keep_compiled_code()  # before any test module imports the planner: what is compiled is kept

settings.register_profile("leeway", deadline=None)
settings.load_profile("leeway")

pytest_plugins = ["pytester"]  # the drawn sample is tested by a pytest inside

ROOT = Path(__file__).parents[1]

DRAW = "--draw-seed"
NEW_SEED = "new"
LONG = ("sitl", "third_party")


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--draw-seed N`."""
    words = "run a drawn sample of the tests marked `drawn`: `new`, or the seed of an earlier run"
    parser.addoption(DRAW, metavar="N", help=words)


def pytest_configure(config: pytest.Config) -> None:
    """Draw a seed, once a run: xdist's workers take their controller's."""
    asked = config.getoption(DRAW)
    drawn = getattr(config, "workerinput", {}).get("draw_seed")
    if drawn is not None:
        config.option.draw_seed = drawn
    elif asked == NEW_SEED:
        config.option.draw_seed = str(secrets.randbelow(10**6))
    elif asked is not None and not asked.isdecimal():
        raise pytest.UsageError(f"{DRAW}: expected a whole number or `{NEW_SEED}`, not {asked!r}")


@pytest.hookimpl(optionalhook=True)  # xdist's
def pytest_configure_node(node: Any) -> None:
    """Tell a worker which seed was drawn."""
    node.workerinput["draw_seed"] = node.config.getoption(DRAW)


def pytest_report_header(config: pytest.Config) -> str:
    """Say the seed, so that the run can be had again."""
    seed = config.getoption(DRAW)
    return "all of the tests marked `drawn`" if seed is None else f"drawn sample: {DRAW} {seed}"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what was not drawn; begin with the files that fly, for those take longest."""
    seed = config.getoption(DRAW)
    left_out = set() if seed is None else _not_drawn(items, int(seed))
    if left_out:
        config.hook.pytest_deselected(items=[item for item in items if item in left_out])
        items[:] = [item for item in items if item not in left_out]
    flying = {item.path for item in items if any(map(item.get_closest_marker, LONG))}
    items.sort(key=lambda item: item.path not in flying)


def _not_drawn(items: list[pytest.Item], seed: int) -> set[pytest.Item]:
    families: dict[tuple[object, ...], list[pytest.Item]] = defaultdict(list)
    for item in items:
        mark = item.get_closest_marker("drawn")
        if mark is not None:
            families[_family(item, mark.kwargs.get("of"))].append(item)
    rng = np.random.default_rng(seed)
    left_out: set[pytest.Item] = set()
    for members in families.values():  # in the order in which they were collected
        mark = members[0].get_closest_marker("drawn")
        keep = mark.kwargs.get("keep", 1) if mark is not None else 1
        left_out.update(members[i] for i in rng.permutation(len(members))[keep:])
    return left_out


def _family(item: pytest.Item, of: str | None) -> tuple[object, ...]:
    """The test without its parameters; with `of`, with all of them but that one."""
    test = item.nodeid.split("[")[0]
    if of is None:
        return (test,)
    values: dict[str, object] = item.callspec.params
    if of not in values:
        raise pytest.UsageError(f"{item.nodeid}: drawn(of={of!r}) names none of its parameters")
    return (test, *((name, id(value)) for name, value in values.items() if name != of))


@pytest.fixture(scope="session", autouse=True)
def no_vehicle_is_remembered(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What a flight leaves changed on a simulated vehicle does not outlast the tests."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="session")
def compiled_planner() -> None:
    """The planner's machine code, which takes 40 s of a core for the first time: made by one
    worker and kept, while those who want it too wait. For modules that plan."""
    from ground_station.adapters.files.day_files import read_day
    from ground_station.core.planning.day_planner import PlanParams, plan_day
    from ground_station.core.schema.day_state import first_state

    waiting = Path(tempfile.gettempdir()) / f"leeway-tests-compile-{getpass.getuser()}"
    with waiting.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        data = read_day(ROOT / "params" / "days" / "harbour.toml")
        plan_day(data, first_state(data), PlanParams(trials=200))
