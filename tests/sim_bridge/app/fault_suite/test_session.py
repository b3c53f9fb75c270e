"""The suite in parts: flown rows are kept, and the same command continues with the rest."""

import json

import pytest
from rich.console import Console

from ground_station.adapters.workers.side_by_side import ItemDone, ItemLost, WorkerOptions
from sim_bridge.app.fault_suite import suite
from sim_bridge.app.fault_suite.catalogue import select_cases
from sim_bridge.app.fault_suite.session import FaultSuiteSession, open_progress_log
from sim_bridge.app.faults.fault import PHASES, FaultRow, FaultTask
from sim_bridge.autopilot.kinds import AUTOPILOTS
from tests.sim_bridge.app.fault_suite.made_rows import made_row


def flown(task: FaultTask) -> FaultRow:
    named = {key: getattr(task, key) for key in ("fault", "autopilot", "phase", "seed")}
    return made_row(**named, cpu_s=float(task.seed))


@pytest.fixture
def flights(monkeypatch):
    """Return the tasks in order of flight, and the number before Ctrl-C (-1: no Ctrl-C)."""
    done: list[FaultTask] = []

    def fly(task: FaultTask) -> FaultRow:
        if len(done) == flights_before_ctrl_c[0]:
            raise KeyboardInterrupt
        done.append(task)
        return flown(task)

    flights_before_ctrl_c = [-1]
    monkeypatch.setattr(suite, "fly_fault", fly)
    return done, flights_before_ctrl_c


def session(tmp_path, minutes: float | None = None, seeds=range(1, 3)) -> FaultSuiteSession:
    todo = suite.list_tasks(select_cases(["7"]), AUTOPILOTS, PHASES, seeds, tmp_path)
    console = Console(quiet=True)
    return FaultSuiteSession(todo, WorkerOptions(), minutes, tmp_path / "faults.json", console)


def test_after_ctrl_c_the_same_command_flies_the_rest_and_nothing_twice(tmp_path, flights):
    done, stops = flights
    stops[0] = 3
    with pytest.raises(KeyboardInterrupt):
        session(tmp_path).fly_and_store_remaining_flights()
    kept = json.loads((tmp_path / "faults.json").read_text())
    assert (kept["of"], kept["left"]) == (3, len(session(tmp_path).tasks) - 3)
    stops[0] = -1
    rows = session(tmp_path).fly_and_store_remaining_flights()
    assert len(done) == len({(t.fault, t.autopilot, t.phase, t.seed) for t in done})
    asked = [(t.autopilot, t.phase, t.seed) for t in session(tmp_path).tasks]
    assert [(r.autopilot, r.phase, r.seed) for r in rows] == asked
    whole = json.loads((tmp_path / "faults.json").read_text())
    assert (whole["of"], whole["left"]) == (len(asked), 0)
    assert whole["cpu_s"] == {"median": 1.5, "most": 2.0}


def test_another_command_does_not_take_up_what_this_one_flew(tmp_path, flights):
    done, stops = flights
    stops[0] = 3
    with pytest.raises(KeyboardInterrupt):
        session(tmp_path).fly_and_store_remaining_flights()
    other = session(tmp_path, seeds=range(1, 2))
    assert other.progress_log.read_finished_results() == {}
    path = tmp_path / "faults.json"
    kept = open_progress_log(path, session(tmp_path).tasks).read_finished_results()
    assert len(kept) == len(done) == 3


def test_tight_flights_are_not_taken_for_others(tmp_path):
    rows = select_cases(["pack-aged"])
    plain, tight = (
        suite.list_tasks(rows, AUTOPILOTS, PHASES, [1], tmp_path, tight=tight)
        for tight in (False, True)
    )
    path = tmp_path / "faults.json"
    with open_progress_log(path, plain).rewrite_and_open_writer({}) as add:
        add(0, flown(plain[0]))
    assert len(open_progress_log(path, plain).read_finished_results()) == 1
    assert open_progress_log(path, tight).read_finished_results() == {}


def test_no_flight_begins_when_the_time_is_up_and_what_was_flown_is_a_drawn_sample(
    tmp_path, flights, monkeypatch
):
    done, _ = flights
    now_s = iter(range(10_000))
    monkeypatch.setattr("sim_bridge.app.trials.trial.wall_s", lambda: float(next(now_s)))
    rows = session(tmp_path, minutes=5.0 / 60.0).fly_and_store_remaining_flights()
    assert len(rows) == len(done) == 4
    todo = session(tmp_path).tasks
    assert list(done) != list(todo[:4])
    assert len(session(tmp_path).fly_and_store_remaining_flights()) == len(todo)
    assert len(done) == len(todo)


def one_is_lost(todo, attempt, workers, say):
    """Replaces workers of which one was killed twice, by a flight of seed 2."""
    for index, task in enumerate(todo):
        is_lost = (task.autopilot, task.seed) == (AUTOPILOTS[0], 2)
        yield ItemLost(index, task, "SIGKILL") if is_lost else ItemDone(index, attempt(task))


def test_a_flight_whose_worker_is_killed_is_no_row_and_is_named(tmp_path, flights, monkeypatch):
    monkeypatch.setattr("sim_bridge.app.fault_suite.session.run_parallel", one_is_lost)
    todo = suite.list_tasks(select_cases(["7"]), AUTOPILOTS, PHASES[2:3], range(1, 3), tmp_path)
    one = FaultSuiteSession(
        todo, WorkerOptions(2), None, tmp_path / "faults.json", Console(quiet=True)
    )
    rows = one.fly_and_store_remaining_flights()
    assert [(row.autopilot, row.seed) for row in rows] == [
        (AUTOPILOTS[0], 1),
        (AUTOPILOTS[1], 1),
        (AUTOPILOTS[1], 2),
    ]
    told = json.loads((tmp_path / "faults.json").read_text())
    assert (told["of"], told["left"]) == (3, 1)
    (words,) = told["lost"]
    assert words == f"{todo[1].fault} {AUTOPILOTS[0]} {PHASES[2]} seed 2: SIGKILL"
    assert len(open_progress_log(tmp_path / "faults.json", todo).read_finished_results()) == 3, (
        "to go on with"
    )
