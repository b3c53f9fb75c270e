"""Runs a campaign's tasks side by side, and survives Ctrl-C and workers that are killed.

What is done is kept in a journal beside the result (`OUT.partial`).
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from ground_station.adapters.workers.side_by_side import PieceLost, Workers, side_by_side
from sim_bridge.adapters.journal import Journal
from sim_bridge.research.campaign.campaign import (
    BLOCK,
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


class CampaignWork:
    """Runs tasks wherever it is sent, keeping the last scenario's planners there."""

    def __init__(self, scenarios: list[Scenario], params: CampaignParams) -> None:
        self._encoded = [scenario_json(scenario) for scenario in scenarios]
        self._params = params
        self._at = -1
        self._bench: Workbench | None = None

    def __getstate__(self) -> tuple[list[bytes], CampaignParams]:
        return self._encoded, self._params

    def __setstate__(self, state: tuple[list[bytes], CampaignParams]) -> None:
        self._encoded, self._params = state
        self._at, self._bench = -1, None

    def __call__(self, task: CampaignTask) -> TaskResult:
        if self._bench is None or self._at != task.scenario:
            scenario = msgspec.json.decode(self._encoded[task.scenario], type=Scenario)
            self._bench = Workbench(scenario, self._params)
            self._at = task.scenario
        return run_task(self._bench.scenario, self._params, task, self._bench)


@dataclass(frozen=True, slots=True)
class CampaignRun:
    """Rows that are whole, and what no worker came back with."""

    rows: list[CampaignRow]
    lost: list[str]
    """Scenario, planner and first mission of each lost task, and why."""


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
    workers: Workers,
    journal: Journal[TaskResult] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    say: Callable[[str], None] = lambda note: None,
) -> CampaignRun:
    """The campaign's rows; KeyboardInterrupt leaves what is done in the journal.

    A row that misses a task whose workers died is left out; the journal has its others.
    """
    tasks = tasks_of(len(scenarios), planners, params)
    done = journal.read() if journal else {}
    progress(len(done), len(tasks))
    pending = [i for i in range(len(tasks)) if i not in done]
    notes: set[str] = set()
    lost: dict[int, str] = {}

    def collect(keep: Callable[[int, TaskResult], None]) -> None:
        work = CampaignWork(scenarios, params)
        for ended in side_by_side((tasks[i] for i in pending), work, workers, say):
            index = pending[ended.index]
            if isinstance(ended, PieceLost):
                lost[index] = ended.why
                continue
            result = ended.result
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
    words = [_lost_in_words(scenarios, tasks[index], why) for index, why in sorted(lost.items())]
    return CampaignRun(list(rows_of(scenarios, tasks, done)), words)


def _lost_in_words(scenarios: list[Scenario], task: CampaignTask, why: str) -> str:
    first = task.first_block * BLOCK + 1
    return f"{scenarios[task.scenario].name}, {task.planner}, missions from {first} on: {why}"
