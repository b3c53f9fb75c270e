"""A scenario with its graph, chain, winds and planners, each built once."""

import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.adapters.files.params import read_wind_process
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.routing.energy_graph import EnergyGraph, prune_edges_unusable_within_budget
from companion.core.routing.planner_interface import MissionPlanner
from sim_bridge.research.planners.baselines import Ger, Rer, Ser
from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.ber_log import BerLog, solve_log_policy
from sim_bridge.research.planners.ber_paper import BerPaper, BerPaperParams
from sim_bridge.research.planners.bounded_loss_policy import PolicySearch, ValuePolicy
from sim_bridge.research.planners.clairvoyant import Clairvoyant
from sim_bridge.research.planners.dynamic_program import solve_return_table
from sim_bridge.research.planners.edge_transitions import build_edge_transition_model
from sim_bridge.research.planners.markov_chain import (
    Sight,
    WindChain,
    build_observed_wind_by_state,
    build_prior_wind,
)
from sim_bridge.research.planners.mission_model import (
    ChainWinds,
    LogWinds,
    Winds,
    fly_missions,
)
from sim_bridge.research.planners.online import ReplanningModel
from sim_bridge.research.planners.planner_plugin import (
    CheckedPlanner,
    PlannerFactory,
    PlanningTask,
    load_planner_factory,
)
from sim_bridge.research.planners.scenario import (
    ChainWind,
    Scenario,
    build_energy_graph,
    chain_from_scenario,
)
from sim_bridge.research.planners.tuning import PolicyTuner, TuningParams
from sim_bridge.research.planners.uncertainty import ChainUncertainty, DriftUncertainty, RiskCost

PLANNERS = ("ser", "rer", "ger", "ber-paper", "ber", "clairvoyant")
MISSIONS_PER_BLOCK = 10_000  # missions that are simulated together
CELLS_AT_FULL_LEVELS = 30_000  # edges x states up to which all `levels` are used
MIN_LEVELS = 150


@dataclass(frozen=True)
class CampaignParams:
    """Settings of a campaign; `levels` is the energy grid of BER's tables."""

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


class Workbench:
    """Builds and stores one scenario's arrays, chain, winds and planners."""

    def __init__(
        self, scenario: Scenario, params: CampaignParams, graph: EnergyGraph | None = None
    ) -> None:
        """`graph` replaces the scenario's graph, for example where obstacles change the wind."""
        self.scenario, self.params = scenario, params
        self.graph: EnergyGraph = build_energy_graph(scenario) if graph is None else graph
        self._planners: dict[str, MissionPlanner] = {}
        self.chain: WindChain | None = None
        self.sight: Sight | None = None
        if isinstance(scenario.wind, ChainWind):
            self.chain = chain_from_scenario(scenario.wind)
            self.sight = build_observed_wind_by_state(self.chain, params.wind_classes)
        self.process = build_prior_wind(read_wind_process("coast"), spacing_mps=2.0)
        self.tuner: PolicyTuner | None = None

    @cached_property
    def first_winds(self) -> ChainWinds | LogWinds:
        """Winds of the first block, which the tables fly."""
        return self.draw_block_winds(0)

    def outcome_percentages(self, planner: MissionPlanner) -> list[float]:
        """Fly the first block's missions. Return SUC, DEL, FAIL, ABRT in percent."""
        winds, count = self.first_winds, self.first_winds.mission_count
        winds.restart_at_departure()
        decider = planner.start_batch(self.draw_uniform_per_mission(0, count))
        flown = fly_missions(self.graph, self.scenario.budget_wh, winds, decider)
        return (100.0 * np.bincount(flown.outcome, minlength=4) / count).tolist()

    def draw_block_winds(self, block_index: int, count: int | None = None) -> ChainWinds | LogWinds:
        """Return the winds of one block's missions, or of this number of them."""
        if count is None:
            count = min(MISSIONS_PER_BLOCK, self.params.missions - block_index * MISSIONS_PER_BLOCK)
        name = zlib.crc32(self.scenario.name.encode())
        random = np.random.default_rng([self.params.seed, name, block_index, 0])
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

    def draw_uniform_per_mission(self, block_index: int, count: int) -> NDArray[np.float64]:
        """Return one uniform number per mission, from which its planner can draw."""
        name = zlib.crc32(self.scenario.name.encode())
        return np.random.default_rng([self.params.seed, name, block_index, 1]).random(count)

    def cached_planner(self, name: str, winds: Winds | None = None) -> MissionPlanner:
        """Return the planner by name. The clairvoyant is built on its winds."""
        if name == "clairvoyant":
            assert isinstance(winds, LogWinds)
            return Clairvoyant(self.graph, self.scenario.budget_wh, winds)
        if name not in self._planners:
            self._planners[name] = self.build_planner(name)
        return self._planners[name]

    def build_planner(self, name: str, use_cache: bool = True) -> MissionPlanner:
        """Build a new planner; without the cache it computes every decision again."""
        if name not in PLANNERS:
            return self.build_foreign_planner(*load_planner_factory(name, PLANNERS))
        if name == "ber":
            return self._build_default_ber()
        model = self.build_replanning_model(use_cache)
        builders: dict[str, Callable[[], MissionPlanner]] = {
            "ser": lambda: Ser(model, self.scenario.budget_wh),
            "rer": lambda: Rer(model),
            "ger": lambda: Ger(model),
            "ber-paper": lambda: BerPaper(model, self.params.paper),
        }
        return builders[name]()

    def build_foreign_planner(self, label: str, factory: PlannerFactory) -> MissionPlanner:
        """Return a planner of another package, whose edges are checked."""
        budget_wh, max_loss = self.scenario.budget_wh, self.params.max_loss
        task = PlanningTask(self.graph, budget_wh, max_loss, self.chain)
        return CheckedPlanner(label, factory, task)

    def build_replanning_model(self, use_cache: bool) -> ReplanningModel:
        """Return the model that all re-planning planners share."""
        longest_s = self.scenario.budget_wh * 3600.0 / min(self.graph.power_w)
        if self.chain is not None and self.sight is not None:
            spread = ChainUncertainty(self.graph, self.chain, self.sight, longest_s)
            winds = self.sight.observed_wind_count
        else:
            classes = self.params.wind_classes
            sector = 2.0 * np.pi / classes if classes else 0.0
            spread = DriftUncertainty(self.graph, self.process, longest_s, sector)
            winds = 0
        cost = RiskCost(self.graph, self.params.risk_weight, spread)
        return ReplanningModel(self.graph, cost, winds if use_cache else 0)

    def _build_default_ber(self) -> MissionPlanner:
        if self.chain is None or self.sight is None:
            chain = self.process.build_lattice_chain()
            model = build_edge_transition_model(
                self.graph, chain, self.scenario.budget_wh, self.params.log_levels
            )
            policy = solve_log_policy(model)
            return BerLog(policy, self.process, self.params.max_loss, self.params.wind_classes)
        return self.build_ber(self.chain, self.sight)

    def build_ber(self, chain: WindChain, sight: Sight) -> MissionPlanner:
        """Return BER that plans with this chain and sight."""
        return Ber(self.tune_policy(chain, sight), sight, self.graph)

    def tune_policy(self, chain: WindChain, sight: Sight) -> ValuePolicy:
        """Return the tuned policy for this sight of the chain."""
        if self.tuner is None:
            self.tuner = PolicyTuner(
                self.build_policy_search(chain, sight), sight, self.params.tuning
            )
        return self.tuner.tune_policy_to_loss_bound(self.params.max_loss)

    def build_policy_search(self, chain: WindChain, sight: Sight) -> PolicySearch:
        """Return BER's tables by loss weight: the same for every bound and number of classes."""
        budget = self.scenario.budget_wh
        winds = chain.states_en_mps
        energy = np.stack([self.graph.edge_energy_wh(winds, load) for load in (False, True)])
        graph = prune_edges_unusable_within_budget(self.graph, energy, budget).graph
        cells = graph.edge_count * chain.state_count
        scale = min(1.0, CELLS_AT_FULL_LEVELS / max(cells, 1))
        levels = max(min(MIN_LEVELS, self.params.levels), int(self.params.levels * scale))
        model = build_edge_transition_model(graph, chain, budget, levels)
        hides_state = not sight.reveals_state()
        return PolicySearch(model, solve_return_table(model, hides_state), hides_state)


Key = TypeVar("Key")


def outcome_percentages_by_cell(
    parts: Iterable[Iterable[tuple[Key, list[float]]]],
) -> dict[Key, Floats]:
    """Collect the outcome shares of each cell of a table by scenario; arrays (scenarios, 4)."""
    cells: dict[Key, list[list[float]]] = {}
    for part in parts:
        for key, shares in part:
            cells.setdefault(key, []).append(shares)
    return {key: np.array(shares) for key, shares in cells.items()}
