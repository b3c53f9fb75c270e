"""Planning runs in a thread next to the loop, or synchronously in lockstep."""

import threading
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from companion.app.flight.planning import PlanningExecutor
from companion.core.routing.route_planner import NoRoute

WAIT_S = 30.0


@dataclass
class SlowWork:
    """A `FindPlan` as the planner sees it; it completes when the test allows it."""

    request_number: int = 1
    resume: threading.Event = field(default_factory=threading.Event)
    fault: Exception | None = None

    def compute_plan(self) -> NoRoute:
        assert self.resume.wait(WAIT_S)
        if self.fault is not None:
            raise self.fault
        return NoRoute(f"number {self.request_number}")


def wait_for(planning: PlanningExecutor) -> tuple[int, object]:
    for _ in range(int(WAIT_S / 0.01)):
        found = planning.take_next_result()
        if found is not None:
            return found
        threading.Event().wait(0.01)
    raise AssertionError("nothing was found")


def test_who_asks_goes_on_while_the_work_is_done():
    planning, asked = PlanningExecutor(synchronous=False), SlowWork(7)
    planning.start_planning(asked)
    assert planning.take_next_result() is None
    asked.resume.set()
    assert wait_for(planning) == (7, NoRoute("number 7"))
    assert planning.take_next_result() is None


def test_in_a_world_that_waits_it_is_done_when_begin_returns():
    planning, asked = PlanningExecutor(synchronous=True), SlowWork(7)
    asked.resume.set()
    planning.start_planning(asked)
    assert planning.take_next_result() == (7, NoRoute("number 7"))
    assert planning.take_next_result() is None


@pytest.mark.parametrize("synchronous", [True, False])
@pytest.mark.parametrize("fault", [ZeroDivisionError("of the work"), MemoryError()])
def test_what_breaks_in_the_work_is_no_plan_and_says_what_and_where(
    synchronous: bool, fault: Exception
):
    planning, asked = PlanningExecutor(synchronous=synchronous), SlowWork(fault=fault)
    asked.resume.set()
    planning.start_planning(asked)
    number, found = wait_for(planning)
    assert number == asked.request_number
    assert isinstance(found, NoRoute)
    assert f"planning failed: {type(fault).__name__}" in found.reason
    assert Path(__file__).name in found.reason


def test_without_a_thread_to_be_had_the_loop_does_the_work(monkeypatch):
    def no_thread(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", no_thread)
    planning, asked = PlanningExecutor(synchronous=False), SlowWork(7)
    asked.resume.set()
    planning.start_planning(asked)
    assert planning.take_next_result() == (7, NoRoute("number 7"))
