"""The worker process: the same table as made at home, at its time; dead or hung, nothing waits."""

import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import psutil

from companion.adapters.clock import wall_s
from companion.app.flight.value_table_worker import COMMAND, TableWorker
from companion.core.mission.actions import MakeTable
from companion.core.return_budget.remaining_mission import OnTheWay
from companion.core.return_budget.value_table.mission_value import Belief, TableRequest, make_table
from companion.core.routing.route_planner import Plan
from companion.core.vehicle.airframe import airframe_from_dict
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.markov_chain import OrnsteinUhlenbeckWind

ROOT = Path(__file__).parents[3]
M100 = airframe_from_dict(tomllib.loads((ROOT / "params/airframes/m100.toml").read_text()))
REQUEST = TableRequest(
    airframe=M100,
    cruise_airspeed_mps=10.0,
    speed_rule="cruise",
    plan=Plan(
        depot_ned_m=(0.0, 0.0, 0.0),
        customer_ned_m=(300.0, 0.0, 0.0),
        outbound_ned_m=((300.0, 0.0, -40.0),),
        return_ned_m=((0.0, 0.0, -40.0),),
        entry=(0,),
        rally=(),
        home_ground_speed_mps=9.0,
        energy_wh=0.0,
        time_s=0.0,
        route_std_wh=0.0,
    ),
    payload_kg=0.5,
    drop_height_m=6.0,
    drop_s=12.0,
    wind=OrnsteinUhlenbeckWind((0.0, 5.0), 2.0, 300.0, spacing_mps=2.0, reach_mps=4.0),
    wind_known=True,
    at=OnTheWay(0, 1.0),
    belief=Belief((0.0, 5.0), (0.3, 0.3), 40.0, 2.0, ModelError(1.0, 0.05)),
    max_loss=0.01,
)
HANGS = (sys.executable, "-c", "import time; time.sleep(600)")
DIES = (sys.executable, "-c", "raise SystemExit(1)")
RAVES = (sys.executable, "-c", "print('no table')")


def answered(command: tuple[str, ...], wait_s: float):
    worker = TableWorker(wait_s, command)
    worker.order(MakeTable(REQUEST, 20.0), 100.0)
    assert worker.due(119.9) is None
    began_s = wall_s()
    made = worker.due(120.0)
    assert made is not None
    took_s = wall_s() - began_s
    assert worker.due(121.0) is None, "one answer to one request"
    worker.stop()
    return made, took_s


def test_the_workers_table_is_the_one_that_would_be_made_here() -> None:
    made, _ = answered(COMMAND, 120.0)
    here = make_table(REQUEST)
    assert made.t_s == 120.0
    assert made.table is not None, made.trouble
    for name in ("on", "at", "turn_home", "onward_wh", "turning_wh"):
        assert np.array_equal(getattr(made.table, name), getattr(here, name))
    assert made.table.read(OnTheWay(0, 0.5), REQUEST.belief) == here.read(
        OnTheWay(0, 0.5), REQUEST.belief
    )


def test_one_process_makes_table_after_table_and_leaves_none_of_its_forks() -> None:
    worker, made = TableWorker(120.0), []
    process_id = worker.process_id
    assert process_id is not None
    for at_s in (100.0, 200.0):
        worker.order(MakeTable(REQUEST, 20.0), at_s)
        made.append(worker.due(at_s + 20.0))
    assert worker.process_id == process_id
    worker.order(MakeTable(REQUEST, 20.0), 300.0)
    fork = _fork_of(process_id)
    worker.stop()
    assert [m.trouble for m in made] == ["", ""]
    until_s = wall_s() + 5.0  # it is killed with its parent, but nobody waits for it to be gone
    while _lives(fork) and wall_s() < until_s:
        time.sleep(0.002)
    assert not _lives(fork)


def test_a_fork_that_is_killed_is_told_and_the_next_request_is_answered() -> None:
    worker = TableWorker(120.0)
    worker.order(MakeTable(REQUEST, 20.0), 100.0)
    assert worker.process_id is not None
    _fork_of(worker.process_id).kill()
    made = worker.due(120.0)
    assert made is not None
    assert "died" in made.trouble
    worker.order(MakeTable(REQUEST, 20.0), 200.0)
    made = worker.due(220.0)
    worker.stop()
    assert made is not None
    assert made.table is not None, made.trouble


def _lives(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def _fork_of(worker: int) -> psutil.Process:
    until_s = wall_s() + 60.0
    while wall_s() < until_s:
        for fork in psutil.Process(worker).children():
            return fork
        time.sleep(0.002)
    raise AssertionError("the worker has not forked")


def test_beside_a_real_vehicle_a_table_larger_than_a_pipe_arrives_without_a_wait() -> None:
    worker = TableWorker(0.0)
    worker.order(MakeTable(REQUEST, 1e6), 100.0)
    t_s, until_s = 100.0, wall_s() + 120.0
    while wall_s() < until_s and worker.waits:
        t_s += 0.1
        assert worker.due(t_s) is None
        time.sleep(0.02)
    made = worker.due(100.0 + 1e6)
    worker.stop()
    assert made is not None
    assert made.table is not None, made.trouble
    assert made.table.size_bytes > 1 << 16  # what a pipe holds


def test_a_worker_that_hangs_is_given_up_at_its_time() -> None:
    made, took_s = answered(HANGS, 0.0)
    assert made.table is None
    assert "too long" in made.trouble
    assert took_s < 2.0  # beside a real vehicle nobody waits; killing it takes a moment


def test_a_worker_that_dies_is_told_from_one_that_is_late() -> None:
    made, _ = answered(DIES, 60.0)
    assert made.table is None
    assert "died" in made.trouble


def test_what_is_no_table_is_not_taken_for_one() -> None:
    made, _ = answered(RAVES, 60.0)
    assert made.table is None
    assert made.trouble


def test_a_clock_that_went_back_ends_the_wait() -> None:
    worker = TableWorker(0.0, HANGS)
    worker.order(MakeTable(REQUEST, 20.0), 100.0)
    made = worker.due(3.0)
    worker.stop()
    assert made is not None
    assert made.table is None


def test_a_new_request_ends_the_work_on_the_old() -> None:
    worker = TableWorker(0.0, HANGS)
    worker.order(MakeTable(REQUEST, 20.0), 100.0)
    worker.order(MakeTable(REQUEST, 20.0), 110.0)
    assert worker.due(125.0) is None
    assert worker.due(130.0) is not None
    worker.stop()
