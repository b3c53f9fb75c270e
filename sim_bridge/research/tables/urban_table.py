"""Outcomes in generated towns with different wind per edge; this project's BER and the paper's."""

from dataclasses import dataclass

import numpy as np

from sim_bridge.research.campaign.workbench import (
    CampaignParams,
    Workbench,
    outcome_percentages_by_cell,
)
from sim_bridge.research.planners.tuning import TuningParams
from sim_bridge.research.study.run import Report
from sim_bridge.research.study.sheet import Column, Sheet
from sim_bridge.research.tables.table1 import PAPER, outcome_columns, paper_row
from sim_bridge.research.tables.urban_scene import TownParams, draw_connected_town

PLANNERS = ("ser", "rer", "ger", "ber-paper", "ber")
TOWN_SEED = 3
TUNING_MISSIONS = 5_000


@dataclass(frozen=True)
class TownJob:
    """One generated town with its budget, bound and number of missions."""

    number: int
    budget_wh: float
    max_loss: float
    missions: int = 60


def fly_town_with_each_planner(job: TownJob) -> list[tuple[str, list[float]]]:
    """Return outcome shares by planner."""
    scenario, graph = draw_connected_town(
        f"town-{job.number}",
        TownParams(budget_wh=job.budget_wh),
        np.random.default_rng([TOWN_SEED, job.number]),
    )
    params = CampaignParams(
        missions=job.missions,
        seed=TOWN_SEED,
        wind_classes=8,
        levels=140,
        max_loss=job.max_loss,
        tuning=TuningParams(fewest_missions=TUNING_MISSIONS, most_missions=TUNING_MISSIONS),
    )
    bench = Workbench(scenario, params, graph)
    return [(name, bench.outcome_percentages(bench.build_planner(name))) for name in PLANNERS]


def build_towns_report(
    towns: list[list[tuple[str, list[float]]]], rounds: int, first: TownJob
) -> Report:
    """Return the table of all towns: one line for each planner."""
    budget_wh, max_loss = first.budget_wh, first.max_loss
    cells = outcome_percentages_by_cell(towns)
    found = {name: shares.reshape(rounds, -1, 4) for name, shares in cells.items()}
    note = (
        f"Generated towns, 8 wind classes, B = {budget_wh:g} Wh, BER's bound {100 * max_loss:g} % "
        "in every town. The wind on an edge is the free wind times its factor (wakes, corners, "
        "roofs). The paper's row is its Table 1, of unpublished towns."
    )
    columns: dict[str, Column] = {
        "planner": "{0}",
        **outcome_columns(lambda name: found[name], first.missions),
        "paper (8 classes)": lambda name: paper_row(PAPER.get((8, budget_wh), {}).get(name)),
    }
    return Report({"towns": Sheet.from_objects("Towns", found, columns, note)})
