"""The suite in pieces: what was flown is kept, and the same command goes on with the rest."""

import json

import pytest
from rich.console import Console

from sim_bridge.app.fault_suite import suite
from sim_bridge.app.fault_suite.catalogue import chosen
from sim_bridge.app.fault_suite.session import Session, journal_of
from sim_bridge.app.faults.case import BOTH, PHASES
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.trials.trial import Bounds


def flown(task: FaultTask) -> FaultRow:
    return FaultRow(
        fault=task.fault,
        group="authority",
        autopilot=task.autopilot,
        phase=task.phase,
        seed=task.seed,
        outcome="SUC",
        home=True,
        delivered=True,
        margin_wh=1.0,
        p_home_last_go=0.995,
        commands_after_takeover=0,
        exceptions=0,
        said=[],
        held=True,
        why="",
        cpu_s=float(task.seed),
    )


@pytest.fixture
def flights(monkeypatch):
    """Tasks in the order in which they were flown, and how many before Ctrl-C (-1: none)."""
    done: list[FaultTask] = []

    def fly(task: FaultTask) -> FaultRow:
        if len(done) == flights_before_ctrl_c[0]:
            raise KeyboardInterrupt
        done.append(task)
        return flown(task)

    flights_before_ctrl_c = [-1]
    monkeypatch.setattr(suite, "fly_fault", fly)
    return done, flights_before_ctrl_c


def session(tmp_path, minutes: float | None = None, seeds=range(1, 3)) -> Session:
    todo = suite.tasks(chosen(["7"]), BOTH, PHASES, seeds, tmp_path)
    console = Console(quiet=True)
    return Session(todo, Bounds(1, minutes), tmp_path / "faults.json", console)


def test_after_ctrl_c_the_same_command_flies_the_rest_and_nothing_twice(tmp_path, flights):
    done, stops = flights
    stops[0] = 3
    with pytest.raises(KeyboardInterrupt):
        session(tmp_path).run()
    kept = json.loads((tmp_path / "faults.json").read_text())
    assert (kept["of"], kept["left"]) == (3, len(session(tmp_path).todo) - 3)
    stops[0] = -1
    rows = session(tmp_path).run()
    assert len(done) == len({(t.fault, t.autopilot, t.phase, t.seed) for t in done})
    asked = [(t.autopilot, t.phase, t.seed) for t in session(tmp_path).todo]
    assert [(r.autopilot, r.phase, r.seed) for r in rows] == asked
    whole = json.loads((tmp_path / "faults.json").read_text())
    assert (whole["of"], whole["left"]) == (len(asked), 0)
    assert whole["cpu_s"] == {"median": 1.5, "most": 2.0}


def test_another_command_does_not_take_up_what_this_one_flew(tmp_path, flights):
    done, stops = flights
    stops[0] = 3
    with pytest.raises(KeyboardInterrupt):
        session(tmp_path).run()
    other = session(tmp_path, seeds=range(1, 2))
    assert other.journal is not None
    assert other.journal.read() == {}
    path = tmp_path / "faults.json"
    assert len(journal_of(path, session(tmp_path).todo).read()) == len(done) == 3


def test_tight_flights_are_not_taken_for_others(tmp_path):
    rows = chosen(["pack-aged"])
    plain, tight = (
        suite.tasks(rows, BOTH, PHASES, [1], tmp_path, tight=tight) for tight in (False, True)
    )
    path = tmp_path / "faults.json"
    with journal_of(path, plain).writing({}) as add:
        add(0, flown(plain[0]))
    assert len(journal_of(path, plain).read()) == 1
    assert journal_of(path, tight).read() == {}


def test_no_flight_begins_when_the_time_is_up_and_what_was_flown_is_a_drawn_sample(
    tmp_path, flights, monkeypatch
):
    done, _ = flights
    now_s = iter(range(10_000))
    monkeypatch.setattr("sim_bridge.app.trials.trial.wall_s", lambda: float(next(now_s)))
    rows = session(tmp_path, minutes=5.0 / 60.0).run()
    assert len(rows) == len(done) == 4
    todo = session(tmp_path).todo
    assert list(done) != list(todo[:4])
    assert len(session(tmp_path).run()) == len(todo)
    assert len(done) == len(todo)


def one_is_lost(todo, attempt, bounds, lost, say):
    """Stands for workers of which one was killed twice, by a flight of seed 2."""
    for numbered in todo:
        is_lost = (numbered[1].autopilot, numbered[1].seed) == (BOTH[0], 2)
        yield from lost(numbered, "SIGKILL") if is_lost else attempt(numbered)


def test_a_flight_whose_worker_is_killed_is_no_row_and_is_named(tmp_path, flights, monkeypatch):
    monkeypatch.setattr(suite, "tried", one_is_lost)
    todo = suite.tasks(chosen(["7"]), BOTH, PHASES[2:3], range(1, 3), tmp_path)
    one = Session(todo, Bounds(2, None), tmp_path / "faults.json", Console(quiet=True))
    rows = one.run()
    assert [(row.autopilot, row.seed) for row in rows] == [(BOTH[0], 1), (BOTH[1], 1), (BOTH[1], 2)]
    told = json.loads((tmp_path / "faults.json").read_text())
    assert (told["of"], told["left"]) == (3, 1)
    (words,) = told["lost"]
    assert words == f"{todo[1].fault} {BOTH[0]} {PHASES[2]} seed 2: SIGKILL"
    assert len(journal_of(tmp_path / "faults.json", todo).read()) == 3, "to go on with"
