"""The same work on a Ray cluster of two processors: equal results, a killed worker costs its piece.

Skipped where the extra `ray` is not installed (200 MB): `make night` brings it.
"""

import os
import signal
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import (
    ItemDone,
    ItemLost,
    WorkerOptions,
    run_parallel,
)

ray: Any = pytest.importorskip("ray", reason="the extra ray is not installed (make night has it)")

pytestmark = [
    pytest.mark.timeout(180),
    pytest.mark.filterwarnings("ignore"),  # Ray's own, of its start
]


def done_of(ended: Iterable[ItemDone[Any] | ItemLost[Any]]) -> list[tuple[int, Any]]:
    """Index and result of all that are done."""
    return sorted((one.index, one.result) for one in ended if isinstance(one, ItemDone))


@pytest.fixture(scope="module")
def cluster() -> Iterator[WorkerOptions]:
    """Two machines of one processor each, in processes of their own."""
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

    started = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        started.add_node(num_cpus=1)
        yield WorkerOptions(cluster=started.address)
    finally:
        ray.shutdown()
        started.shutdown()


def place_of(number: int) -> tuple[int, str]:
    return number * number, os.getcwd()


def killed_at_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def killed_once(piece: tuple[int, Path | None]) -> int:
    number, marker = piece
    if marker is not None and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def refuses_two(number: int) -> int:
    if number == 2:
        raise LeewayError("two: expected another number")
    return number


def test_results_are_those_of_processes_and_files_are_found_from_the_same_folder(
    cluster: WorkerOptions,
) -> None:
    there = done_of(run_parallel(range(7), place_of, cluster))
    here = done_of(run_parallel(range(7), place_of, WorkerOptions(2)))
    assert there == here == [(n, (n * n, os.getcwd())) for n in range(7)]


def test_a_piece_that_kills_twice_is_lost_and_no_other(cluster: WorkerOptions) -> None:
    ended = list(run_parallel(range(6), killed_at_three, cluster))
    (lost,) = [one for one in ended if isinstance(one, ItemLost)]
    assert (lost.index, lost.item) == (3, 3)
    assert done_of(ended) == [(n, n * n) for n in (0, 1, 2, 4, 5)]


def test_a_piece_whose_worker_is_killed_once_is_tried_again(
    cluster: WorkerOptions, tmp_path: Path
) -> None:
    said: list[str] = []
    work = [(n, tmp_path / "killed" if n == 1 else None) for n in range(5)]
    ended = list(run_parallel(work, killed_once, cluster, said.append))
    assert done_of(ended) == [(n, n * n) for n in range(5)]
    assert len(said) == 1


def test_what_a_piece_raises_is_raised_here(cluster: WorkerOptions) -> None:
    with pytest.raises(LeewayError, match="two: expected another number"):
        list(run_parallel(range(4), refuses_two, cluster))


@pytest.mark.parametrize(
    ("address", "words"), [("127.0.0.1:1", "no cluster responds"), ("somewhere", "HOST:PORT")]
)
def test_a_cluster_that_is_not_there_is_said_at_once(address: str, words: str) -> None:
    with pytest.raises(LeewayError, match=rf"--cluster {address}.*{words}"):
        list(run_parallel([1], place_of, WorkerOptions(cluster=address)))
