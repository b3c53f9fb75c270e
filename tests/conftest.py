"""For all tests: examples are counted, never timed, since machines are noisy."""

import fcntl
import getpass
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

from ground_station.adapters.files.compiled_code import keep_compiled_code

keep_compiled_code()  # before any test module imports the planner: what is compiled is kept

settings.register_profile("leeway", deadline=None)
settings.load_profile("leeway")

ROOT = Path(__file__).parents[1]


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
