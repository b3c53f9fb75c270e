"""Functions of the Python interface that run experiments (docs/reference/api.md)."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import ItemLost, WorkerOptions, run_parallel
from sim_bridge.research.campaign.campaign import (
    CampaignRow,
    TaskResult,
    build_campaign_tasks,
    fly_campaign_task,
    read_scenario,
    summarize_campaign_rows,
)
from sim_bridge.research.campaign.workbench import CampaignParams
from sim_bridge.research.planners.planner_plugin import PlannerFactory
from sim_bridge.research.planners.scenario import Scenario, parse_scenario
from sim_bridge.research.study.run import ExperimentRun
from sim_bridge.research.windbench.contest import EstimatorScore, compute_scores


def campaign(
    scenarios: str | Path | Mapping[str, Any] | Sequence[str | Path | Mapping[str, Any]],
    planners: Mapping[str, str | PlannerFactory | None],
    *,
    missions: int = 2000,
    seed: int = 1,
    max_loss: float = 0.01,
    wind_classes: int | None = None,
    jobs: int = 1,
) -> list[CampaignRow]:
    """Fly missions on scenarios with several planners in the same winds.

    `scenarios`: `delivery-scenario/1` files, or their content. `planners` by the name of their
    rows: None for ours of that name (ser, rer, ger, ber-paper, ber, clairvoyant), the name of ours
    or of a plug-in, or a class constructed with a `PlanningTask`. With `jobs` above 1 a class is in
    a module. Raises LeewayError on invalid input, and on an edge that does not leave its vertex.
    """
    single = isinstance(scenarios, str | Path | Mapping)
    listed = [scenarios] if single else scenarios
    params = CampaignParams(
        missions=missions, seed=seed, max_loss=max_loss, wind_classes=wind_classes
    )
    factories = {name: one for name, one in planners.items() if callable(one)}
    named = {name: str(one or name) for name, one in planners.items() if name not in factories}
    if shared := factories.keys() & named.values():
        raise LeewayError(f"planner {min(shared)!r}: both a class and a name; rename the class")
    keys = {name: named.get(name, name) for name in planners}
    scenario_list = [_scenario(one) for one in listed]
    tasks = build_campaign_tasks(
        scenario_list, list(keys.values()), params, foreign=tuple(factories)
    )
    fly = partial(fly_campaign_task, factories=factories)
    results: dict[int, TaskResult] = {}
    for done in run_parallel(tasks, fly, WorkerOptions(jobs)):
        if isinstance(done, ItemLost):
            raise LeewayError(f"campaign: {done.reason}")
        results[done.index] = done.result
    rows = summarize_campaign_rows(tasks, [results[k] for k in range(len(tasks))])
    flown = [{row.planner: row for row in islice(rows, len(set(keys.values())))} for _ in listed]
    rename = msgspec.structs.replace
    return [rename(found[key], planner=name) for found in flown for name, key in keys.items()]


def _scenario(source: str | Path | Mapping[str, Any]) -> Scenario:
    if isinstance(source, Mapping):
        return parse_scenario(msgspec.json.encode(source), str(source.get("name", "scenario")))
    return read_scenario(Path(source))


def score_wind(
    folders: str | Path | Sequence[str | Path],
    estimators: Sequence[str] = (),
    *,
    airframe: str = "m100",
    symmetric: bool = False,
    jobs: int = 1,
) -> list[EstimatorScore]:
    """Score wind estimators on folders of real flights (docs/how-to/wind-benchmark.md).

    `estimators`: plug-ins in addition to ours. Raises LeewayError if a folder cannot be used.
    """
    listed = [folders] if isinstance(folders, str | Path) else folders
    with TemporaryDirectory() as out:
        run = ExperimentRun(Path(out), WorkerOptions(jobs))
        requested = [(Path(folder), airframe) for folder in listed]
        return compute_scores(requested, tuple(estimators), run, symmetric=symmetric).standings
