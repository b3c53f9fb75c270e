"""Table 2: the value of each part, over a day of 20 customers, four drones and one truck.

A trial is one town graph and one day (`table2_day`): customers clustered by the ground station, the
truck's tour over the stops, a drone's flight from a stop to each other customer and back. Every
corner is flown (`turning`): rounded at the airframe's bank limit, or by losing speed. FAIL counts
every lost vehicle, as the paper's three columns sum to 100. Rows:
  BER (full)               ours for clusters (an LLM's with --llm-url: a row of its own)
  without budget gate      no bound on the loss (max loss 1)
  without LLM              no clusters: the truck stops once, at the customer nearest to its depot
  with k-means             clusters by metres
  without wind             plans as if it were calm, always
  without risk             plans as if the wind seen stayed for ever
  without trajectory opt.  straight legs, speed lost at each corner
Max turn is the largest change of the vehicle's heading within 2 s, mean over the flights that have
a corner; the hover at the customer is none.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import Decider, Look, MissionPlanner
from ground_station.adapters.llm import LlmParams
from sim_bridge.research.campaign.campaign import CampaignParams, Workbench
from sim_bridge.research.campaign.scenario_generator import (
    GeneratorParams,
    WindRose,
    random_scenario,
)
from sim_bridge.research.dubins.limits import FlightLimits
from sim_bridge.research.planners.markov_chain import Sight, WindChain
from sim_bridge.research.planners.mission_model import (
    ChainWinds,
    MissionResults,
    Outcome,
    fly_missions,
)
from sim_bridge.research.planners.scenario import Scenario, build_energy_graph
from sim_bridge.research.planners.tuning import TuningParams
from sim_bridge.research.results.sheet import Sheet, mean_std
from sim_bridge.research.tables.table2_day import (
    DRONES,
    STOPS,
    Sortie,
    delivery_energy_wh,
    makespan_s,
    plan_day,
    problem_of,
)
from sim_bridge.research.tables.turning import AsPlanned, Turning, TurningWinds, with_turning

CUSTOMERS = 20
MISSIONS_PER_CUSTOMER = 10
SETTING_SEED = 5  # settings were looked at on this seed; the table is printed on another
TABLE2_SEED = 2611
MAX_LOSS = 0.02

BANK_LIMIT_RAD = math.radians(8.5)
"""With a parcel below. The paper's 11.3 deg within 2 s is 8.6 deg of bank at 15 m/s; fixed from
that before any run."""
ACCEL_MPS2 = 2.5  # ArduCopter WPNAV_ACCEL default; what a corner that is not rounded is flown with

SETTING = GeneratorParams(
    vertices=40,
    sides_m=((2000.0, 1.0),),
    budget_wh=85.0,
    loaded_w=1700.0,
    empty_w=1300.0,
    rose=WindRose(directions=16, speeds_mps=(3.0, 8.0), dwell_s=120.0, jumps="neighbour"),
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


class TrialFigures(msgspec.Struct, frozen=True):
    """One trial of one variant: the paper's seven columns; flights a day, the truck's day, how far
    from its waypoint a flight's widest corner passes (mean), and which method clustered.
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

    def columns(self) -> list[float | None]:
        return [
            self.success,
            self.abort,
            self.fail,
            self.energy_wh,
            self.margin_wh,
            self.time_s,
            self.max_turn_deg,
        ]


class Blind:
    """A planner that is always shown the same wind."""

    name = "blind"

    def __init__(self, planner: MissionPlanner) -> None:
        self._planner = planner

    def begin(self, coin: NDArray[np.float64]) -> Decider:
        return _BlindFlights(self._planner.begin(coin))


class _BlindFlights:
    def __init__(self, decider: Decider) -> None:
        self._decider = decider

    def decide(self, look: Look) -> NDArray[np.int64]:
        return self._decider.decide(
            Look(
                look.mission,
                look.vertex,
                look.delivered,
                look.energy_wh,
                np.zeros_like(look.seen),
                np.zeros_like(look.wind_en_mps),
            )
        )


def planner_of(variant: str, bench: Workbench) -> MissionPlanner:
    """BER with a part taken away."""
    if variant == "without wind":
        calm = WindChain(np.zeros((1, 2)), np.zeros((1, 1)), np.ones(1))
        sight = Sight(np.zeros(1, dtype=np.int64), np.zeros((1, 2)))
        return Blind(bench.ber_on(calm, sight))
    assert bench.chain is not None
    assert bench.sight is not None
    chain = bench.chain
    if variant == "without risk":
        chain = replace(chain, rate_per_s=np.zeros_like(chain.rate_per_s))
    return bench.ber_on(chain, bench.sight)


@dataclass(frozen=True)
class Trial:
    """One trial of one variant."""

    number: int
    variant: str
    seed: int
    llm: LlmParams | None = None


def trials_of(trials: int, seed: int = TABLE2_SEED, llm: LlmParams | None = None) -> list[Trial]:
    """Every variant on the same towns, customers and winds; the LLM's where a server is named."""
    rows = [v for v in PAPER if v != LLM or llm is not None]
    return [
        Trial(number, variant, seed, llm if variant == LLM else None)
        for number in range(trials)
        for variant in rows
    ]


class _Flights:
    """What became of the flights of a day so far."""

    def __init__(self, budget_wh: float) -> None:
        self._budget_wh = budget_wh
        self._lists: dict[str, list[float]] = {k: [] for k in ("energy", "margin", "time")}
        self.outcomes: list[int] = []
        self.turn_rad: list[float] = []
        self.off_m: list[float] = []
        self.mean_s: dict[Sortie, float] = {}

    def add(self, sortie: Sortie, flown: MissionResults, winds: TurningWinds) -> None:
        home = (flown.outcome == Outcome.SUC) | (flown.outcome == Outcome.ABRT)
        flew = flown.energy_wh > 0.0
        self.outcomes += flown.outcome.tolist()
        self._lists["energy"] += flown.energy_wh[flew].tolist()
        self._lists["margin"] += (self._budget_wh - flown.energy_wh[home & flew]).tolist()
        self._lists["time"] += flown.time_s[flew].tolist()
        cornered = flew & ~np.isnan(winds.turn_rad)
        self.turn_rad += winds.turn_rad[cornered].tolist()
        self.off_m += winds.off_m[cornered].tolist()
        self.mean_s[sortie] = float(flown.time_s.mean())

    def mean(self, name: str) -> float:
        return float(np.mean(self._lists[name]))


def fly_trial(asked: Trial) -> TrialFigures:
    """One day: every flight of it, in ten winds each."""
    variant = asked.variant
    random = np.random.default_rng([asked.seed, asked.number])
    base = random_scenario(f"trial-{asked.number}", SETTING, random)
    others = np.array([v for v in range(SETTING.vertices) if v != base.depot])
    customers = random.choice(others, size=CUSTOMERS, replace=False).tolist()
    town = build_energy_graph(base)
    limits = FlightLimits.from_bank(SETTING.airspeed_mps, BANK_LIMIT_RAD)
    how = Turning(limits, ACCEL_MPS2, variant != "without trajectory optimisation")
    # The truck's one stop without clusters is the first customer: let it be the nearest.
    away = np.hypot(*(town.vertices_m[customers] - town.vertices_m[base.depot])[:, :2].T)
    customers = [customers[i] for i in np.argsort(away, kind="stable")]
    winds = SETTING.rose.states_en_mps()
    # No variant's own: all cluster by the same energies, those of the full row.
    rounded = with_turning(town, replace(how, rounded=True))
    energy = delivery_energy_wh(rounded, customers, winds, base.budget_wh)
    problem = problem_of(town, customers, energy)
    day = plan_day(town, problem, CLUSTERS.get(variant, "ours"), asked.llm)
    flights = _Flights(base.budget_wh)
    for sortie in (s for at_stop in day.sorties for s in at_stop):
        name = f"trial-{asked.number}-{sortie.stop}-{sortie.customer}"
        scenario = msgspec.structs.replace(
            base, depot=sortie.stop, target=sortie.customer, name=name
        )
        flights.add(sortie, *_fly_sortie(scenario, variant, how, asked.seed))
    shares = 100.0 * np.bincount(flights.outcomes, minlength=4) / len(flights.outcomes)
    return TrialFigures(
        success=float(shares[Outcome.SUC]),
        abort=float(shares[Outcome.ABRT]),
        fail=float(shares[Outcome.DEL] + shares[Outcome.FAIL]),
        energy_wh=flights.mean("energy"),
        margin_wh=flights.mean("margin"),
        time_s=flights.mean("time"),
        max_turn_deg=_mean_or_none(np.degrees(flights.turn_rad).tolist()),
        flights=len(flights.mean_s),
        makespan_s=makespan_s(town, day, flights.mean_s),
        off_m=_mean_or_none(flights.off_m),
        method=day.method,
    )


def _mean_or_none(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _fly_sortie(
    scenario: Scenario, variant: str, how: Turning, seed: int
) -> tuple[MissionResults, TurningWinds]:
    params = CampaignParams(
        missions=MISSIONS_PER_CUSTOMER,
        seed=seed,
        wind_classes=8,
        max_loss=1.0 if variant == "without budget gate" else MAX_LOSS,
        levels=100,
        tuning=TuningParams(fewest_missions=3_000, most_missions=3_000),
    )
    graph: EnergyGraph = with_turning(build_energy_graph(scenario), how)
    bench = Workbench(scenario, params, graph)
    chained = bench.winds(0)
    assert isinstance(chained, ChainWinds)
    assert bench.chain is not None
    winds = TurningWinds(chained, graph, bench.chain, how)
    planner = planner_of(variant, bench)
    decider = AsPlanned(planner.begin(bench.coins(0, winds.count)), winds)
    return fly_missions(graph, scenario.budget_wh, winds, decider), winds


def by_variant(trials: list[Trial], measured: list[TrialFigures]) -> dict[str, list[TrialFigures]]:
    """The trials of each variant."""
    found: dict[str, list[TrialFigures]] = {}
    for trial, one in zip(trials, measured, strict=True):
        found.setdefault(trial.variant, []).append(one)
    return found


def sheet(found: dict[str, list[TrialFigures]], seed: int = TABLE2_SEED) -> Sheet:
    """The paper's table, ours beside."""
    rows = []
    for variant, paper in PAPER.items():
        theirs = " / ".join(f"{x:g}" for x in paper)
        if variant not in found:
            rows.append([variant, *["not configured"] * 7, theirs])
            continue
        columns = zip(*(m.columns() for m in found[variant]), strict=True)
        rows.append([variant, *(_cell(column) for column in columns), theirs])
    head = ["variant", "SUC %", "ABRT %", "FAIL %", "energy Wh", "margin Wh", "time s"]
    head += ["max turn deg", "paper: the same seven"]
    return Sheet("Table 2", head, rows, _note(found, seed))


def _cell(values: Iterable[float | None]) -> str:
    known = [value for value in values if value is not None]
    return mean_std(known) if known else "no corner"


def _note(found: dict[str, list[TrialFigures]], seed: int) -> str:
    limits = FlightLimits.from_bank(SETTING.airspeed_mps, BANK_LIMIT_RAD)
    days = "; ".join(
        f"{variant}: {mean_std([m.flights for m in found[variant]])} flights,"
        f" {mean_std([m.makespan_s / 60.0 for m in found[variant]])} min"
        for variant in (FULL, "with k-means", "without LLM")
        if variant in found
    )
    off = _cell(m.off_m for m in found.get(FULL, []))
    cornered = sum(m.max_turn_deg is not None for m in found.get(FULL, []))
    return (
        f"Mean ± std over trials (seed {seed}): a town of {SETTING.vertices} vertices on"
        f" {SETTING.sides_m[0][0] / 1000:g} km, {CUSTOMERS} customers, {DRONES} drones, one truck,"
        f" about {STOPS} stops; each flight in {MISSIONS_PER_CUSTOMER} winds, B ="
        f" {SETTING.budget_wh:g} Wh, BER's bound {100 * MAX_LOSS:g} %, 8 classes. A stop's own"
        " customer is the truck's and not counted. Energy, margin and time are of vehicles that"
        " left; margin of those that came home. FAIL is every vehicle lost. Max turn: largest"
        " change of the vehicle's heading within 2 s, over flights with a corner"
        f" ({cornered} of the full row's trials had any), the hover at the customer left out;"
        f" bank limit {math.degrees(BANK_LIMIT_RAD):g} deg, so turns of"
        f" {limits.turn_radius_m:.0f} m at {SETTING.airspeed_mps:g} m/s. Rounded corners pass"
        f" their waypoint at {off} m (mean of each flight's farthest). BER (full) clusters by ours,"
        f" an LLM's clusters are a row of their own. The truck's day: {days}."
        + "".join(f" {words}" for words in _stood_in(found.get(LLM, [])))
    )


def _stood_in(asked: list[TrialFigures]) -> list[str]:
    """On how many days the LLM gave nothing usable, so that ours made its clusters."""
    without = [m for m in asked if m.method != "llm"]
    return [f"On {len(without)} of {len(asked)} days ours stood in for the LLM."] if asked else []


def draw(found: dict[str, list[TrialFigures]], path: Path) -> None:
    """Outcomes of the variants."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(7, 4))
    for i, trials in enumerate(found.values()):
        mean = np.mean([(m.success, m.abort, m.fail) for m in trials], axis=0)
        names = ("home and delivered", "lost", "home, not delivered") if i == 0 else (None,) * 3
        axis.bar(i, mean[0], color="tab:green", label=names[0])
        axis.bar(i, mean[2], bottom=mean[0], color="tab:red", label=names[1])
        axis.bar(i, mean[1], bottom=mean[0] + mean[2], color="lightgrey", label=names[2])
    axis.set_xticks(range(len(found)), list(found), rotation=15, fontsize=8)
    axis.set_ylabel("share of missions, %")
    axis.set_ylim(0, 125)
    axis.legend(ncols=3, fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)
