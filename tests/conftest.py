"""Shared test set-up: a drawn sample of parametrized cases; examples are counted, not timed.

A test marked `@pytest.mark.drawn(keep=K, of="name")` is a family of equivalent cases. With
`--draw-seed`, K values of `name` run for every setting of its other parameters; without `of`, K of
all its cases. The seed determines the selection: runs with new seeds cover all cases in time, and
the same seed gives the same tests. Tests marked `sample` are drawn by file: a fifth of the files
run theirs; those marked `every_run` or named after a safety rule run always. Without the option all
cases run. `make test` and `make samples` draw, `make test-all` runs all.
"""

import fcntl
import getpass
import math
import os
import secrets
import signal
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known

# before any test module imports the planner: keeps its compiled code
enable_compile_cache_and_check_if_known()

settings.register_profile("leeway", deadline=None)
settings.load_profile("leeway")

pytest_plugins = ["pytester"]  # the drawn sample is tested by a nested pytest run

ROOT = Path(__file__).parents[1]

DRAW = "--draw-seed"
NEW_SEED = "new"
LONG = ("sitl", "third_party")
SAMPLE_FILES_FRAC = 1 / 5
SAFETY_RULE = "test_safety_rule_"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option `--draw-seed N`."""
    words = "run a drawn sample of the tests marked `drawn`: `new`, or the seed of an earlier run"
    parser.addoption(DRAW, metavar="N", help=words)


def pytest_configure(config: pytest.Config) -> None:
    """Draw one seed per run; xdist workers use the seed of their controller.

    Programs under test inherit an ignored SIGINT, as `nohup` and some CI runners set it.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    asked = config.getoption(DRAW)
    drawn = getattr(config, "workerinput", {}).get("draw_seed")
    if drawn is not None:
        config.option.draw_seed = drawn
    elif asked == NEW_SEED:
        config.option.draw_seed = str(secrets.randbelow(10**6))
    elif asked is not None and not asked.isdecimal():
        raise pytest.UsageError(f"{DRAW}: expected a whole number or `{NEW_SEED}`, not {asked!r}")


@pytest.hookimpl(optionalhook=True)  # called by xdist
def pytest_configure_node(node: Any) -> None:
    """Pass the drawn seed to a worker."""
    node.workerinput["draw_seed"] = node.config.getoption(DRAW)


def pytest_report_header(config: pytest.Config) -> str:
    """Report the seed, so that the run can be repeated."""
    seed = config.getoption(DRAW)
    return "all of the tests marked `drawn`" if seed is None else f"drawn sample: {DRAW} {seed}"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the cases that were not drawn; run the slowest files, those that fly, first."""
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
    for members in families.values():  # in the order of collection
        mark = members[0].get_closest_marker("drawn")
        keep = mark.kwargs.get("keep", 1) if mark is not None else 1
        left_out.update(members[i] for i in rng.permutation(len(members))[keep:])
    return left_out | _samples_in_files_not_drawn(items, rng)


def _samples_in_files_not_drawn(
    items: list[pytest.Item], rng: np.random.Generator
) -> set[pytest.Item]:
    by_file: dict[Path, list[pytest.Item]] = defaultdict(list)
    for item in items:
        runs_always = item.get_closest_marker("every_run") or item.name.startswith(SAFETY_RULE)
        if item.get_closest_marker("sample") and not runs_always:
            by_file[item.path].append(item)
    files = list(by_file)  # in the order of collection
    drawn_count = math.ceil(SAMPLE_FILES_FRAC * len(files))
    return {item for i in rng.permutation(len(files))[drawn_count:] for item in by_file[files[i]]}


def _family(item: pytest.Item, of: str | None) -> tuple[object, ...]:
    """Return the test without its parameters; with `of`, without that parameter only."""
    test = item.nodeid.split("[")[0]
    if of is None:
        return (test,)
    values: dict[str, object] = item.callspec.params
    if of not in values:
        raise pytest.UsageError(f"{item.nodeid}: drawn(of={of!r}) names none of its parameters")
    return (test, *((name, id(value)) for name, value in values.items() if name != of))


@pytest.fixture(scope="session", autouse=True)
def no_vehicle_is_remembered(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep the settings that a flight leaves on a simulated vehicle within the test session."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="session")
def compiled_planner() -> None:
    """Compile the planner once for all workers, for modules that plan: 30 s of a core the first
    time. The other workers wait."""
    from ground_station.adapters.files.day_files import read_day
    from ground_station.core.planning.day_planner import PlanParams, plan_day
    from ground_station.core.schema.day_state import initial_state

    waiting = Path(tempfile.gettempdir()) / f"leeway-tests-compile-{getpass.getuser()}"
    with waiting.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        data = read_day(ROOT / "params" / "days" / "harbour.toml")
        plan_day(data, initial_state(data), PlanParams(trials=200))
