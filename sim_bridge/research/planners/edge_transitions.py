"""One edge flown in one wind state, on a grid of energy: what the value tables are made of."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.core.base.arrays import Floats, Ints, ShortInts, Singles
from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.planners.markov_chain import WindChain

NEVER = np.int32(2**30)  # levels that an infeasible edge costs: more than any budget has
EDGE_COST_IN_SINGLE = 2e-6  # probability; float32 sums of 100 terms are off by some 5e-7
LEVEL_SLACK = 1e-9  # levels; keeps a whole number of levels whole when it is divided back


class Rounding(Enum):
    """How an edge's energy meets the grid.

    UP: a whole number of levels, never too few. What the table says is a lower bound, for sure.
    LINEAR: between the two whole numbers in proportion. Unbiased, so that 500 levels serve as
    well as thousands; what it promises is checked by flying it
    (`sim_bridge.research.planners.tuning`).
    """

    UP = "up"
    LINEAR = "linear"


@dataclass(frozen=True)
class StepModel:
    """Edges by wind states on `levels` steps of energy: what each costs, what wind comes next.

    Shapes: energy_wh (2, E, S) loaded and empty, infinite where infeasible; cost_levels (2, E, S)
    whole levels, rounded up; upper_share (2, E, S) weight of that number against one fewer;
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
    def step_wh(self) -> float:
        return self.budget_wh / self.levels

    def level(self, energy_wh: ArrayLike) -> Ints:
        """The table's row for an energy left: rounded down, clipped to the grid."""
        if self.step_wh == 0.0:
            return np.zeros(np.shape(energy_wh), dtype=np.int64)
        raw = np.floor(np.asarray(energy_wh) / self.step_wh + LEVEL_SLACK)
        return np.clip(raw, 0, self.levels).astype(np.int64)

    def on_grid(self, levels: int) -> "StepModel":
        """The same model on another grid."""
        cost, share = _on_grid(self.energy_wh, self.budget_wh, levels, self.rounding)
        return replace(self, levels=levels, cost_levels=cost, upper_share=share)


def build_step_model(
    graph: EnergyGraph,
    chain: WindChain,
    budget_wh: float,
    levels: int,
    rounding: Rounding = Rounding.LINEAR,
    dtype: type = np.float32,
) -> StepModel:
    """The model on a grid of `levels`; tables are kept in `dtype`."""
    duration = graph.duration_s(chain.states_en_mps)
    energy = np.stack([graph.energy_wh(chain.states_en_mps, load) for load in (False, True)])
    return step_model_of(graph, chain, energy, duration, budget_wh, levels, rounding, dtype)


def step_model_of(
    graph: EnergyGraph,
    chain: WindChain,
    energy_wh: Floats,
    duration_s: Floats,
    budget_wh: float,
    levels: int,
    rounding: Rounding = Rounding.LINEAR,
    dtype: type = np.float32,
) -> StepModel:
    """The same for edges with prices of their own: energy_wh (2, E, S), duration_s (E, S)."""
    cost, share = _on_grid(energy_wh, budget_wh, levels, rounding)
    return StepModel(
        graph=graph,
        chain=chain,
        budget_wh=budget_wh,
        levels=levels,
        rounding=rounding,
        energy_wh=energy_wh,
        cost_levels=cost,
        upper_share=share,
        next_state=_next_state(chain, duration_s, dtype),
    )


def _on_grid(
    energy_wh: Floats, budget_wh: float, levels: int, rounding: Rounding
) -> tuple[ShortInts, Singles]:
    """Whole levels, at least one so that every edge goes down the grid, and the upper's share."""
    share = np.ones(energy_wh.shape, dtype=np.float32)
    if budget_wh == 0.0:
        return np.full(energy_wh.shape, NEVER), share
    usable = energy_wh <= budget_wh
    exact = np.where(usable, energy_wh, 0.0) * (levels / budget_wh)
    cost = np.maximum(np.ceil(exact - LEVEL_SLACK), 1.0)
    if rounding is Rounding.LINEAR:
        share = np.where(cost > 1.0, np.clip(exact - (cost - 1.0), 0.0, 1.0), 1.0)
    return np.where(usable, cost, NEVER).astype(np.int32), share.astype(np.float32)


def _next_state(chain: WindChain, duration_s: Floats, dtype: type) -> NDArray:
    """Probability of each state after each edge; rows of infeasible edges keep their state.

    In float32 rows may sum to a hair over 1, and a policy would then fly in circles to gain on it:
    they are scaled so that every edge costs a little instead.
    """
    scale = 1.0 - (EDGE_COST_IN_SINGLE if dtype is np.float32 else 0.0)
    edges, states = duration_s.shape
    rows = np.empty((edges, states, states), dtype=dtype)
    own = np.arange(states)
    for begin in range(0, edges, 4096):
        part = duration_s[begin : begin + 4096]
        rows[begin : begin + 4096] = scale * chain.transition_rows(
            own[None, :], np.where(np.isfinite(part), part, 0.0)
        )
    return rows
