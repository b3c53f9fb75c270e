"""Outcomes against the risk weight lambda and the remaining battery, as in the paper's figure."""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from companion.core.base.arrays import Floats
from sim_bridge.research.campaign.scenario_generator import GeneratorParams, draw_scenario_set
from sim_bridge.research.campaign.workbench import (
    CampaignParams,
    Workbench,
    outcome_percentages_by_cell,
)
from sim_bridge.research.planners.mission_model import Outcome
from sim_bridge.research.planners.scenario import Scenario
from sim_bridge.research.study.run import Report
from sim_bridge.research.study.sheet import Column, Sheet
from sim_bridge.research.tables.table1 import share_interval

LAMBDAS = (1.0, 1.5, 2.0, 2.5)
BUDGETS_WH = (25.0, 37.5, 50.0, 75.0, 100.0)
PLANNERS = ("ser", "rer", "ber-paper")
SWEEP_SEED = 2
MISSIONS = 60


Cell = tuple[str, float, float]
"""Planner, lambda, budget."""

COLUMNS = {"success": [Outcome.SUC], "abort": [Outcome.ABRT], "loss": [Outcome.DEL, Outcome.FAIL]}


@dataclass(frozen=True)
class SweepJob:
    """One graph, flown with every planner, lambda and battery."""

    scenario: Scenario
    missions: int = MISSIONS
    classes: int = 8


def build_jobs(graph_count: int) -> list[SweepJob]:
    """Return one job per graph of the sweep."""
    params = GeneratorParams(budget_wh=max(BUDGETS_WH))
    return [SweepJob(scenario) for scenario in draw_scenario_set(graph_count, params, SWEEP_SEED)]


def fly_all_planners_on_graph(job: SweepJob) -> list[tuple[Cell, list[float]]]:
    """Fly every planner, lambda and battery on the same winds."""
    parts = []
    for risk_weight in LAMBDAS:
        params = CampaignParams(
            missions=job.missions, wind_classes=job.classes, risk_weight=risk_weight
        )
        for budget in BUDGETS_WH:
            bench = Workbench(msgspec.structs.replace(job.scenario, budget_wh=budget), params)
            for planner in PLANNERS:
                shares = bench.outcome_percentages(bench.build_planner(planner))
                parts.append(((planner, risk_weight, budget), shares))
    return sorted(parts, key=lambda part: (part[0][1], PLANNERS.index(part[0][0])))


def build_lambda_sweep_report(found: list[list[tuple[Cell, list[float]]]]) -> Report:
    """Return table and figure of all graphs."""
    cells = {
        key: {name: shares[:, of].sum(axis=1) for name, of in COLUMNS.items()}
        for key, shares in outcome_percentages_by_cell(found).items()
    }
    columns: dict[str, Column] = {
        "planner": "{0[0]}",
        "lambda": "{0[1]:g}",
        "battery Wh": "{0[2]:g}",
        "SUC %": lambda cell: f"{cells[cell]['success'].mean():.1f}",
        "SUC 95 %": lambda cell: share_interval(cells[cell]["success"], MISSIONS),
        "ABRT %": lambda cell: f"{cells[cell]['abort'].mean():.1f}",
        "loss %": lambda cell: f"{cells[cell]['loss'].mean():.1f}",
    }
    note = (
        "The paper shows SUC, ABRT and FAIL against remaining battery in a figure, without a table."
    )
    return Report(
        {"lambda_sweep": Sheet.from_objects("Sensitivity to lambda", cells, columns, note)},
        pictures={"lambda_sweep.png": lambda path: draw_outcomes(cells, path)},
    )


def draw_outcomes(cells: dict[Cell, dict[str, Floats]], path: Path) -> None:
    """Draw SUC, ABRT and loss of the published BER against the battery, one line per lambda."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4))
    axes = figure.subplots(1, 3, sharex=True)
    for axis, outcome in zip(axes, COLUMNS, strict=True):
        for risk_weight in LAMBDAS:
            shares = [cells["ber-paper", risk_weight, b][outcome].mean() for b in BUDGETS_WH]
            axis.plot(BUDGETS_WH, shares, marker="o", label=f"lambda = {risk_weight:g}")
        axis.set_title(f"{outcome}, %")
        axis.set_xlabel("battery, Wh")
    axes[0].legend()
    figure.suptitle("BER as published: outcomes against battery, for the weight lambda of risk")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
