"""Parallel work items; a killed worker affects only its own work item."""

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from ground_station.adapters.workers.answers import WorkRaised, WorkReturned

if TYPE_CHECKING:
    from ground_station.adapters.workers.process_crew import ProcessPool
    from ground_station.adapters.workers.ray_crew import ClusterPool

Work = TypeVar("Work")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """Worker configuration: `jobs` processes of this machine, or instead a Ray cluster."""

    jobs: int = 1
    cluster: str | None = None
    """`local` (started and ended by this program), `auto` (the cluster of this machine) or an
    address.
    """


@dataclass(frozen=True, slots=True)
class ItemDone(Generic[Result]):
    """A finished work item; `index` counts the items from 0 in input order."""

    index: int
    result: Result


@dataclass(frozen=True, slots=True)
class ItemLost(Generic[Work]):
    """A work item that is lost because two workers died on it."""

    index: int
    item: Work
    reason: str


def run_parallel(
    items: Iterable[Work],
    work_function: Callable[[Work], Result],
    worker_options: WorkerOptions,
    log_message: Callable[[str], None] = lambda words: None,
) -> Generator[ItemDone[Result] | ItemLost[Work], None, None]:
    """Run `work_function` on every work item, started in input order, yielded as they finish.

    `work_function`, items and results are pickled; with one job and no cluster, all runs in this
    process without pickling. A work item whose worker dies (SIGKILL, out of memory) is retried
    once, then lost; other items are not affected. Exceptions of `work_function` are raised here.
    The workers end when this process ends, also by Ctrl-C or SIGTERM. Items are taken from `items`
    when they start, so it may be endless.

    Raises: LeewayError if the cluster cannot be reached.
    """
    if worker_options.cluster is None and worker_options.jobs == 1:
        for index, item in enumerate(items):
            yield ItemDone(index, work_function(item))
        return
    pool = _create_pool(work_function, worker_options)
    try:
        yield from _run_items_with_one_retry(iter(enumerate(items)), pool, log_message)
    finally:
        pool.close()


def _create_pool(
    work_function: Callable[[Work], Result], worker_options: WorkerOptions
) -> "ProcessPool[Work, Result] | ClusterPool[Work, Result]":
    if worker_options.cluster is not None:
        from ground_station.adapters.workers.ray_crew import ClusterPool

        return ClusterPool(work_function, worker_options.cluster)
    from ground_station.adapters.workers.process_crew import ProcessPool

    return ProcessPool(work_function, worker_options.jobs)


def _run_items_with_one_retry(
    pending_items: Iterator[tuple[int, Work]],
    pool: "ProcessPool[Work, Result] | ClusterPool[Work, Result]",
    log_message: Callable[[str], None],
) -> Iterator[ItemDone[Result] | ItemLost[Work]]:
    in_progress: dict[int, Work] = {}
    retries: deque[tuple[int, Work]] = deque()
    termination_texts: dict[int, str] = {}

    def start_items_on_free_workers() -> None:
        while len(in_progress) < pool.max_concurrent_items:
            next_item = retries.popleft() if retries else next(pending_items, None)
            if next_item is None:
                return
            pool.start_item(*next_item)
            in_progress[next_item[0]] = next_item[1]

    start_items_on_free_workers()
    while in_progress:
        finished: list[ItemDone[Result] | ItemLost[Work]] = []
        error: BaseException | None = None
        for index, outcome in pool.wait_outcomes():
            item = in_progress.pop(index)
            if isinstance(outcome, WorkReturned):
                finished.append(ItemDone(index, outcome.result))
            elif isinstance(outcome, WorkRaised):
                error = outcome.error
            elif index in termination_texts:
                finished.append(
                    ItemLost(index, item, f"{termination_texts[index]}; again: {outcome.reason}")
                )
            else:
                termination_texts[index] = outcome.reason
                retries.append((index, item))
                log_message(f"{outcome.reason}: its work item is retried once")
        if error is None:
            # first: keeps workers busy while the caller handles results
            start_items_on_free_workers()
        yield from finished
        if error is not None:
            raise error
