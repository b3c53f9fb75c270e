"""Scheduling among a process's members: due members first, then woken ones."""

import queue
import threading
import time

import pytest

pytest.importorskip("sqlalchemy", reason="the extra ground is not installed")

from companion.adapters.clock import wall_s
from sim_bridge.research.benchmarks.fleet_bench import members


class Counted:
    """A member that requests its next turn after `every_s`."""

    def __init__(self, every_s: float) -> None:
        self.every_s = every_s
        self.turns_s: list[float] = []

    def update_and_return_next_call_time_s(self) -> float:
        self.turns_s.append(wall_s())
        return self.turns_s[-1] + self.every_s


def test_each_has_its_turns_and_a_flood_of_wakes_takes_nobody_elses() -> None:
    flooded, often, seldom = Counted(10.0), Counted(0.05), Counted(0.3)
    woken: queue.SimpleQueue[int] = queue.SimpleQueue()
    for _ in range(200_000):
        woken.put(0)
    stop = threading.Event()
    threading.Timer(1.0, stop.set).start()
    begun_s = wall_s()
    members.update_members_until_stopped(stop, [flooded, often, seldom], woken)
    assert wall_s() - begun_s < 2.0
    assert len(flooded.turns_s) > 100
    assert 8 <= len(often.turns_s) <= 21
    assert 3 <= len(seldom.turns_s) <= 5


def test_who_is_woken_comes_at_once() -> None:
    resting = Counted(60.0)
    woken: queue.SimpleQueue[int] = queue.SimpleQueue()
    stop = threading.Event()
    thread = threading.Thread(
        target=members.update_members_until_stopped, args=(stop, [resting], woken)
    )
    thread.start()
    while not resting.turns_s and thread.is_alive():
        time.sleep(0.001)
    told_s = wall_s()
    woken.put(0)
    while len(resting.turns_s) < 2 and wall_s() - told_s < 5.0:
        time.sleep(0.001)
    stop.set()
    thread.join(2.0)
    assert resting.turns_s[1] - told_s < 0.2
