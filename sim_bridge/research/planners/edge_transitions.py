"""Energy cost and wind transition of each edge in each wind state, on a grid of energy."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.core.base.arrays import Floats, Ints, ShortInts, Singles
from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.planners.markov_chain import WindChain

INFEASIBLE_LEVELS = np.int32(2**30)  # cost in levels of an infeasible edge: exceeds every budget
FLOAT32_EDGE_LOSS = 2e-6  # probability; float32 sums of 100 terms are off by some 5e-7
LEVEL_SLACK = 1e-9  # levels; keeps whole numbers of levels whole after division


class Rounding(Enum):
    """Rounding of an edge's energy to the grid.

    UP: to the next whole number of levels. The table is a lower bound.
    LINEAR: interpolates between the two whole numbers. Unbiased, so that 500 levels are as accurate
    as thousands; simulated missions verify the predicted loss
    (`sim_bridge.research.planners.tuning`).
    """

    UP = "up"
    LINEAR = "linear"


@dataclass(frozen=True)
class EdgeTransitionModel:
    """Cost and next-wind distribution of each edge and wind state on `levels` energy levels.

    Shapes: energy_wh (2, E, S) loaded and empty, infinite where infeasible; cost_levels (2, E, S)
    whole levels, rounded up; upper_share (2, E, S) weight of that number against the one below;
    next_state (E, S, S).
    """

    graph: EnergyGraph
    chain: WindChain
    budget_wh: float
    levels: int
    rounding: Rounding
    energy_wh: Floats
    cost_levels: ShortInts
    upper_share: Singles
    next_state: NDArray

    @property
    def energy_step_wh(self) -> float:
        return self.budget_wh / self.levels

    def energy_level_index(self, energy_wh: ArrayLike) -> Ints:
        """Return the table row of a remaining energy: rounded down, clipped to the grid."""
        if self.energy_step_wh == 0.0:
            return np.zeros(np.shape(energy_wh), dtype=np.int64)
        raw = np.floor(np.asarray(energy_wh) / self.energy_step_wh + LEVEL_SLACK)
        return np.clip(raw, 0, self.levels).astype(np.int64)

    def with_level_count(self, level_count: int) -> "EdgeTransitionModel":
        """Return the same model on another grid."""
        cost, share = _level_costs_and_upper_shares(
            self.energy_wh, self.budget_wh, level_count, self.rounding
        )
        return replace(self, levels=level_count, cost_levels=cost, upper_share=share)


def build_edge_transition_model(
    graph: EnergyGraph,
    chain: WindChain,
    budget_wh: float,
    level_count: int,
    rounding: Rounding = Rounding.LINEAR,
    dtype: type = np.float32,
) -> EdgeTransitionModel:
    """Build the model on a grid of `level_count`. Tables are stored in `dtype`."""
    duration = graph.edge_duration_s(chain.states_en_mps)
    energy_wh = np.stack(
        [graph.edge_energy_wh(chain.states_en_mps, load) for load in (False, True)]
    )
    cost, share = _level_costs_and_upper_shares(energy_wh, budget_wh, level_count, rounding)
    return EdgeTransitionModel(
        graph=graph,
        chain=chain,
        budget_wh=budget_wh,
        levels=level_count,
        rounding=rounding,
        energy_wh=energy_wh,
        cost_levels=cost,
        upper_share=share,
        next_state=_next_state_probability(chain, duration, dtype),
    )


def _level_costs_and_upper_shares(
    energy_wh: Floats, budget_wh: float, level_count: int, rounding: Rounding
) -> tuple[ShortInts, Singles]:
    """Return whole levels (at least 1, so that every edge descends) and the upper level's share."""
    share = np.ones(energy_wh.shape, dtype=np.float32)
    if budget_wh == 0.0:
        return np.full(energy_wh.shape, INFEASIBLE_LEVELS), share
    usable = energy_wh <= budget_wh
    exact = np.where(usable, energy_wh, 0.0) * (level_count / budget_wh)
    cost = np.maximum(np.ceil(exact - LEVEL_SLACK), 1.0)
    if rounding is Rounding.LINEAR:
        share = np.where(cost > 1.0, np.clip(exact - (cost - 1.0), 0.0, 1.0), 1.0)
    return np.where(usable, cost, INFEASIBLE_LEVELS).astype(np.int32), share.astype(np.float32)


def _next_state_probability(chain: WindChain, duration_s: Floats, dtype: type) -> NDArray:
    """Return the probability of each state after each edge. Infeasible edges keep their state.

    In float32, rows can sum to slightly over 1, and a policy would fly in circles to gain from it.
    The rows are scaled so that every edge costs a little.
    """
    scale = 1.0 - (FLOAT32_EDGE_LOSS if dtype is np.float32 else 0.0)
    edges, states = duration_s.shape
    rows = np.empty((edges, states, states), dtype=dtype)
    state_index = np.arange(states)
    for begin in range(0, edges, 4096):
        part = duration_s[begin : begin + 4096]
        rows[begin : begin + 4096] = scale * chain.transition_probability_rows(
            state_index[None, :], np.where(np.isfinite(part), part, 0.0)
        )
    return rows
