"""A plan is worked on beside the loop, or at once in a world that waits."""

import threading
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from companion.app.flight.planning import PlanAtOnce, PlanBeside, Planning
from companion.core.routing.route_planner import NoRoute

WAIT_S = 30.0


@dataclass
class SlowWork:
    """What a `FindPlan` is to whoever works on it; it ends when the test lets it."""

    number: int = 1
    go_on: threading.Event = field(default_factory=threading.Event)
    fault: Exception | None = None

    def work(self) -> NoRoute:
        assert self.go_on.wait(WAIT_S)
        if self.fault is not None:
            raise self.fault
        return NoRoute(f"number {self.number}")


def wait_for(planning: Planning) -> tuple[int, object]:
    for _ in range(int(WAIT_S / 0.01)):
        found = planning.found()
        if found is not None:
            return found
        threading.Event().wait(0.01)
    raise AssertionError("nothing was found")


def test_who_asks_goes_on_while_the_work_is_done():
    planning, asked = PlanBeside(), SlowWork(7)
    planning.begin(asked)
    assert planning.found() is None
    asked.go_on.set()
    assert wait_for(planning) == (7, NoRoute("number 7"))
    assert planning.found() is None


def test_in_a_world_that_waits_it_is_done_when_begin_returns():
    planning, asked = PlanAtOnce(), SlowWork(7)
    asked.go_on.set()
    planning.begin(asked)
    assert planning.found() == (7, NoRoute("number 7"))
    assert planning.found() is None


@pytest.mark.parametrize("kind", [PlanAtOnce, PlanBeside])
@pytest.mark.parametrize("fault", [ZeroDivisionError("of the work"), MemoryError()])
def test_what_breaks_in_the_work_is_no_plan_and_says_what_and_where(kind: type, fault: Exception):
    planning, asked = kind(), SlowWork(fault=fault)
    asked.go_on.set()
    planning.begin(asked)
    number, found = wait_for(planning)
    assert number == asked.number
    assert isinstance(found, NoRoute)
    assert f"planning failed: {type(fault).__name__}" in found.reason
    assert Path(__file__).name in found.reason


def test_without_a_thread_to_be_had_the_loop_does_the_work(monkeypatch):
    def no_thread(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", no_thread)
    planning, asked = PlanBeside(), SlowWork(7)
    asked.go_on.set()
    planning.begin(asked)
    assert planning.found() == (7, NoRoute("number 7"))
