"""Plans made beside the running desk, by the real planner in its real process."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.app.desk.replanner import NoPlan, ProcessReplanner
from ground_station.core.dispatch.replanning import broken_promise
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import DayState, first_state

pytestmark = pytest.mark.usefixtures("compiled_planner")

ROOT = Path(__file__).parents[3]
FOR_EVER = 10**9  # trials
PATIENCE_S = 60.0

DESK = """
import sys
from pathlib import Path
from ground_station.adapters.files.day_files import read_day
from ground_station.app.desk.replanner import ProcessReplanner
from ground_station.core.schema.day_state import first_state

if __name__ == "__main__":
    clock = type("Clock", (), {"monotonic_s": lambda self: 0.0})()
    beside, day = ProcessReplanner(clock, trials=10**9), read_day(Path(sys.argv[1]))
    beside.ask(day, first_state(day))
    print(beside.process.pid, flush=True)
    sys.stdin.read()
"""


@dataclass
class HandClock:
    t_s: float = 0.0

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return 0


@pytest.fixture(scope="module")
def harbour() -> DayData:
    return read_day(ROOT / "params" / "days" / "harbour.toml")


@pytest.fixture
def beside() -> Iterator[ProcessReplanner]:
    replanner = ProcessReplanner(HandClock(), trials=FOR_EVER)
    yield replanner
    replanner.close()


def begun(beside: ProcessReplanner, harbour: DayData) -> SpawnProcess:
    beside.ask(harbour, first_state(harbour))
    assert beside.made() is None
    assert beside.process is not None
    return beside.process


def test_the_real_planner_plans_the_rest_of_a_day_in_its_own_process(harbour, beside):
    beside.trials = 200
    whole = first_state(harbour)
    start = DayState(whole.stops, (), whole.open[2:], {"d2": 50.0}, revision=3)  # d1 is out
    beside.ask(harbour, start)
    assert beside.process is not None
    assert wait([beside.process.sentinel], timeout=300.0)
    made = beside.made()
    assert isinstance(made, DayPlan), made
    assert broken_promise(made, start) is None
    served = {order for stop in made.stops for order in stop.serves}
    brought = served | {sortie.order for sortie in made.sorties}
    assert brought | {line.order for line in made.unplanned} == set(start.open)
    assert {sortie.vehicle for sortie in made.sorties} <= {"d2"}
    assert beside.made() is None  # once


def test_a_planner_that_is_killed_is_heard_of_and_the_next_plan_begins_anew(harbour, beside):
    process = begun(beside, harbour)
    os.kill(process.pid or 0, signal.SIGKILL)
    process.join(60.0)
    assert beside.made() == NoPlan("the planner: its process died", again=True)
    assert begun(beside, harbour).pid != process.pid


def test_a_planner_that_hangs_is_ended_so_that_the_truck_goes_on(harbour, beside):
    process = begun(beside, harbour)
    beside.clock.t_s = beside.limit_s + 1.0
    assert beside.made() == NoPlan("the planner: not done within 900 s", again=True)
    assert process.exitcode == -signal.SIGKILL


def test_a_desk_that_ends_takes_its_planner_along(harbour, beside):
    process = begun(beside, harbour)
    beside.close()
    assert process.exitcode == -signal.SIGKILL
    assert beside.made() is None


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


def test_a_desk_carries_no_compiler():
    """It plans in a process of its own: a third of its memory was the compiler of that."""
    code = "import sys, ground_station.app.desk.open_desk; print('numba' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"
