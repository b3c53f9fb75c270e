"""Parallel work: equal results for any number of workers; a killed worker costs one item."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from itertools import count, islice
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import psutil
import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import (
    ItemDone,
    ItemLost,
    WorkerOptions,
    run_parallel,
)

TWO = WorkerOptions(jobs=2)


def done_of(ended: Iterable[ItemDone[Any] | ItemLost[Any]]) -> list[tuple[int, Any]]:
    """Index and result of all that are done."""
    return sorted((one.index, one.result) for one in ended if isinstance(one, ItemDone))


def square(number: int) -> int:
    return number * number


def squares_but_kills(piece: tuple[int, Path | None]) -> int:
    """Kill its own process if the item requests it: once, if its file does not exist yet."""
    number, marker = piece
    if marker is not None and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def always_kills_at_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def refuses_two(number: int) -> int:
    if number == 2:
        raise LeewayError("two: expected another number")
    return number


def no_result(number: int) -> object:
    return lambda: number


def sleeps(folder: Path) -> None:
    (folder / str(os.getpid())).touch()
    time.sleep(60.0)


@pytest.mark.sample
@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_results_are_the_same_whatever_the_number_of_workers(jobs: int) -> None:
    ended = list(run_parallel(range(7), square, WorkerOptions(jobs)))
    assert done_of(ended) == [(n, n * n) for n in range(7)]


def test_pieces_of_a_worker_that_is_killed_once_are_tried_again(tmp_path: Path) -> None:
    said: list[str] = []
    work = [(n, tmp_path / "killed" if n == 1 else None) for n in range(5)]
    ended = list(run_parallel(work, squares_but_kills, TWO, said.append))
    assert (tmp_path / "killed").exists()
    assert done_of(ended) == [(n, n * n) for n in range(5)]
    assert said == ["a worker was killed by SIGKILL: its work item is retried once"]


@pytest.mark.sample
def test_a_piece_that_kills_twice_is_lost_and_no_other() -> None:
    ended = list(run_parallel(range(6), always_kills_at_three, TWO))
    (lost,) = [one for one in ended if isinstance(one, ItemLost)]
    assert (lost.index, lost.item) == (3, 3)
    assert "SIGKILL" in lost.reason
    assert done_of(ended) == [(n, n * n) for n in (0, 1, 2, 4, 5)]


def test_what_a_piece_raises_is_raised_and_ends_the_workers() -> None:
    with pytest.raises(LeewayError, match="two: expected another number") as caught:
        list(run_parallel(range(4), refuses_two, TWO))
    assert "refuses_two" in "".join(caught.value.__notes__)
    assert not active_children()


def test_a_result_that_cannot_be_sent_is_said() -> None:
    with pytest.raises(RuntimeError, match="cannot be sent"):
        list(run_parallel([1], no_result, TWO))


def test_endless_work_is_taken_as_it_is_begun() -> None:
    taken: list[int] = []
    work = (taken.append(n) or n for n in count())
    rows = run_parallel(work, square, TWO)
    assert len(list(islice(rows, 4))) == 4
    rows.close()
    assert len(taken) <= 4 + 2 * TWO.jobs
    assert not active_children()


STARTS = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_side_by_side import sleeps
from ground_station.adapters.workers.side_by_side import WorkerOptions, run_parallel
if __name__ == "__main__":
    list(run_parallel([Path(sys.argv[2])] * 2, sleeps, WorkerOptions(2)))
"""


@pytest.mark.sample
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_who_started_them(number: signal.Signals, tmp_path: Path) -> None:
    script, folder = tmp_path / "starts.py", tmp_path / "at_work"
    script.write_text(STARTS)
    folder.mkdir()
    here = str(Path(__file__).parent)
    parent = subprocess.Popen([sys.executable, str(script), here, str(folder)], stderr=-3)
    wait_until(lambda: len(list(folder.iterdir())) == 2)
    parent.send_signal(number)
    assert parent.wait(10.0) != 0
    wait_until(lambda: not any(psutil.pid_exists(int(path.name)) for path in folder.iterdir()))


def wait_until(is_so: Callable[[], bool], limit_s: float = 20.0) -> None:
    until_s = time.monotonic() + limit_s
    while not is_so():
        assert time.monotonic() < until_s
        time.sleep(0.02)
