"""Outcomes against the risk weight lambda and the battery left, as in the paper's figure."""

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from sim_bridge.research.campaign.campaign import CampaignParams, Workbench
from sim_bridge.research.campaign.scenario_generator import GeneratorParams, scenario_set
from sim_bridge.research.planners.mission_model import ChainWinds, Outcome, fly_missions
from sim_bridge.research.planners.scenario import Scenario
from sim_bridge.research.results.sheet import Sheet, interval95_text

LAMBDAS = (1.0, 1.5, 2.0, 2.5)
BUDGETS_WH = (25.0, 37.5, 50.0, 75.0, 100.0)
PLANNERS = ("ser", "rer", "ber-paper")
SWEEP_SEED = 2


@dataclass(frozen=True)
class SweepPoint:
    """Shares of one planner at one lambda and budget on every graph; percent, arrays (graphs,)."""

    planner: str
    risk_weight: float
    budget_wh: float
    success: np.ndarray
    abort: np.ndarray
    loss: np.ndarray


@dataclass(frozen=True)
class SweepJob:
    """One graph under every planner, lambda and battery."""

    scenario: Scenario
    missions: int = 60
    classes: int = 8


class SweepCell(msgspec.Struct, frozen=True):
    """SUC, DEL, FAIL, ABRT in percent of one planner at one lambda and battery on one graph."""

    planner: str
    risk_weight: float
    budget_wh: float
    shares: list[float]


def jobs_of(graphs: int) -> list[SweepJob]:
    """The graphs of the sweep."""
    params = GeneratorParams(budget_wh=max(BUDGETS_WH))
    return [SweepJob(scenario) for scenario in scenario_set(graphs, params, SWEEP_SEED)]


def fly(job: SweepJob) -> list[SweepCell]:
    """Every planner, lambda and battery on the same winds."""
    parts = []
    for risk_weight in LAMBDAS:
        params = CampaignParams(
            missions=job.missions, wind_classes=job.classes, risk_weight=risk_weight
        )
        bench = Workbench(job.scenario, params)
        winds = bench.winds(0)
        assert isinstance(winds, ChainWinds)
        for planner in PLANNERS:
            for budget in BUDGETS_WH:
                winds.restart()
                decider = bench.with_budget(budget).build(planner).begin(np.zeros(job.missions))
                flown = fly_missions(bench.graph, budget, winds, decider)
                shares = 100.0 * np.bincount(flown.outcome, minlength=4) / job.missions
                parts.append(SweepCell(planner, risk_weight, budget, shares.tolist()))
    return parts


def points_of(found: list[list[SweepCell]]) -> list[SweepPoint]:
    """The shares of all graphs, planner by planner."""
    grouped: dict[tuple[str, float, float], list[list[float]]] = {}
    for part in (part for parts in found for part in parts):
        key = (part.planner, part.risk_weight, part.budget_wh)
        grouped.setdefault(key, []).append(part.shares)
    return [
        SweepPoint(
            planner,
            risk_weight,
            budget,
            success=np.array(shares)[:, Outcome.SUC],
            abort=np.array(shares)[:, Outcome.ABRT],
            loss=np.array(shares)[:, [Outcome.DEL, Outcome.FAIL]].sum(axis=1),
        )
        for (planner, risk_weight, budget), shares in grouped.items()
    ]


def sheet(points: list[SweepPoint]) -> Sheet:
    """One line for each planner, lambda and budget."""
    rows = [
        [
            p.planner,
            f"{p.risk_weight:g}",
            f"{p.budget_wh:g}",
            f"{p.success.mean():.1f}",
            interval95_text(p.success),
            f"{p.abort.mean():.1f}",
            f"{p.loss.mean():.1f}",
        ]
        for p in points
    ]
    head = ["planner", "lambda", "battery Wh", "SUC %", "SUC 95 %", "ABRT %", "loss %"]
    note = "The paper shows SUC, ABRT and FAIL against remaining battery without a table of them."
    return Sheet("Sensitivity to lambda", head, rows, note)


def draw(points: list[SweepPoint], path: Path) -> None:
    """SUC, ABRT and loss against the battery, one line for each lambda, the published BER."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(13, 4), sharex=True)
    for axis, what in zip(axes, ("success", "abort", "loss"), strict=True):
        for risk_weight in LAMBDAS:
            mine = [p for p in points if p.planner == "ber-paper" and p.risk_weight == risk_weight]
            axis.plot(
                [p.budget_wh for p in mine],
                [float(getattr(p, what).mean()) for p in mine],
                marker="o",
                label=f"lambda = {risk_weight:g}",
            )
        axis.set_title(f"{what}, %")
        axis.set_xlabel("battery, Wh")
    axes[0].legend()
    figure.suptitle("BER as published: outcomes against battery, for the weight lambda of risk")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)
