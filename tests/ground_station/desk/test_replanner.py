"""Plans made in parallel with the running desk, by the real planner in its real process."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.app.desk.replanner import (
    PLANNING_TIMEOUT_S,
    NoPlan,
    Replanner,
    create_process_planner,
)
from ground_station.core.dispatch.replanning import broken_promise_reason
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import DayState, initial_state
from tests.ground_station.desk_parts import HandClock

pytestmark = pytest.mark.usefixtures("compiled_planner")

ROOT = Path(__file__).parents[3]
FOR_EVER = 10**9  # trials
PATIENCE_S = 60.0

DESK = """
import sys
from pathlib import Path
from ground_station.adapters.files.day_files import read_day
from ground_station.app.desk.replanner import Replanner, create_process_planner
from ground_station.core.schema.day_state import initial_state

if __name__ == "__main__":
    clock = type("Clock", (), {"monotonic_s": lambda self: 0.0})()
    worker = create_process_planner(clock)
    beside, day = Replanner(worker, trials=10**9), read_day(Path(sys.argv[1]))
    beside.start_planning(day, initial_state(day))
    print(worker.process.pid, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module")
def harbour() -> DayData:
    return read_day(ROOT / "params" / "days" / "harbour.toml")


@pytest.fixture
def beside() -> Iterator[Replanner]:
    replanner = Replanner(create_process_planner(HandClock()), trials=FOR_EVER)
    yield replanner
    replanner.close()


def begun(beside: Replanner, harbour: DayData) -> SpawnProcess:
    beside.start_planning(harbour, initial_state(harbour))
    assert beside.take_finished_plan() is None
    assert beside.worker.process is not None
    return beside.worker.process


@pytest.mark.sample
def test_the_real_planner_plans_the_rest_of_a_day_in_its_own_process(harbour, beside):
    beside.trials = 200
    whole = initial_state(harbour)
    start = DayState(whole.stops, (), whole.open_orders[2:], {"d2": 50.0}, revision=3)  # d1 is away
    beside.start_planning(harbour, start)
    assert beside.worker.process is not None
    assert wait([beside.worker.process.sentinel], timeout=300.0)
    made = beside.take_finished_plan()
    assert isinstance(made, DayPlan), made
    assert broken_promise_reason(made, start) is None
    served = {order for stop in made.stops for order in stop.serves}
    brought = served | {sortie.order for sortie in made.sorties}
    assert brought | {line.order for line in made.unplanned} == set(start.open_orders)
    assert {sortie.vehicle for sortie in made.sorties} <= {"d2"}
    assert beside.take_finished_plan() is None  # returned only once


def test_a_planner_that_is_killed_is_heard_of_and_the_next_plan_begins_anew(harbour, beside):
    process = begun(beside, harbour)
    os.kill(process.pid or 0, signal.SIGKILL)
    process.join(60.0)
    assert beside.take_finished_plan() == NoPlan("the planner: its process died", can_retry=True)
    assert begun(beside, harbour).pid != process.pid


def test_a_planner_that_hangs_is_ended_so_that_the_truck_goes_on(harbour, beside):
    process = begun(beside, harbour)
    beside.worker.clock.t_s = PLANNING_TIMEOUT_S + 1.0
    assert beside.take_finished_plan() == NoPlan(
        "the planner: not done within 900 s", can_retry=True
    )
    assert process.exitcode == -signal.SIGKILL


def test_a_desk_that_ends_takes_its_planner_along(harbour, beside):
    process = begun(beside, harbour)
    beside.close()
    assert process.exitcode == -signal.SIGKILL
    assert beside.take_finished_plan() is None


@pytest.mark.sample
def test_a_desk_that_is_killed_takes_its_planner_along(tmp_path):
    script = tmp_path / "desk.py"
    script.write_text(DESK)
    command = [sys.executable, str(script), str(ROOT / "params" / "days" / "harbour.toml")]
    desk = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with desk:
        assert desk.stdout is not None
        planner = int(desk.stdout.readline())
        assert _lives(planner)
        desk.kill()
    until_s = time.monotonic() + PATIENCE_S
    while _lives(planner) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert not _lives(planner)


def _lives(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False
    return stat.rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.sample
def test_a_desk_carries_no_compiler():
    """The desk plans in a separate process: the compiler would add a third to its memory."""
    code = "import sys, ground_station.app.desk.open_desk; print('numba' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"
