"""Table 1: outcomes of SER, RER, GER and BER on Erdos-Renyi graphs, 4 and 8 wind classes.

Ten rounds of ten graphs with two customers each, 60 missions per customer, B = 100 and 50 Wh; on
chains, and on a recording with the clairvoyant. The same code prints the gusty set, which is ours.
"""

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.adapters.files.params import read_wind_process
from companion.core.base.errors import LeewayError
from companion.core.routing.planner_interface import MissionPlanner
from sim_bridge.research.campaign.campaign import CampaignParams, Workbench
from sim_bridge.research.campaign.scenario_generator import GUSTY, GeneratorParams, scenario_set
from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.ber_log import BerLog, LogPolicy, solve_log_policy
from sim_bridge.research.planners.bounded_loss_policy import PolicySearch
from sim_bridge.research.planners.edge_transitions import build_step_model
from sim_bridge.research.planners.markov_chain import prior_wind
from sim_bridge.research.planners.mission_model import ChainWinds, Winds, fly_missions
from sim_bridge.research.planners.scenario import LogWind, Scenario
from sim_bridge.research.planners.tuning import PolicyTuner, TuningParams
from sim_bridge.research.results.sheet import Sheet, interval95_text, mean_std
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.wind_log import load_wind_log

Shares = NDArray[np.float64]  # SUC, DEL, FAIL, ABRT in percent

BUDGETS_WH = (100.0, 50.0)
CLASSES = (4, 8)
BASELINES = ("ser", "rer", "ger", "ber-paper")
TABLE_SEED = 13  # not looked at when the settings were chosen; seeds 1 and 12 were

# arXiv 2604.13441, Table 1: (classes, B) -> planner -> SUC, DEL, FAIL, ABRT.
PAPER: dict[tuple[int, float], dict[str, tuple[float, float, float, float]]] = {
    (4, 100.0): {
        "ser": (89.6, 1.1, 0.0, 9.3),
        "rer": (90.3, 9.7, 0.0, 0.0),
        "ger": (8.1, 24.2, 67.7, 0.0),
        "ber": (93.8, 2.4, 0.0, 3.8),
    },
    (4, 50.0): {
        "ser": (55.2, 0.0, 0.0, 44.8),
        "rer": (56.4, 38.2, 5.4, 0.0),
        "ger": (3.6, 20.3, 76.1, 0.0),
        "ber": (61.5, 4.2, 0.0, 34.3),
    },
    (8, 100.0): {
        "ser": (90.8, 0.9, 0.0, 8.3),
        "rer": (91.7, 8.3, 0.0, 0.0),
        "ger": (7.4, 23.1, 69.5, 0.0),
        "ber": (95.6, 1.8, 0.0, 2.6),
    },
    (8, 50.0): {
        "ser": (57.6, 0.0, 0.0, 42.4),
        "rer": (57.9, 40.0, 2.1, 0.0),
        "ger": (3.4, 21.0, 75.6, 0.0),
        "ber": (66.2, 3.6, 0.0, 30.2),
    },
}


@dataclass(frozen=True)
class Table1Params:
    """How much is flown. `max_losses` are BER's bounds; "paper" is the loss the paper reports.

    The paper's loss is that over all its graphs; a bound holds for every customer by itself, and
    many cannot use it up. `paper_share` times the paper's loss is what a customer may lose, so
    that the whole set comes near it.
    """

    rounds: int = 10
    graphs: int = 10
    targets: int = 2
    missions: int = 60
    seed: int = TABLE_SEED
    levels: int = 140
    risk_weight: float = 1.0
    max_losses: tuple[float | str, ...] = (0.015, 0.005, "paper")
    paper_share: float = 1.0
    generator: GeneratorParams = GeneratorParams()  # noqa: RUF009 - frozen
    tuning: TuningParams = TuningParams(fewest_missions=5_000, most_missions=5_000)  # noqa: RUF009


GUSTY_PARAMS = Table1Params(
    generator=GeneratorParams(rose=GUSTY, sides_m=((290.0, 0.4), (400.0, 0.6))),
    max_losses=("paper", 0.01),
    paper_share=1.35,  # on fitting seeds: 4 % over all where the paper loses 4.2 %
)

Cell = tuple[int, float, str]  # classes, budget, planner


def bound_of(bound: float | str, classes: int, budget_wh: float, paper_share: float = 1.0) -> float:
    """A customer's bound as a share; "paper": by DEL + FAIL of the paper's BER in that row."""
    if isinstance(bound, str):
        _, delivered, failed, _ = PAPER[classes, budget_wh]["ber"]
        return paper_share * (delivered + failed) / 100.0
    return bound


def label_of(bound: float | str) -> str:
    return "ber at the paper's loss" if bound == "paper" else f"ber at {100 * float(bound):g} %"


def fly_scenario(scenario: Scenario, params: Table1Params) -> dict[Cell, Shares]:
    """Every cell of the table on one scenario with a chain."""
    cells: dict[Cell, Shares] = {}
    for budget in BUDGETS_WH:
        budgeted = msgspec.structs.replace(scenario, budget_wh=budget)
        search: PolicySearch | None = None
        for classes in CLASSES:
            asked = CampaignParams(
                missions=params.missions,
                seed=params.seed,
                wind_classes=classes,
                risk_weight=params.risk_weight,
                levels=params.levels,
            )
            bench = Workbench(budgeted, asked)
            winds = bench.winds(0)
            coins = bench.coins(0, winds.count)
            for name in BASELINES:
                planner = bench.build(name)
                cells[classes, budget, name] = _shares(bench, winds, planner, coins)
            assert bench.chain is not None
            assert bench.sight is not None
            if search is None:
                search = bench.search(bench.chain, bench.sight)
                share = params.paper_share
                search.cover(
                    [bound_of(b, k, budget, share) for b in params.max_losses for k in CLASSES]
                )
            tuner = PolicyTuner(search, bench.sight, params.tuning)
            for bound in params.max_losses:
                max_loss = bound_of(bound, classes, budget, params.paper_share)
                planner = Ber(tuner.policy(max_loss), bench.sight, bench.graph)
                cells[classes, budget, label_of(bound)] = _shares(bench, winds, planner, coins)
                limit = search.policy(max_loss).forecast
                cells[classes, budget, label_of(bound).replace("ber", "frontier")] = (
                    100.0
                    * np.array([limit.success, limit.loss, 0.0, 1.0 - limit.success - limit.loss])
                )
    return cells


def fly_recorded(scenario: Scenario, wind: LogWind, params: Table1Params) -> dict[Cell, Shares]:
    """Every cell on one graph under a recording; BER's tables serve both budgets."""
    cells: dict[Cell, Shares] = {}
    process = prior_wind(read_wind_process("coast"), spacing_mps=2.5, reach_mps=10.0)
    policy: LogPolicy | None = None
    for budget in BUDGETS_WH:
        budgeted = msgspec.structs.replace(scenario, budget_wh=budget, wind=wind)
        for classes in CLASSES:
            asked = CampaignParams(
                missions=params.missions,
                seed=params.seed,
                wind_classes=classes,
                risk_weight=params.risk_weight,
            )
            bench = Workbench(budgeted, asked)
            winds = bench.winds(0)
            coins = bench.coins(0, winds.count)
            for name in (*BASELINES, "clairvoyant"):
                planner = bench.planner(name, winds)
                cells[classes, budget, name] = _shares(bench, winds, planner, coins)
            if policy is None:
                model = build_step_model(bench.graph, process.chain(), max(BUDGETS_WH), 150)
                policy = solve_log_policy(model)
            for bound in params.max_losses:
                max_loss = bound_of(bound, classes, budget, params.paper_share)
                planner = BerLog(policy, process, max_loss, classes)
                cells[classes, budget, label_of(bound)] = _shares(bench, winds, planner, coins)
    return cells


def _shares(
    bench: Workbench, winds: Winds, planner: MissionPlanner, coins: NDArray[np.float64]
) -> Shares:
    if isinstance(winds, ChainWinds):
        winds.restart()
    flown = fly_missions(bench.graph, bench.scenario.budget_wh, winds, planner.begin(coins))
    return 100.0 * np.bincount(flown.outcome, minlength=4) / winds.count


@dataclass(frozen=True)
class Job:
    """One scenario's part of the table."""

    scenario: Scenario
    params: Table1Params
    wind: LogWind | None


class Table1Cell(msgspec.Struct, frozen=True):
    """One cell of the table on one scenario: SUC, DEL, FAIL, ABRT in percent."""

    classes: int
    budget_wh: float
    planner: str
    shares: list[float]


def jobs_of(params: Table1Params, wind: LogWind | None = None) -> list[Job]:
    """The table's scenarios, round by round."""
    scenarios = scenario_set(
        params.rounds * params.graphs, params.generator, params.seed, params.targets
    )
    return [Job(scenario, params, wind) for scenario in scenarios]


def fly(job: Job) -> list[Table1Cell]:
    """Every cell of the table on one scenario."""
    if job.wind is None:
        cells = fly_scenario(job.scenario, job.params)
    else:
        cells = fly_recorded(job.scenario, job.wind, job.params)
    return [
        Table1Cell(classes, budget, planner, shares.tolist())
        for (classes, budget, planner), shares in cells.items()
    ]


def cells_of(found: list[list[Table1Cell]], params: Table1Params) -> dict[Cell, Shares]:
    """Percentages of every scenario in every cell; arrays (rounds, graphs x targets, 4)."""
    cells: dict[Cell, list[list[float]]] = {}
    for parts in found:
        for part in parts:
            cells.setdefault((part.classes, part.budget_wh, part.planner), []).append(part.shares)
    return {cell: np.array(shares).reshape(params.rounds, -1, 4) for cell, shares in cells.items()}


def sheet(title: str, cells: dict[Cell, Shares], note: str, params: Table1Params) -> Sheet:
    """The table: ours as mean ± std over rounds with 95 % intervals over graphs, the paper's."""
    head = ["classes", "B", "planner", "SUC %", "DEL %", "FAIL %", "ABRT %", "loss %"]
    head += ["SUC 95 %", "paper SUC / DEL / FAIL / ABRT"]
    rows = []
    for (classes, budget, planner), shares in cells.items():
        rounds = shares.mean(axis=1)
        graphs = shares.reshape(params.rounds * params.graphs, -1, 4).mean(axis=1)
        paper = PAPER[classes, budget].get("ber" if "paper's" in planner else planner)
        rows.append(
            [
                str(classes),
                f"{budget:g}",
                planner,
                *(mean_std(rounds[:, i]) for i in range(4)),
                f"{rounds[:, 1:3].sum(axis=1).mean():.2f}",
                interval95_text(graphs[:, 0]),
                " / ".join(f"{x:.1f}" for x in paper) if paper else "-",
            ]
        )
    return Sheet(title, head, rows, note)


NOTE = (
    "Ours: mean ± std over rounds of {graphs} graphs; 95 % intervals over all graphs. The bound is "
    "kept on every scenario by itself, so that the loss over all is smaller; \"at the paper's "
    'loss" allows each {share:g} times that loss. `frontier` is what '
    "the tables forecast with the wind's state in full sight, at the loss allowed: an upper bound "
    "where classes hide it. The paper states neither graph size, wind process nor airframe; ours "
    "were chosen so that SER and RER come close to its rows, and BER is then what it is."
)


def draw(cells: dict[Cell, Shares], title: str, path: Path) -> None:
    """SUC and loss of every planner in the four rows, the paper's as crosses."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 4, figsize=(16, 4.5), sharey=True)
    names = list(dict.fromkeys(planner for _, _, planner in cells))
    for axis, (classes, budget) in zip(axes, PAPER, strict=True):
        for i, name in enumerate(names):
            if (classes, budget, name) not in cells:
                continue
            mean = cells[classes, budget, name].reshape(-1, 4).mean(axis=0)
            axis.bar(i, mean[0], color="tab:green")
            axis.bar(i, mean[1] + mean[2], bottom=mean[0], color="tab:red")
            axis.bar(i, mean[3], bottom=mean[:3].sum(), color="lightgrey")
            paper = PAPER[classes, budget].get("ber" if "ber at the" in name else name)
            if paper:
                axis.plot(i, paper[0], "kx")
        axis.set_title(f"{classes} classes, B = {budget:g} Wh")
        axis.set_xticks(range(len(names)), names, rotation=75, fontsize=8)
    axes[0].set_ylabel("share of missions, %")
    figure.suptitle(f"{title}: success (green, paper's x), loss (red), safe abort (grey)")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def recorded_wind(path: Path, longest_mission_s: float) -> LogWind:
    """A CSV of `t_s, wind_speed_mps, wind_from_deg` as a scenario's wind (to east, to north).

    Missions start early enough to end within the recording.
    """
    try:
        log = load_wind_log(path)
    except TruthError as error:
        raise LeewayError(str(error)) from error
    first, last = log.t_s[0], log.t_s[-1]
    return LogWind(
        t_s=list(log.t_s),
        wind_en_mps=list(zip(log.to_east_mps, log.to_north_mps, strict=True)),
        start_s=(first, max(first, last - longest_mission_s)),
    )
