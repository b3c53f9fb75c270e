"""Outcomes against the risk weight lambda and the battery left, as in the paper's figure."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.mission_model import ChainWinds, Outcome, fly_missions
from sim_bridge.experiments.campaign import CampaignParams, Workbench
from sim_bridge.experiments.report import Sheet, interval95_text
from sim_bridge.experiments.scenario_generator import GeneratorParams, scenario_set

LAMBDAS = (1.0, 1.5, 2.0, 2.5)
BUDGETS_WH = (25.0, 37.5, 50.0, 75.0, 100.0)
PLANNERS = ("ser", "rer", "ber-paper")
SWEEP_SEED = 2


@dataclass(frozen=True)
class Point:
    """Shares of one planner at one lambda and budget on every graph; percent, arrays (graphs,)."""

    planner: str
    risk_weight: float
    budget_wh: float
    success: np.ndarray
    abort: np.ndarray
    loss: np.ndarray


def sweep(graphs: int = 100, missions: int = 60, classes: int = 8) -> list[Point]:
    """Every planner, lambda and budget on the same graphs and winds."""
    points: dict[tuple[str, float, float], list[np.ndarray]] = {}
    for scenario in scenario_set(graphs, GeneratorParams(budget_wh=max(BUDGETS_WH)), SWEEP_SEED):
        for risk_weight in LAMBDAS:
            params = CampaignParams(
                missions=missions, wind_classes=classes, risk_weight=risk_weight
            )
            bench = Workbench(scenario, params)
            winds = bench.winds(0)
            assert isinstance(winds, ChainWinds)
            for planner in PLANNERS:
                for budget in BUDGETS_WH:
                    winds.restart()
                    decider = bench.with_budget(budget).build(planner).begin(np.zeros(missions))
                    flown = fly_missions(bench.graph, budget, winds, decider)
                    shares = 100.0 * np.bincount(flown.outcome, minlength=4) / missions
                    points.setdefault((planner, risk_weight, budget), []).append(shares)
    return [
        Point(
            planner,
            risk_weight,
            budget,
            success=np.array(shares)[:, Outcome.SUC],
            abort=np.array(shares)[:, Outcome.ABRT],
            loss=np.array(shares)[:, [Outcome.DEL, Outcome.FAIL]].sum(axis=1),
        )
        for (planner, risk_weight, budget), shares in points.items()
    ]


def sheet(points: list[Point]) -> Sheet:
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


def draw(points: list[Point], path: Path) -> None:
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
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
