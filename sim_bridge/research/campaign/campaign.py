"""Campaigns: many missions on many scenarios by many planners, with the same winds for all.

Missions are split into blocks whose random numbers depend on the seed, the scenario and the block
only. Rows are sums over blocks in order, so they do not depend on the number of jobs.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from types import MappingProxyType

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.core.base.errors import LeewayError
from companion.core.base.plugin import PLANNERS as PLUGIN_GROUP
from companion.core.base.plugin import load_plugin
from companion.core.routing.planner_interface import (
    BatchPlanner,
    MissionPlanner,
    PlannerObservation,
)
from sim_bridge.research.campaign.workbench import (
    MISSIONS_PER_BLOCK,
    PLANNERS,
    CampaignParams,
    Workbench,
)
from sim_bridge.research.planners.mission_model import (
    MissionResults,
    Outcome,
    fly_missions,
)
from sim_bridge.research.planners.planner_plugin import PlannerFactory
from sim_bridge.research.planners.scenario import LogWind, Scenario, parse_scenario, scenario_json
from sim_bridge.research.study.intervals import wilson95
from sim_bridge.research.study.run import Experiment, Report
from sim_bridge.research.study.sheet import Column, Sheet, format_optional, low_to_high

BLOCKS_PER_TASK = 5
TIMED_DECISIONS = 100  # decisions that are timed one by one,
TIMED_SHARE = 0.004  # but at most this share of the missions' number


class CampaignRow(msgspec.Struct, frozen=True):
    """One row of the campaign's JSON: counts of outcomes (docs/reference/outcomes.md), means."""

    scenario: str
    planner: str
    missions: int
    SUC: int
    DEL: int
    FAIL: int
    ABRT: int
    energy_wh_mean: float
    energy_wh_std: float
    margin_wh_mean: float | None
    margin_wh_std: float | None
    time_s_mean: float
    time_s_std: float
    decisions: int
    decision_us_median: float
    decision_us_p99: float

    @property
    def loss_frac(self) -> float:
        return (self.DEL + self.FAIL) / self.missions


class OutcomeSums(msgspec.Struct, frozen=True):
    """Sums over one block of missions, from which rows are computed."""

    outcomes: tuple[int, int, int, int]
    energy_wh: tuple[float, float]  # sum and sum of squares
    margin_wh: tuple[float, float]
    time_s: tuple[float, float]
    decisions: int


class CampaignTask(msgspec.Struct, frozen=True):
    """Some blocks of one row. The first task of a row also times decisions."""

    scenario: bytes
    """Content of a `delivery-scenario/1` file."""
    planner: str
    params: CampaignParams
    first_block: int
    blocks: int
    planner_version: str = ""
    """Of a plug-in: its distribution and version."""


class TaskResult(msgspec.Struct, frozen=True):
    """Result of a task; `note` is for the operator."""

    tallies: list[OutcomeSums]
    decision_us: list[float]
    note: str = ""


@lru_cache(maxsize=1)
def _cached_workbench(scenario: bytes, params: CampaignParams) -> Workbench:
    """Build the workbench. Tasks of one scenario share its planners through the cache."""
    return Workbench(msgspec.json.decode(scenario, type=Scenario), params)


def fly_campaign_task(
    task: CampaignTask, factories: Mapping[str, PlannerFactory] = MappingProxyType({})
) -> TaskResult:
    """Fly the task's blocks. `factories`: planners that the caller defines, by name."""
    bench = _cached_workbench(task.scenario, task.params)
    budget_wh = bench.scenario.budget_wh
    tallies: list[OutcomeSums] = []
    decision_us: list[float] = []
    factory = factories.get(task.planner)
    foreign = factory and bench.build_foreign_planner(task.planner, factory)
    for block in range(task.first_block, task.first_block + task.blocks):
        winds = bench.draw_block_winds(block)
        planner = foreign or bench.cached_planner(task.planner, winds)
        uniforms = bench.draw_uniform_per_mission(block, winds.mission_count)
        flown = fly_missions(bench.graph, budget_wh, winds, planner.start_batch(uniforms))
        tallies.append(sum_mission_results(flown, budget_wh))
        if block == 0:
            decision_us = measure_decision_times_us(bench, task.planner, foreign)
    note = ""
    if task.planner == "ber" and all(t.decisions == t.outcomes[Outcome.ABRT] for t in tallies):
        note = (
            f"{bench.scenario.name}: ber stays at the depot: no flight keeps P(loss) within"
            f" {task.params.max_loss:g}"
        )
    return TaskResult(tallies, decision_us, note)


def sum_mission_results(flown: MissionResults, budget_wh: float) -> OutcomeSums:
    """Sum over missions. The margin is the energy left of those that returned."""
    home = (flown.outcome == Outcome.SUC) | (flown.outcome == Outcome.ABRT)
    counts = np.bincount(flown.outcome, minlength=4).tolist()
    return OutcomeSums(
        outcomes=(counts[0], counts[1], counts[2], counts[3]),
        energy_wh=_sum_and_sum_of_squares(flown.energy_wh),
        margin_wh=_sum_and_sum_of_squares(budget_wh - flown.energy_wh[home]),
        time_s=_sum_and_sum_of_squares(flown.time_s),
        decisions=int(flown.decisions.sum()),
    )


def _sum_and_sum_of_squares(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values.sum()), float(np.square(values).sum())


class _TimedPlanner:
    """A decider that times its decisions, one mission at a time."""

    def __init__(self, decider: BatchPlanner) -> None:
        self._decider = decider
        self.decision_us: list[float] = []

    def select_edges(self, observation: PlannerObservation) -> NDArray[np.int64]:
        begin = perf_counter()
        edge = self._decider.select_edges(observation)
        self.decision_us.append((perf_counter() - begin) * 1e6)
        return edge


def measure_decision_times_us(
    bench: Workbench, planner_name: str, foreign: MissionPlanner | None = None
) -> list[float]:
    """Return microseconds of single decisions. Routes are planned without the cache."""
    if planner_name == "clairvoyant":
        return []  # it makes no decisions in flight
    planner = foreign or (
        bench.cached_planner(planner_name)
        if planner_name == "ber"  # its tables are not computed again
        else bench.build_planner(planner_name, use_cache=False)
    )
    times: list[float] = []
    for mission in range(bench.params.missions):
        timed = _TimedPlanner(planner.start_batch(bench.draw_uniform_per_mission(mission, 1)))
        winds = bench.draw_block_winds(mission, count=1)
        fly_missions(bench.graph, bench.scenario.budget_wh, winds, timed)
        times += timed.decision_us
        if len(times) > min(TIMED_DECISIONS, TIMED_SHARE * bench.params.missions):
            break
    return times[1:] if len(times) > 1 else times  # the first one fills caches


def split_campaign_into_tasks(
    scenarios: Sequence[Scenario], planners: Sequence[str], params: CampaignParams
) -> list[CampaignTask]:
    """Split the campaign into tasks, scenario by scenario."""
    blocks = -(-params.missions // MISSIONS_PER_BLOCK)
    return [
        CampaignTask(
            scenario_json(scenario), planner, params, first, min(BLOCKS_PER_TASK, blocks - first)
        )
        for scenario in scenarios
        for planner in planners
        for first in range(0, blocks, BLOCKS_PER_TASK)
    ]


def build_campaign(
    paths: Sequence[Path], planners: Sequence[str], params: CampaignParams
) -> Experiment[CampaignTask, TaskResult]:
    """Return the campaign over scenario files. Raises LeewayError on invalid input."""
    tasks = build_campaign_tasks([read_scenario(path) for path in paths], planners, params)
    return Experiment(
        "campaign", tasks, fly_campaign_task, TaskResult, note=lambda result: result.note
    )


def build_campaign_tasks(
    scenarios: Sequence[Scenario],
    planners: Sequence[str],
    params: CampaignParams,
    foreign: tuple[str, ...] = (),
) -> list[CampaignTask]:
    """Return the tasks; `foreign`: planners that the caller defines. LeewayError: invalid input."""
    versions = {
        name: load_plugin(PLUGIN_GROUP, name, PLANNERS).version
        for name in planners
        if name not in (*PLANNERS, *foreign)
    }
    chains = [s.name for s in scenarios if not isinstance(s.wind, LogWind)]
    if "clairvoyant" in planners and chains:
        raise LeewayError(
            f"planner clairvoyant: {chains[0]} has a chain wind, expected a recorded wind"
        )
    return [
        msgspec.structs.replace(task, planner_version=versions.get(task.planner, ""))
        for task in split_campaign_into_tasks(scenarios, list(dict.fromkeys(planners)), params)
    ]


def read_scenario(path: Path) -> Scenario:
    """Read a scenario file. Raises LeewayError in one line with file and key."""
    try:
        return parse_scenario(path.read_bytes(), str(path))
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from None


def summarize_campaign_rows(
    tasks: Sequence[CampaignTask], results: Sequence[TaskResult]
) -> Iterator[CampaignRow]:
    """Yield a row for each scenario and planner, in the order of the tasks."""
    rows: list[tuple[CampaignTask, list[TaskResult]]] = []
    for task, result in zip(tasks, results, strict=True):
        if task.first_block == 0:
            rows.append((task, []))
        rows[-1][1].append(result)
    for task, parts in rows:
        name = msgspec.json.decode(task.scenario, type=Scenario).name
        tallies = [t for part in parts for t in part.tallies]
        yield _build_row(
            name, task.planner, tallies, [us for part in parts for us in part.decision_us]
        )


def build_campaign_report(tasks: Sequence[CampaignTask], results: Sequence[TaskResult]) -> Report:
    """Return the rows as a table and as JSON."""
    rows = list(summarize_campaign_rows(tasks, results))
    columns: dict[str, Column] = {
        "scenario": "{0.scenario}",
        "planner": "{0.planner}",
        "missions": "{0.missions}",
        **{
            f"{name} %": lambda row, name=name: f"{100.0 * getattr(row, name) / row.missions:.2f}"
            for name in ("SUC", "DEL", "FAIL", "ABRT")
        },
        "loss %": lambda row: f"{100.0 * row.loss_frac:.3f}",
        "loss 95 %": lambda row: low_to_high(wilson95(row.DEL + row.FAIL, row.missions), ".3%"),
        "energy Wh": "{0.energy_wh_mean:.1f}",
        "margin Wh": lambda row: format_optional(row.margin_wh_mean, ".1f", "-"),
        "time s": "{0.time_s_mean:.0f}",
        "decision us": "{0.decision_us_median:.0f}",
    }
    document: dict[str, object] = {"rows": rows}
    if plugins := {task.planner: task.planner_version for task in tasks if task.planner_version}:
        document["plugins"] = plugins
    return Report({"campaign": Sheet.from_objects("Campaign", rows, columns)}, document)


def _build_row(
    scenario: str, planner: str, tallies: list[OutcomeSums], decision_us: list[float]
) -> CampaignRow:
    counts = [sum(t.outcomes[outcome] for t in tallies) for outcome in Outcome]
    missions, home = sum(counts), counts[Outcome.SUC] + counts[Outcome.ABRT]
    energy = _mean_and_std_from_sums([t.energy_wh for t in tallies], missions)
    margin = _mean_and_std_from_sums([t.margin_wh for t in tallies], home) if home else (None, None)
    time = _mean_and_std_from_sums([t.time_s for t in tallies], missions)
    decisions = sum(t.decisions for t in tallies)
    median, p99 = np.percentile(decision_us, [50, 99]).tolist() if decision_us else (0.0, 0.0)
    return CampaignRow(
        scenario, planner, missions, counts[0], counts[1], counts[2], counts[3],
        *energy, *margin, *time, decisions, median, p99,
    )  # fmt: skip


def _mean_and_std_from_sums(
    sums_and_squares: list[tuple[float, float]], count: int
) -> tuple[float, float]:
    total, square = sum(s[0] for s in sums_and_squares), sum(s[1] for s in sums_and_squares)
    mean = total / count
    return mean, float(np.sqrt(max(square / count - mean * mean, 0.0)))
