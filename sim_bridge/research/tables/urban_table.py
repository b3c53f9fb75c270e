"""Outcomes over generated towns whose wind differs from edge to edge; our BER and the paper's."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_bridge.research.campaign.campaign import CampaignParams, Workbench
from sim_bridge.research.planners.mission_model import ChainWinds, fly_missions
from sim_bridge.research.planners.tuning import TuningParams
from sim_bridge.research.results.sheet import Sheet, interval95_text, mean_std
from sim_bridge.research.tables.table1 import PAPER
from sim_bridge.research.tables.urban_scene import Town, TownParams, generate_town

PLANNERS = ("ser", "rer", "ger", "ber-paper", "ber")
TOWN_SEED = 3
TUNING_MISSIONS = 5_000


@dataclass(frozen=True)
class TownJob:
    """One generated town and what is asked there."""

    number: int
    budget_wh: float
    max_loss: float
    missions: int = 60


def fly_town(job: TownJob) -> dict[str, list[float]]:
    """SUC, DEL, FAIL, ABRT in percent by planner."""
    town = generate_town(
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
    bench = Workbench(town.scenario, params, town.graph)
    winds = bench.winds(0)
    assert isinstance(winds, ChainWinds)
    shares = {}
    for name in PLANNERS:
        winds.restart()
        decider = bench.planner(name, winds).begin(bench.coins(0, winds.count))
        flown = fly_missions(bench.graph, job.budget_wh, winds, decider)
        shares[name] = (100.0 * np.bincount(flown.outcome, minlength=4) / job.missions).tolist()
    return shares


def by_planner(found: list[dict[str, list[float]]], rounds: int) -> dict[str, np.ndarray]:
    """Percentages by planner; arrays (rounds, towns, 4)."""
    return {
        name: np.array([town[name] for town in found]).reshape(rounds, -1, 4) for name in PLANNERS
    }


def sheet(found: dict[str, np.ndarray], budget_wh: float, max_loss: float) -> Sheet:
    """One line for each planner."""
    rows = []
    for name, shares in found.items():
        paper = PAPER.get((8, budget_wh), {}).get(name)
        rows.append(
            [
                name,
                *(mean_std(shares.mean(axis=1)[:, i]) for i in range(4)),
                f"{shares[..., 1:3].sum(axis=-1).mean():.2f}",
                interval95_text(shares[..., 0].ravel()),
                " / ".join(f"{x:.1f}" for x in paper) if paper else "-",
            ]
        )
    head = ["planner", "SUC %", "DEL %", "FAIL %", "ABRT %", "loss %", "SUC 95 %"]
    note = (
        f"Generated towns, 8 wind classes, B = {budget_wh:g} Wh, BER's bound {100 * max_loss:g} % "
        "in every town. The wind on an edge is the free wind times its factor (wakes, corners, "
        "roofs). The paper's row is its Table 1, whose towns are not given."
    )
    return Sheet("Towns", [*head, "paper (8 classes)"], rows, note)


def draw_town(town: Town, path: Path) -> None:
    """The town from above, its graph, and the factor on a wind that blows to the east."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.patches import Rectangle

    figure, axis = plt.subplots(figsize=(8, 7))
    for b in town.buildings:
        corner = (b.east_m - b.half_east_m, b.north_m - b.half_north_m)
        axis.add_patch(
            Rectangle(corner, 2 * b.half_east_m, 2 * b.half_north_m, color=str(1 - b.height_m / 90))
        )
    graph, factor = town.graph, town.graph.wind_factor
    assert factor is not None
    shade = ScalarMappable(Normalize(0.4, 1.4), "coolwarm")
    for e in range(graph.edge_count):
        ends = graph.vertices_m[[graph.tail[e], graph.head[e]], :2]
        axis.plot(*ends.T, color=shade.to_rgba(factor[e, 0]), lw=2)
    for vertex, label in ((graph.depot, "depot"), (graph.target, "customer")):
        place = (float(graph.vertices_m[vertex, 0]), float(graph.vertices_m[vertex, 1]))
        axis.plot(*place, "ko")
        axis.annotate(label, place, xytext=(5, 5), textcoords="offset points", weight="bold")
    axis.set_aspect("equal")
    figure.colorbar(shade, ax=axis, label="wind on the edge / free wind, blowing to the east")
    axis.set_xlabel("east, m")
    axis.set_ylabel("north, m")
    axis.set_title("A generated town: buildings (darker is higher), the graph flown over it")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)
