"""Runs a campaign's tasks on one core, on many, or on a Ray cluster, and survives Ctrl-C.

What is done is kept in a journal beside the result (`OUT.partial`).
"""

import hashlib
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from multiprocessing import get_context
from pathlib import Path
from typing import Protocol

import msgspec

from companion.core.base.errors import LeewayError
from sim_bridge.adapters.journal import Journal, leave_ctrl_c_to_the_parent
from sim_bridge.research.campaign.campaign import (
    CampaignParams,
    CampaignRow,
    CampaignTask,
    TaskResult,
    Workbench,
    rows_of,
    run_task,
    tasks_of,
)
from sim_bridge.research.planners.scenario import Scenario, scenario_json

PER_WORKER = 2  # tasks handed out ahead of each worker


class Executor(Protocol):
    """Somewhere to run tasks: yields (index, result) in any order."""

    def run(self, pending: list[tuple[int, CampaignTask]]) -> Iterator[tuple[int, TaskResult]]: ...


class InProcess:
    """One core, no processes."""

    def __init__(self, scenarios: list[Scenario], params: CampaignParams) -> None:
        self._worker = Worker(scenarios, params)

    def run(self, pending: list[tuple[int, CampaignTask]]) -> Iterator[tuple[int, TaskResult]]:
        for index, task in pending:
            yield index, self._worker.run(task)


class Worker:
    """Runs tasks, keeping the last scenario's planners."""

    def __init__(self, scenarios: list[Scenario], params: CampaignParams) -> None:
        self._scenarios, self._params = scenarios, params
        self._at = -1
        self._bench: Workbench | None = None

    def run(self, task: CampaignTask) -> TaskResult:
        if self._bench is None or self._at != task.scenario:
            self._bench = Workbench(self._scenarios[task.scenario], self._params)
            self._at = task.scenario
        return run_task(self._scenarios[task.scenario], self._params, task, self._bench)


_worker: list[Worker] = []  # of this process, when it is one of a pool


def _begin_worker(scenarios: list[Scenario], params: CampaignParams) -> None:
    leave_ctrl_c_to_the_parent()
    _worker[:] = [Worker(scenarios, params)]


def _run_in_worker(task: CampaignTask) -> TaskResult:
    return _worker[0].run(task)


class Pool:
    """Several processes of this machine."""

    def __init__(self, scenarios: list[Scenario], params: CampaignParams, jobs: int) -> None:
        self._scenarios, self._params, self._jobs = scenarios, params, jobs

    def run(self, pending: list[tuple[int, CampaignTask]]) -> Iterator[tuple[int, TaskResult]]:
        pool = ProcessPoolExecutor(
            self._jobs,
            mp_context=get_context("spawn"),  # a fork would copy BLAS's threads half way
            initializer=_begin_worker,
            initargs=(self._scenarios, self._params),
        )
        waiting = iter(pending)
        running = {}
        try:
            while True:
                while len(running) < PER_WORKER * self._jobs:
                    following = next(waiting, None)
                    if following is None:
                        break
                    running[pool.submit(_run_in_worker, following[1])] = following[0]
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


class RayCluster:
    """A Ray cluster (the `ray` extra); the scenarios travel once."""

    def __init__(
        self, scenarios: list[Scenario], params: CampaignParams, address: str | None
    ) -> None:
        try:
            import ray  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise LeewayError("ray is not installed: pip install 'leeway-uas[ray]'") from None
        self._ray = ray
        if not ray.is_initialized():
            ray.init(address=address, log_to_driver=False, include_dashboard=False)
        encoded = [scenario_json(scenario) for scenario in scenarios]
        self._shared = ray.put((encoded, params))
        self._run = ray.remote(_run_on_ray)

    def run(self, pending: list[tuple[int, CampaignTask]]) -> Iterator[tuple[int, TaskResult]]:
        ray = self._ray
        cores = int(ray.cluster_resources().get("CPU", 1))
        waiting = iter(pending)
        running: dict = {}
        while True:
            while len(running) < PER_WORKER * cores:
                following = next(waiting, None)
                if following is None:
                    break
                running[self._run.remote(self._shared, following[1])] = following[0]
            if not running:
                return
            ready, _ = ray.wait(list(running), num_returns=1)
            for reference in ready:
                yield running.pop(reference), ray.get(reference)


def _run_on_ray(shared: tuple[list[bytes], CampaignParams], task: CampaignTask) -> TaskResult:
    encoded, params = shared
    scenarios = [msgspec.json.decode(text, type=Scenario) for text in encoded]
    return Worker(scenarios, params).run(task)


def campaign_digest(scenarios: list[Scenario], planners: list[str], params: CampaignParams) -> str:
    """What tells one campaign from another: a journal belongs to one."""
    digest = hashlib.sha256(repr((planners, params)).encode())
    for scenario in scenarios:
        digest.update(scenario_json(scenario))
    return digest.hexdigest()


def campaign_journal(
    out: Path, scenarios: list[Scenario], planners: list[str], params: CampaignParams
) -> Journal[TaskResult]:
    """The journal of this campaign beside its result."""
    digest = campaign_digest(scenarios, planners, params)
    return Journal(out.with_name(out.name + ".partial"), digest, TaskResult)


def run(
    scenarios: list[Scenario],
    planners: list[str],
    params: CampaignParams,
    executor: Executor,
    journal: Journal[TaskResult] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    say: Callable[[str], None] = lambda note: None,
) -> list[CampaignRow]:
    """The campaign's rows; KeyboardInterrupt leaves what is done in the journal."""
    tasks = tasks_of(len(scenarios), planners, params)
    done = journal.read() if journal else {}
    progress(len(done), len(tasks))
    pending = [(i, task) for i, task in enumerate(tasks) if i not in done]
    notes: set[str] = set()

    def collect(keep: Callable[[int, TaskResult], None]) -> None:
        for index, result in executor.run(pending):
            keep(index, result)
            done[index] = result
            if result.note and result.note not in notes:
                notes.add(result.note)
                say(result.note)
            progress(len(done), len(tasks))

    if journal is None:
        collect(lambda index, result: None)
    else:
        with journal.writing(done) as keep:
            collect(keep)
    return list(rows_of(scenarios, tasks, done))
