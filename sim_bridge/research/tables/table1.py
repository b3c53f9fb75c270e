"""Table 1: outcomes of SER, RER, GER and BER on Erdos-Renyi graphs, 4 and 8 wind classes.

Ten rounds of ten graphs with two customers each, 60 missions per customer, B = 100 and 50 Wh; on
chains, and on a recording with the clairvoyant. The same code prints this project's gusty set.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.adapters.files.params import read_wind_process
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from sim_bridge.research.campaign.scenario_generator import (
    GUSTY,
    GeneratorParams,
    draw_scenario_set,
)
from sim_bridge.research.campaign.workbench import (
    CampaignParams,
    Workbench,
    outcome_percentages_by_cell,
)
from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.ber_log import BerLog, LogPolicy, solve_log_policy
from sim_bridge.research.planners.ber_paper import BerPaper, BerPaperParams
from sim_bridge.research.planners.bounded_loss_policy import PolicySearch
from sim_bridge.research.planners.edge_transitions import build_edge_transition_model
from sim_bridge.research.planners.markov_chain import build_prior_wind
from sim_bridge.research.planners.scenario import LogWind, Scenario
from sim_bridge.research.planners.tuning import PolicyTuner, TuningParams
from sim_bridge.research.study.intervals import bootstrap_share_interval95
from sim_bridge.research.study.run import Report
from sim_bridge.research.study.sheet import (
    Column,
    Figures,
    Sheet,
    low_to_high,
    mean_and_std,
    separated,
)
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.wind_log import load_wind_log

Shares = NDArray[np.float64]  # SUC, DEL, FAIL, ABRT in percent

BUDGETS_WH = (100.0, 50.0)
CLASSES = (4, 8)
BASELINES = ("ser", "rer", "ger", "ber-paper")
LONGEST_MISSION_S = 300.0  # missions start at least this long before a recording ends
READINGS = {
    f"kappa {kappa:g}, lambda {risk_weight:g}, {checks}": (
        BerPaperParams(kappa, has_threshold=checks == "both checks"),
        risk_weight,
    )
    for checks in ("both checks", "ReturnOK only")
    for kappa in (1.0, 1.05, 1.15, 1.3)
    for risk_weight in (0.0, 0.5, 1.0)
}
"""Readings of the published BER within the paper's text (IV-B): kappa, lambda, and the checks."""

TABLE_SEED = 13  # not used in choosing the settings; seeds 1 and 12 were

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
    """Size of the table. `max_losses` are BER's bounds; "paper" is the loss that the paper reports.

    The paper's loss is over all its graphs. A bound here applies to each customer, and many
    customers cannot use it up. So each customer's bound is `paper_share` times the paper's loss,
    which brings the whole set near it.
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
    readings: bool = False
    """Fly `READINGS` with 8 wind classes in place of the planners."""
    generator: GeneratorParams = GeneratorParams()  # noqa: RUF009 - frozen
    tuning: TuningParams = TuningParams(fewest_missions=5_000, most_missions=5_000)  # noqa: RUF009


GUSTY_PARAMS = Table1Params(
    generator=GeneratorParams(wind_model=GUSTY, square_sizes_m=((290.0, 0.4), (400.0, 0.6))),
    max_losses=("paper", 0.01),
    paper_share=1.35,  # on fitting seeds: 4 % over all against the paper's loss of 4.2 %
)

Cell = tuple[int, float, str]  # classes, budget, planner
CellShares = tuple[Cell, list[float]]


def bound_to_max_loss(
    bound: float | str, classes: int, budget_wh: float, paper_share: float = 1.0
) -> float:
    """Return a customer's bound as a share; "paper": DEL + FAIL of the paper's BER in that row."""
    if isinstance(bound, str):
        _, delivered, failed, _ = PAPER[classes, budget_wh]["ber"]
        return paper_share * (delivered + failed) / 100.0
    return bound


def format_bound_label(bound: float | str) -> str:
    return "ber at the paper's loss" if bound == "paper" else f"ber at {100 * float(bound):g} %"


@dataclass(frozen=True)
class Table1Job:
    """One scenario's part of the table; `wind`: a recording that replaces its chain."""

    scenario: Scenario
    params: Table1Params
    wind: LogWind | None


def fly_all_cells_on_scenario(job: Table1Job) -> list[CellShares]:
    """Fly every cell of the table on one scenario."""
    if job.params.readings:
        return list(_fly_readings(job))
    return list(
        _fly_cells_in_chain_wind(job) if job.wind is None else _fly_cells_in_recorded_wind(job)
    )


def _fly_readings(job: Table1Job) -> Iterator[CellShares]:
    """Fly the readings of the published BER on one scenario."""
    for label, (reading, risk_weight) in READINGS.items():
        varied = replace(job, params=replace(job.params, risk_weight=risk_weight))
        for budget, classes, bench in _build_workbenches(varied):
            if classes == max(CLASSES):
                planner = BerPaper(bench.build_replanning_model(True), reading)
                yield (classes, budget, label), bench.outcome_percentages(planner)


def _build_workbenches(job: Table1Job) -> Iterator[tuple[float, int, Workbench]]:
    """Yield the scenario with each budget and each number of wind classes."""
    params = job.params
    wind = job.wind or job.scenario.wind
    for budget in BUDGETS_WH:
        for classes in CLASSES:
            campaign_params = CampaignParams(
                missions=params.missions,
                seed=params.seed,
                wind_classes=classes,
                risk_weight=params.risk_weight,
                levels=params.levels,
            )
            scenario = msgspec.structs.replace(job.scenario, budget_wh=budget, wind=wind)
            yield budget, classes, Workbench(scenario, campaign_params)


def _fly_cells_in_chain_wind(job: Table1Job) -> Iterator[CellShares]:
    """Fly on a chain. BER's tables of one budget serve every bound and number of classes."""
    params, share = job.params, job.params.paper_share
    searches: dict[float, PolicySearch] = {}
    for budget, classes, bench in _build_workbenches(job):
        for name in BASELINES:
            yield (classes, budget, name), bench.outcome_percentages(bench.build_planner(name))
        assert bench.chain is not None
        assert bench.sight is not None
        if budget not in searches:
            searches[budget] = bench.build_policy_search(bench.chain, bench.sight)
            searches[budget].solve_and_store_covering_weights(
                [bound_to_max_loss(b, c, budget, share) for b in params.max_losses for c in CLASSES]
            )
        search = searches[budget]
        tuner = PolicyTuner(search, bench.sight, params.tuning)
        for bound in params.max_losses:
            max_loss = bound_to_max_loss(bound, classes, budget, share)
            label = format_bound_label(bound)
            planner = Ber(tuner.tune_policy_to_loss_bound(max_loss), bench.sight, bench.graph)
            yield (classes, budget, label), bench.outcome_percentages(planner)
            limit = search.best_policy_within_loss(max_loss).forecast
            stays = 1.0 - limit.success - limit.loss
            shares = [100.0 * x for x in (limit.success, limit.loss, 0.0, stays)]
            yield (classes, budget, label.replace("ber", "frontier")), shares


def _fly_cells_in_recorded_wind(job: Table1Job) -> Iterator[CellShares]:
    """Fly on a recording. BER's tables serve both budgets."""
    params = job.params
    process = build_prior_wind(read_wind_process("coast"), spacing_mps=2.5, extent_mps=10.0)
    policy: LogPolicy | None = None
    for budget, classes, bench in _build_workbenches(job):
        for name in (*BASELINES, "clairvoyant"):
            planner = bench.cached_planner(name, bench.first_winds)
            yield (classes, budget, name), bench.outcome_percentages(planner)
        if policy is None:
            model = build_edge_transition_model(
                bench.graph, process.build_lattice_chain(), max(BUDGETS_WH), 150
            )
            policy = solve_log_policy(model)
        for bound in params.max_losses:
            max_loss = bound_to_max_loss(bound, classes, budget, params.paper_share)
            planner = BerLog(policy, process, max_loss, classes)
            yield (classes, budget, format_bound_label(bound)), bench.outcome_percentages(planner)


def build_jobs(params: Table1Params, wind_log: Path | None = None) -> list[Table1Job]:
    """Return the table's jobs, round by round, in a chain's wind or in a recording's."""
    wind = read_recorded_wind(wind_log, LONGEST_MISSION_S) if wind_log else None
    scenarios = draw_scenario_set(
        params.rounds * params.graphs, params.generator, params.seed, params.targets
    )
    return [Table1Job(scenario, params, wind) for scenario in scenarios]


def build_table1_report(
    found: list[list[CellShares]], params: Table1Params, gusty: bool, wind_log: Path | None
) -> Report:
    """Return the table of all scenarios."""
    title = "Table 1" + (", gusty set" if gusty else "")
    title += f", recording {wind_log.stem}" if wind_log else ""
    title += ", readings of the published BER" if params.readings else ""
    stem = (
        "table1"
        + ("_readings" if params.readings else "")
        + ("_gusty" if gusty else "")
        + (f"_{wind_log.stem}" if wind_log else "")
    )
    note = NOTE.format(graphs=params.graphs, share=params.paper_share)
    return Report({stem: table1_sheet(title, outcome_percentages_by_cell(found), note, params)})


def table1_sheet(title: str, cells: dict[Cell, Shares], note: str, params: Table1Params) -> Sheet:
    """Tabulate mean ± std over rounds with 95 % intervals over graphs, and the paper's values."""

    def shares_by_graph(cell: Cell) -> Shares:
        by_target = cells[cell].reshape(params.rounds, params.graphs, -1, 4)
        return by_target.mean(axis=2)

    columns: dict[str, Column] = {
        "classes": "{0[0]}",
        "B": "{0[1]:g}",
        "planner": "{0[2]}",
        **outcome_columns(shares_by_graph, params.targets * params.missions),
        "paper SUC / DEL / FAIL / ABRT": lambda cell: paper_row(
            PAPER[cell[:2]].get("ber" if "paper's" in cell[2] or "kappa" in cell[2] else cell[2])
        ),
    }
    return Sheet.from_objects(title, cells, columns, note)


def outcome_columns(
    shares_by_graph: Callable[[Any], Shares], missions_by_graph: int
) -> dict[str, Column]:
    """Return the columns for a cell's shares (rounds, graphs, 4): means by round, an interval."""
    return {
        **{
            f"{name} %": lambda cell, k=k: mean_and_std(shares_by_graph(cell)[..., k].mean(1))
            for k, name in enumerate(("SUC", "DEL", "FAIL", "ABRT"))
        },
        "loss %": lambda cell: f"{shares_by_graph(cell)[..., 1:3].sum(axis=-1).mean():.2f}",
        "SUC 95 %": lambda cell: share_interval(
            shares_by_graph(cell)[..., 0].ravel(), missions_by_graph
        ),
    }


def share_interval(percent_by_graph: Floats, missions_by_graph: int) -> Figures:
    """Return the 95 % interval, in percent, of an outcome's share over graphs."""
    low, high = bootstrap_share_interval95(
        percent_by_graph / 100.0 * missions_by_graph,
        np.full(percent_by_graph.size, missions_by_graph),
        np.random.default_rng(TABLE_SEED),
    )
    return low_to_high((100.0 * low, 100.0 * high), ".1f")


def paper_row(row: tuple[float, float, float, float] | None) -> Figures | str:
    """Return the paper's row, or a dash if it has none."""
    if row is None:
        return "-"
    names = ("SUC", "DEL", "FAIL", "ABRT")
    return separated({f"paper {n} %": f"{x:.1f}" for n, x in zip(names, row, strict=True)}, " / ")


NOTE = (
    "This project: mean ± std over rounds of {graphs} graphs; 95 % intervals over all graphs "
    "(bootstrap, or Wilson's where wider). Each scenario keeps the bound separately, so the loss "
    "over all is smaller; \"at the paper's "
    'loss" permits each scenario {share:g} times that loss. `frontier` is the '
    "forecast of the tables with an observed wind state, at the permitted loss: an upper bound "
    "where classes hide it. The paper states neither graph size, wind process nor airframe. "
    "The settings here bring SER and RER close to its rows; BER results from them."
)


def read_recorded_wind(path: Path, longest_mission_s: float) -> LogWind:
    """Read a CSV of `t_s, wind_speed_mps, wind_from_deg` as a scenario's wind (to east, to north).

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
