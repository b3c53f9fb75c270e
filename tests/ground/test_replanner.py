"""Plans made beside the running desk, by the real planner in its real process."""

import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

import pytest

from ground_station.adapters.day_files import read_day
from ground_station.app.replanner import NoPlan, ReplannerBeside
from ground_station.core.day_data import DayData
from ground_station.core.day_plan import DayPlan
from ground_station.core.day_replan import unfit
from ground_station.core.day_state import DayState, first_state

FOR_EVER = 10**9  # trials


@dataclass
class HandClock:
    t_s: float = 0.0

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return 0


@pytest.fixture(scope="module")
def harbour() -> DayData:
    return read_day(Path(__file__).parents[2] / "params" / "days" / "harbour.toml")


@pytest.fixture
def beside() -> Iterator[ReplannerBeside]:
    replanner = ReplannerBeside(HandClock(), trials=FOR_EVER)
    yield replanner
    replanner.close()


def begun(beside: ReplannerBeside, harbour: DayData) -> SpawnProcess:
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
    assert unfit(made, start) is None
    served = {order for stop in made.stops for order in stop.serves}
    brought = served | {sortie.order for sortie in made.sorties}
    assert brought | {line.order for line in made.unplanned} == set(start.open)
    assert {sortie.vehicle for sortie in made.sorties} <= {"d2"}
    assert beside.made() is None  # once


def test_a_planner_that_is_killed_is_heard_of_and_the_next_plan_begins_anew(harbour, beside):
    process = begun(beside, harbour)
    os.kill(process.pid or 0, signal.SIGKILL)
    process.join(60.0)
    assert beside.made() == NoPlan("the planner's process died")
    assert begun(beside, harbour).pid != process.pid


def test_a_planner_that_hangs_is_ended_so_that_the_truck_goes_on(harbour, beside):
    process = begun(beside, harbour)
    beside.clock.t_s = beside.limit_s + 1.0
    assert beside.made() == NoPlan("the planner was not done within 900 s")
    assert process.exitcode == -signal.SIGKILL


def test_a_desk_that_ends_takes_its_planner_along(harbour, beside):
    process = begun(beside, harbour)
    beside.close()
    assert process.exitcode == -signal.SIGKILL
    assert beside.made() is None
