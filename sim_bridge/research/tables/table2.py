"""Table 2: the effect of each component, over a day of 20 customers, four drones and one truck.

A trial is one town graph and one day (`table2_day`): customers clustered by the ground station, the
truck's tour over the stops, a drone's flight from a stop to each other customer and back. Every
corner is flown (`turn_model`): rounded at the bank limit of the airframe, or by losing speed. FAIL
counts all lost vehicles, because the paper's three columns sum to 100. Rows:
  BER (full)               this project's clusters (an LLM's with --llm-url: a separate row)
  without budget gate      no bound on the loss (max loss 1)
  without LLM              no clusters: the truck stops once, at the customer nearest to its depot
  with k-means             clusters by metres
  without wind             always plans for calm
  without risk             plans for a constant wind
  without trajectory opt.  straight legs, speed lost at each corner
Max turn is the largest change of the vehicle's heading within 2 s, mean over the flights that have
a corner; the hover at the customer does not count.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import MissionPlanner
from ground_station.adapters.llm import LlmParams
from sim_bridge.research.campaign.scenario_generator import (
    DirectionalWindModel,
    GeneratorParams,
    draw_connected_scenario,
)
from sim_bridge.research.campaign.workbench import CampaignParams, Workbench
from sim_bridge.research.dubins.level_paths import FlightLimits
from sim_bridge.research.planners.mission_model import (
    ChainWinds,
    MissionResults,
    Outcome,
    fly_missions,
)
from sim_bridge.research.planners.scenario import Scenario, build_energy_graph
from sim_bridge.research.planners.tuning import TuningParams
from sim_bridge.research.study.run import Report
from sim_bridge.research.study.sheet import Cell, Sheet, mean_and_std, separated
from sim_bridge.research.tables.table2_day import (
    DRONES,
    STOPS,
    Sortie,
    build_clustering_problem,
    delivery_energy_by_stop_and_customer_wh,
    plan_day,
    truck_makespan_s,
)
from sim_bridge.research.tables.turn_model import (
    CornerModel,
    CornerWinds,
    PredictedEnergyPlanner,
    graph_with_calm_corner_costs,
)

CUSTOMERS = 20
MISSIONS_PER_CUSTOMER = 10
TABLE2_SEED = 2611  # the settings were chosen on seed 5
MAX_LOSS = 0.02

BANK_LIMIT_RAD = math.radians(8.5)
"""With a parcel below. The paper's 11.3 deg within 2 s is 8.6 deg of bank at 15 m/s; chosen from
that before any run."""
ACCEL_MPS2 = 2.5  # ArduCopter WPNAV_ACCEL default; applies to corners that are not rounded

SETTING = GeneratorParams(
    vertices=40,
    square_sizes_m=((2000.0, 1.0),),
    budget_wh=85.0,
    loaded_w=1700.0,
    empty_w=1300.0,
    wind_model=DirectionalWindModel(
        directions=16, speeds_mps=(3.0, 8.0), dwell_s=120.0, jumps="neighbour"
    ),
)

# arXiv 2604.13441, Table 2: SUC, ABRT, FAIL, energy, margin, time, max turn.
FULL, LLM = "BER (full)", "BER (LLM)"
PAPER = {
    FULL: (92.4, 4.1, 3.5, 95.2, 12.6, 148.7, 11.3),
    LLM: (92.4, 4.1, 3.5, 95.2, 12.6, 148.7, 11.3),
    "without budget gate": (74.6, 6.3, 19.1, 110.4, 1.9, 162.8, 12.7),
    "without LLM": (86.1, 5.5, 8.4, 101.3, 7.8, 154.8, 11.8),
    "with k-means": (88.2, 5.0, 6.8, 99.6, 8.9, 151.9, 11.6),
    "without wind": (82.7, 9.8, 7.5, 106.8, 6.4, 158.6, 11.9),
    "without risk": (88.9, 4.7, 6.4, 96.7, 9.1, 146.9, 11.5),
    "without trajectory optimisation": (90.8, 3.9, 5.3, 97.5, 10.8, 145.2, 104.6),
}
CLUSTERS = {LLM: "llm", "without LLM": "none", "with k-means": "k-means"}


class TrialResult(msgspec.Struct, frozen=True):
    """One trial of one variant: the paper's seven columns, flights per day, the truck's day, mean
    distance from the waypoint at each flight's widest corner, and the clustering method.
    """

    success: float
    abort: float
    fail: float
    energy_wh: float
    margin_wh: float
    time_s: float
    max_turn_deg: float | None  # None: no flight had a corner
    flights: int
    makespan_s: float
    off_m: float | None
    method: str


COLUMNS = ("success", "abort", "fail", "energy_wh", "margin_wh", "time_s", "max_turn_deg")
"""Columns of the paper's table."""


def build_ablated_planner(variant: str, bench: Workbench) -> MissionPlanner:
    """Return BER with one component removed."""
    chain, sight = bench.chain, bench.sight
    assert chain is not None
    assert sight is not None
    if variant in ("without risk", "without wind"):
        chain = replace(chain, rate_per_s=np.zeros_like(chain.rate_per_s))
    if variant == "without wind":  # whatever is observed is calm
        chain = replace(chain, states_en_mps=np.zeros_like(chain.states_en_mps))
        sight = replace(sight, seen_en_mps=np.zeros_like(sight.seen_en_mps))
    return bench.build_ber(chain, sight)


@dataclass(frozen=True)
class Trial:
    """One trial of one variant."""

    number: int
    variant: str
    seed: int
    llm: LlmParams | None = None


def build_trials(
    trial_count: int, seed: int = TABLE2_SEED, llm: LlmParams | None = None
) -> list[Trial]:
    """Return every variant on the same towns, customers and winds; an LLM row if configured."""
    rows = [v for v in PAPER if v != LLM or llm is not None]
    return [
        Trial(number, variant, seed, llm if variant == LLM else None)
        for number in range(trial_count)
        for variant in rows
    ]


def fly_trial(trial: Trial) -> TrialResult:
    """Fly all flights of one day, in ten winds each."""
    variant = trial.variant
    random = np.random.default_rng([trial.seed, trial.number])
    base = draw_connected_scenario(f"trial-{trial.number}", SETTING, random)
    others = np.array([v for v in range(SETTING.vertices) if v != base.depot])
    customers = random.choice(others, size=CUSTOMERS, replace=False).tolist()
    town = build_energy_graph(base)
    limits = FlightLimits.from_bank(SETTING.airspeed_mps, BANK_LIMIT_RAD)
    corner_model = CornerModel(limits, ACCEL_MPS2, variant != "without trajectory optimisation")
    # Without clusters the truck's one stop is the first customer, so the nearest comes first.
    away = np.hypot(*(town.vertices_m[customers] - town.vertices_m[base.depot])[:, :2].T)
    customers = [customers[i] for i in np.argsort(away, kind="stable")]
    winds = SETTING.wind_model.states_en_mps()
    # All variants cluster by the same energies, those of the full row.
    rounded = graph_with_calm_corner_costs(town, replace(corner_model, rounded=True))
    energy = delivery_energy_by_stop_and_customer_wh(rounded, customers, winds, base.budget_wh)
    problem = build_clustering_problem(town, customers, energy)
    day = plan_day(town, problem, CLUSTERS.get(variant, "ours"), trial.llm)
    flown: dict[Sortie, tuple[MissionResults, CornerWinds]] = {}
    for sortie in (s for at_stop in day.sorties for s in at_stop):
        name = f"trial-{trial.number}-{sortie.stop}-{sortie.customer}"
        scenario = msgspec.structs.replace(
            base, depot=sortie.stop, target=sortie.customer, name=name
        )
        flown[sortie] = _fly_sortie(scenario, variant, corner_model, trial.seed)
    ends, all_winds = zip(*flown.values(), strict=True)
    outcome = np.concatenate([done.outcome for done in ends])
    energy_wh = np.concatenate([done.energy_wh for done in ends])
    time_s = np.concatenate([done.time_s for done in ends])
    turn_rad = np.concatenate([winds.turn_rad for winds in all_winds])
    off_m = np.concatenate([winds.off_m for winds in all_winds])
    home = np.isin(outcome, (Outcome.SUC, Outcome.ABRT))
    flew = energy_wh > 0.0
    cornered = flew & ~np.isnan(turn_rad)
    shares = 100.0 * np.bincount(outcome, minlength=4) / len(outcome)
    mean_s = {sortie: float(done.time_s.mean()) for sortie, (done, _) in flown.items()}
    return TrialResult(
        success=float(shares[Outcome.SUC]),
        abort=float(shares[Outcome.ABRT]),
        fail=float(shares[Outcome.DEL] + shares[Outcome.FAIL]),
        energy_wh=float(energy_wh[flew].mean()),
        margin_wh=float((base.budget_wh - energy_wh[home & flew]).mean()),
        time_s=float(time_s[flew].mean()),
        max_turn_deg=_mean_or_none(np.degrees(turn_rad[cornered])),
        flights=len(flown),
        makespan_s=truck_makespan_s(town, day, mean_s),
        off_m=_mean_or_none(off_m[cornered]),
        method=day.method,
    )


def _mean_or_none(values: Floats) -> float | None:
    return float(values.mean()) if len(values) else None


def _fly_sortie(
    scenario: Scenario, variant: str, corner_model: CornerModel, seed: int
) -> tuple[MissionResults, CornerWinds]:
    params = CampaignParams(
        missions=MISSIONS_PER_CUSTOMER,
        seed=seed,
        wind_classes=8,
        max_loss=1.0 if variant == "without budget gate" else MAX_LOSS,
        levels=100,
        tuning=TuningParams(fewest_missions=3_000, most_missions=3_000),
    )
    graph: EnergyGraph = graph_with_calm_corner_costs(build_energy_graph(scenario), corner_model)
    bench = Workbench(scenario, params, graph)
    chained = bench.draw_block_winds(0)
    assert isinstance(chained, ChainWinds)
    assert bench.chain is not None
    winds = CornerWinds(chained, graph, bench.chain, corner_model)
    planner = build_ablated_planner(variant, bench)
    decider = PredictedEnergyPlanner(
        planner.start_batch(bench.draw_uniform_per_mission(0, winds.mission_count)), winds
    )
    return fly_missions(graph, scenario.budget_wh, winds, decider), winds


def build_table2_report(trials: list[Trial], measured: list[TrialResult], seed: int) -> Report:
    """Return the table of all trials."""
    found: dict[str, list[TrialResult]] = {}
    for trial, one in zip(trials, measured, strict=True):
        found.setdefault(trial.variant, []).append(one)
    return Report({"table2": table2_sheet(found, seed)})


def table2_sheet(found: dict[str, list[TrialResult]], seed: int = TABLE2_SEED) -> Sheet:
    """Tabulate this project's results and the paper's."""
    names = ["SUC %", "ABRT %", "FAIL %", "energy Wh", "margin Wh", "time s", "max turn deg"]
    rows = []
    for variant, paper in PAPER.items():
        theirs = separated(
            {f"paper {n}": f"{x:g}" for n, x in zip(names, paper, strict=True)}, " / "
        )
        if variant not in found:
            rows.append([variant, *["not configured"] * 7, theirs])
            continue
        ours = (_format_cell(getattr(m, name) for m in found[variant]) for name in COLUMNS)
        rows.append([variant, *ours, theirs])
    head = ["variant", *names, "paper: the same seven"]
    return Sheet("Table 2", head, rows, _format_note(found, seed))


def _format_cell(values: Iterable[float | None]) -> Cell:
    known = [value for value in values if value is not None]
    return mean_and_std(known) if known else "no corner"


def _format_note(found: dict[str, list[TrialResult]], seed: int) -> str:
    limits = FlightLimits.from_bank(SETTING.airspeed_mps, BANK_LIMIT_RAD)
    days = "; ".join(
        f"{variant}: {mean_and_std([m.flights for m in found[variant]])} flights,"
        f" {mean_and_std([m.makespan_s / 60.0 for m in found[variant]])} min"
        for variant in (FULL, "with k-means", "without LLM")
        if variant in found
    )
    off = _format_cell(m.off_m for m in found.get(FULL, []))
    cornered = sum(m.max_turn_deg is not None for m in found.get(FULL, []))
    by_llm, llm_note = found.get(LLM, []), ""
    if by_llm:  # on some days its reply was not usable, and this project's method applied
        own = sum(m.method != "llm" for m in by_llm)
        llm_note = f" LLM replaced by own method on {own} of {len(by_llm)} days."
    return (
        f"Mean ± std over trials (seed {seed}): a town of {SETTING.vertices} vertices on"
        f" {SETTING.square_sizes_m[0][0] / 1000:g} km, {CUSTOMERS} customers, {DRONES} drones, one"
        f" truck, about {STOPS} stops; each flight in {MISSIONS_PER_CUSTOMER} winds, B ="
        f" {SETTING.budget_wh:g} Wh, BER's bound {100 * MAX_LOSS:g} %, 8 classes. A stop's own"
        " customer is the truck's and not counted. Energy, margin and time are of vehicles that"
        " departed; margin of those that returned. FAIL counts all lost vehicles. Max turn:"
        " largest change of the vehicle's heading within 2 s, over flights with a corner"
        f" ({cornered} of the full row's trials had any), without the hover at the customer; bank"
        f" limit {math.degrees(BANK_LIMIT_RAD):g} deg, so turns of {limits.turn_radius_m:.0f} m at"
        f" {SETTING.airspeed_mps:g} m/s. Rounded corners pass their waypoint at {off} m (mean of"
        " each flight's farthest). BER (full) uses this project's clusters; an LLM's are in a"
        f" separate row. The truck's day: {days}." + llm_note
    )
