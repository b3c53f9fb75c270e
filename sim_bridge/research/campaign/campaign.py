"""Campaigns: many missions on many scenarios by many planners, the same winds for all.

Missions are cut into blocks whose random numbers depend on the seed, the scenario and the block
only; rows are sums over blocks in order. So the rows are the same whatever the number of jobs.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from time import perf_counter

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.adapters.files.params import read_wind_process
from companion.core.base.errors import LeewayError
from companion.core.routing.energy_graph import EnergyGraph, prune
from companion.core.routing.planner_interface import Decider, Look, MissionPlanner
from companion.core.routing.shortest_paths import RouteFinder
from sim_bridge.research.planners.baselines import Ger, Rer, Ser
from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.ber_log import BerLog, solve_log_policy
from sim_bridge.research.planners.ber_paper import BerPaper, BerPaperParams
from sim_bridge.research.planners.bounded_loss_policy import PolicySearch, ValuePolicy
from sim_bridge.research.planners.clairvoyant import Clairvoyant
from sim_bridge.research.planners.dynamic_program import solve_home
from sim_bridge.research.planners.edge_transitions import build_step_model
from sim_bridge.research.planners.markov_chain import Sight, WindChain, prior_wind, sight_of
from sim_bridge.research.planners.mission_model import (
    ChainWinds,
    LogWinds,
    MissionResults,
    Outcome,
    Winds,
    fly_missions,
)
from sim_bridge.research.planners.online import OnlineModel
from sim_bridge.research.planners.scenario import (
    ChainWind,
    Scenario,
    build_energy_graph,
    chain_from_scenario,
)
from sim_bridge.research.planners.tuning import PolicyTuner, TuningParams
from sim_bridge.research.planners.uncertainty import ChainUncertainty, DriftUncertainty, RiskCost

PLANNERS = ("ser", "rer", "ger", "ber-paper", "ber", "clairvoyant")
BLOCK = 10_000  # missions that are flown together
BLOCKS_PER_TASK = 5
TIMED_DECISIONS = 100  # decisions that are timed one by one,
TIMED_SHARE = 0.004  # but no more than this share of the missions' number
CELLS_AT_FULL_LEVELS = 30_000  # edges x states up to which `levels` are all used
FEWEST_LEVELS = 150


@dataclass(frozen=True)
class CampaignParams:
    """What a campaign is asked for; `levels` is the energy grid of BER's tables."""

    missions: int = 2000
    seed: int = 1
    wind_classes: int | None = None
    max_loss: float = 0.01
    risk_weight: float = 1.0
    levels: int = 500
    log_levels: int = 250
    paper: BerPaperParams = field(default_factory=BerPaperParams)
    tuning: TuningParams = field(default_factory=TuningParams)

    def __post_init__(self) -> None:
        if self.missions < 1:
            raise LeewayError(f"missions = {self.missions}: expected 1 or more")
        if self.seed < 0:
            raise LeewayError(f"seed = {self.seed}: expected 0 or more")
        if self.wind_classes not in (None, 4, 8):
            raise LeewayError(f"wind classes = {self.wind_classes}: expected 4 or 8")
        if not 0.0 <= self.max_loss <= 1.0:
            raise LeewayError(f"max loss = {self.max_loss!r}: expected a probability from 0 to 1")
        if not 0.0 <= self.risk_weight < np.inf:
            raise LeewayError(f"risk weight = {self.risk_weight!r}: expected 0 or more")


class CampaignRow(msgspec.Struct, frozen=True):
    """One row of the campaign's JSON: counts of outcomes (docs/reference/outcomes.md), means."""

    scenario: str
    planner: str
    missions: int
    SUC: int
    DEL: int
    FAIL: int
    ABRT: int
    energy_wh_mean: float
    energy_wh_std: float
    margin_wh_mean: float | None
    margin_wh_std: float | None
    time_s_mean: float
    time_s_std: float
    decisions: int
    decision_us_median: float
    decision_us_p99: float

    @property
    def loss(self) -> float:
        return (self.DEL + self.FAIL) / self.missions

    @property
    def success(self) -> float:
        return self.SUC / self.missions


class Tally(msgspec.Struct, frozen=True):
    """Sums over one block of missions: what rows are made of."""

    outcomes: tuple[int, int, int, int]
    energy_wh: tuple[float, float]  # sum and sum of squares
    margin_wh: tuple[float, float]
    time_s: tuple[float, float]
    decisions: int


class CampaignTask(msgspec.Struct, frozen=True):
    """Some blocks of one row; `timed` also times decisions."""

    scenario: int
    planner: str
    first_block: int
    blocks: int
    timed: bool


class TaskResult(msgspec.Struct, frozen=True):
    """What a task found."""

    tallies: list[Tally]
    decision_us: list[float]
    note: str = ""


class Workbench:
    """One scenario ready to fly: arrays, chain, winds, and planners built once each."""

    def __init__(
        self, scenario: Scenario, params: CampaignParams, graph: EnergyGraph | None = None
    ) -> None:
        """`graph` stands in for the scenario's own where obstacles bend the wind."""
        self.scenario, self.params = scenario, params
        self.graph: EnergyGraph = build_energy_graph(scenario) if graph is None else graph
        self._planners: dict[str, MissionPlanner] = {}
        self.chain: WindChain | None = None
        self.sight: Sight | None = None
        if isinstance(scenario.wind, ChainWind):
            self.chain = chain_from_scenario(scenario.wind)
            self.sight = sight_of(self.chain, params.wind_classes)
        self.process = prior_wind(read_wind_process("coast"), spacing_mps=2.0)
        self.tuner: PolicyTuner | None = None

    def with_budget(self, budget_wh: float) -> "Workbench":
        """The same scenario with another budget."""
        return Workbench(msgspec.structs.replace(self.scenario, budget_wh=budget_wh), self.params)

    def winds(self, block: int) -> Winds:
        """The winds of one block's missions."""
        count = min(BLOCK, self.params.missions - block * BLOCK)
        name = zlib.crc32(self.scenario.name.encode())
        random = np.random.default_rng([self.params.seed, name, block, 0])
        wind = self.scenario.wind
        if self.chain is not None and self.sight is not None:
            return ChainWinds(self.graph, self.chain, self.sight, count, random)
        assert not isinstance(wind, ChainWind)
        return LogWinds(
            self.graph,
            np.array(wind.t_s, dtype=float),
            np.array(wind.wind_en_mps, dtype=float),
            random.uniform(*wind.start_s, size=count),
            self.params.wind_classes,
        )

    def coins(self, block: int, count: int) -> NDArray[np.float64]:
        """The uniform number that each mission's planner may draw from."""
        name = zlib.crc32(self.scenario.name.encode())
        return np.random.default_rng([self.params.seed, name, block, 1]).random(count)

    def planner(self, name: str, winds: Winds) -> MissionPlanner:
        """The planner by name; the clairvoyant is built on the winds that it foresees."""
        if name == "clairvoyant":
            if not isinstance(winds, LogWinds):
                raise LeewayError(
                    "planner clairvoyant: for recorded winds only; a chain's yardstick is the"
                    " frontier"
                )
            return Clairvoyant(self.graph, self.scenario.budget_wh, winds)
        if name not in self._planners:
            self._planners[name] = self.build(name)
        return self._planners[name]

    def build(self, name: str, remember: bool = True) -> MissionPlanner:
        """A new planner; without `remember` it works out every decision afresh."""
        budget = self.scenario.budget_wh
        if name == "ser":
            return Ser(self.online_model(remember), budget)
        if name == "rer":
            return Rer(self.online_model(remember))
        if name == "ger":
            return Ger(self.online_model(remember))
        if name == "ber-paper":
            return BerPaper(self.online_model(remember), self.params.paper)
        if name == "ber":
            return self._ber()
        raise LeewayError(f"planner {name!r}: expected one of {', '.join(PLANNERS)}")

    def online_model(self, remember: bool) -> OnlineModel:
        """What the planners that re-plan share."""
        longest_s = self.scenario.budget_wh * 3600.0 / min(self.graph.power_w)
        if self.chain is not None and self.sight is not None:
            spread = ChainUncertainty(self.graph, self.chain, self.sight, longest_s)
            winds = self.sight.count
        else:
            classes = self.params.wind_classes
            sector = 2.0 * np.pi / classes if classes else 0.0
            spread = DriftUncertainty(self.graph, self.process, longest_s, sector)
            winds = 0
        cost = RiskCost(self.graph, self.params.risk_weight, spread)
        return OnlineModel(RouteFinder(self.graph), cost, winds if remember else 0)

    def _ber(self) -> MissionPlanner:
        if self.chain is None or self.sight is None:
            chain = self.process.chain()
            model = build_step_model(
                self.graph, chain, self.scenario.budget_wh, self.params.log_levels
            )
            policy = solve_log_policy(model)
            return BerLog(policy, self.process, self.params.max_loss, self.params.wind_classes)
        return self.ber_on(self.chain, self.sight)

    def ber_on(self, chain: WindChain, sight: Sight) -> MissionPlanner:
        """BER as it plans when it believes in this chain, seen like this."""
        return Ber(self.policy(chain, sight), sight, self.graph)

    def policy(self, chain: WindChain, sight: Sight) -> ValuePolicy:
        """The tuned policy for this sight of the chain."""
        if self.tuner is None:
            self.tuner = PolicyTuner(self.search(chain, sight), sight, self.params.tuning)
        return self.tuner.policy(self.params.max_loss)

    def search(self, chain: WindChain, sight: Sight) -> PolicySearch:
        """BER's tables by loss weight: the same for every bound, and for every count of classes."""
        budget = self.scenario.budget_wh
        winds = chain.states_en_mps
        energy = np.stack([self.graph.energy_wh(winds, load) for load in (False, True)])
        graph = prune(self.graph, energy, budget).graph
        cells = graph.edge_count * chain.state_count
        scale = min(1.0, CELLS_AT_FULL_LEVELS / max(cells, 1))
        levels = max(min(FEWEST_LEVELS, self.params.levels), int(self.params.levels * scale))
        model = build_step_model(graph, chain, budget, levels)
        believes = not sight.reveals_state()
        return PolicySearch(model, solve_home(model, believes), believes)


def run_task(
    scenario: Scenario, params: CampaignParams, task: CampaignTask, bench: Workbench
) -> TaskResult:
    """Fly the task's blocks."""
    tallies: list[Tally] = []
    decision_us: list[float] = []
    for block in range(task.first_block, task.first_block + task.blocks):
        winds = bench.winds(block)
        planner = bench.planner(task.planner, winds)
        coins = bench.coins(block, winds.count)
        flown = fly_missions(bench.graph, scenario.budget_wh, winds, planner.begin(coins))
        tallies.append(tally(flown, scenario.budget_wh))
        if task.timed and block == task.first_block:
            decision_us = time_decisions(bench, task.planner, winds, coins)
    note = ""
    if task.planner == "ber" and all(t.decisions == t.outcomes[Outcome.ABRT] for t in tallies):
        note = (
            f"{scenario.name}: ber stays at the depot: no flight keeps P(loss) within"
            f" {params.max_loss:g}"
        )
    return TaskResult(tallies, decision_us, note)


def tally(flown: MissionResults, budget_wh: float) -> Tally:
    """Sums over missions; the margin is what those that came home had left."""
    home = (flown.outcome == Outcome.SUC) | (flown.outcome == Outcome.ABRT)
    counts = np.bincount(flown.outcome, minlength=4).tolist()
    return Tally(
        outcomes=(counts[0], counts[1], counts[2], counts[3]),
        energy_wh=_sums(flown.energy_wh),
        margin_wh=_sums(budget_wh - flown.energy_wh[home]),
        time_s=_sums(flown.time_s),
        decisions=int(flown.decisions.sum()),
    )


def _sums(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values.sum()), float(np.square(values).sum())


class _Timed:
    """A decider whose decisions are timed, one mission at a time."""

    def __init__(self, decider: Decider) -> None:
        self._decider = decider
        self.us: list[float] = []

    def decide(self, look: Look) -> NDArray[np.int64]:
        begin = perf_counter()
        edge = self._decider.decide(look)
        self.us.append((perf_counter() - begin) * 1e6)
        return edge


class _One:
    """One mission's winds out of many."""

    def __init__(self, winds: Winds, mission: int) -> None:
        self._winds, self._mission = winds, np.array([mission])

    @property
    def count(self) -> int:
        return 1

    def look(self, mission: NDArray, time_s: NDArray) -> tuple[NDArray, NDArray]:
        return self._winds.look(self._mission, time_s)

    def fly(
        self,
        mission: NDArray,
        edge: NDArray,
        time_s: NDArray,
        energy_wh: NDArray,
        delivered: NDArray,
    ) -> tuple[NDArray, NDArray]:
        return self._winds.fly(self._mission, edge, time_s, energy_wh, delivered)


def time_decisions(
    bench: Workbench, name: str, winds: Winds, coins: NDArray[np.float64]
) -> list[float]:
    """Microseconds of decisions taken alone: tables are read, routes are planned afresh."""
    if name == "clairvoyant":
        return []  # it decides nothing on the way
    planner = bench.planner(name, winds) if name == "ber" else bench.build(name, remember=False)
    if isinstance(winds, ChainWinds):
        winds.restart()
    times: list[float] = []
    for mission in range(winds.count):
        timed = _Timed(planner.begin(coins[mission : mission + 1]))
        fly_missions(bench.graph, bench.scenario.budget_wh, _One(winds, mission), timed)
        times += timed.us
        if len(times) > min(TIMED_DECISIONS, TIMED_SHARE * bench.params.missions):
            break
    return times[1:] if len(times) > 1 else times  # the first one warms caches up


def tasks_of(scenarios: int, planners: list[str], params: CampaignParams) -> list[CampaignTask]:
    """The campaign cut into tasks, scenario by scenario."""
    blocks = -(-params.missions // BLOCK)
    return [
        CampaignTask(s, planner, first, min(BLOCKS_PER_TASK, blocks - first), timed=first == 0)
        for s in range(scenarios)
        for planner in planners
        for first in range(0, blocks, BLOCKS_PER_TASK)
    ]


def rows_of(
    scenarios: list[Scenario], tasks: list[CampaignTask], done: dict[int, TaskResult]
) -> Iterator[CampaignRow]:
    """The rows, in the order of the tasks, from what every task found; whole rows only."""
    grouped: dict[tuple[int, str], list[TaskResult | None]] = {}
    for i, task in enumerate(tasks):
        grouped.setdefault((task.scenario, task.planner), []).append(done.get(i))
    for (scenario, planner), found in grouped.items():
        parts = [part for part in found if part is not None]
        if len(parts) < len(found):
            continue
        tallies = [t for part in parts for t in part.tallies]
        times = [us for part in parts for us in part.decision_us]
        yield _row(scenarios[scenario].name, planner, tallies, times)


def _row(
    scenario: str, planner: str, tallies: list[Tally], decision_us: list[float]
) -> CampaignRow:
    counts = np.sum([t.outcomes for t in tallies], axis=0).tolist()
    missions = sum(counts)
    home = counts[Outcome.SUC] + counts[Outcome.ABRT]
    energy = _mean_std([t.energy_wh for t in tallies], missions)
    margin = _mean_std([t.margin_wh for t in tallies], home)
    time = _mean_std([t.time_s for t in tallies], missions)
    return CampaignRow(
        scenario=scenario,
        planner=planner,
        missions=missions,
        SUC=counts[0],
        DEL=counts[1],
        FAIL=counts[2],
        ABRT=counts[3],
        energy_wh_mean=energy[0] or 0.0,
        energy_wh_std=energy[1] or 0.0,
        margin_wh_mean=margin[0],
        margin_wh_std=margin[1],
        time_s_mean=time[0] or 0.0,
        time_s_std=time[1] or 0.0,
        decisions=sum(t.decisions for t in tallies),
        decision_us_median=float(np.median(decision_us)) if decision_us else 0.0,
        decision_us_p99=float(np.percentile(decision_us, 99)) if decision_us else 0.0,
    )


def _mean_std(sums: list[tuple[float, float]], count: int) -> tuple[float | None, float | None]:
    if count == 0:
        return None, None
    total, square = sum(s[0] for s in sums), sum(s[1] for s in sums)
    mean = total / count
    return mean, float(np.sqrt(max(square / count - mean * mean, 0.0)))


def run_campaign(
    scenarios: list[Scenario], planners: list[str], params: CampaignParams
) -> list[CampaignRow]:
    """The whole campaign in this process."""
    done: dict[int, TaskResult] = {}
    tasks = tasks_of(len(scenarios), planners, params)
    bench: Workbench | None = None
    for i, task in enumerate(tasks):
        scenario = scenarios[task.scenario]
        if bench is None or bench.scenario is not scenario:
            bench = Workbench(scenario, params)
        done[i] = run_task(scenario, params, task, bench)
    return list(rows_of(scenarios, tasks, done))


def without_timings(row: CampaignRow) -> CampaignRow:
    """The row as it is on any machine."""
    return msgspec.structs.replace(row, decision_us_median=0.0, decision_us_p99=0.0)
