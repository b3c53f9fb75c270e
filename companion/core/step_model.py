"""One edge flown in one wind state, on a grid of energy: what the value tables are made of."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.energy_graph import EnergyGraph
from companion.core.wind_chain import WindChain

Floats = NDArray[np.float64]
NEVER = np.int32(2**30)  # levels that an infeasible edge costs: more than any budget has
LEVEL_SLACK = 1e-9  # levels; keeps a whole number of levels whole when it is divided back

TABLE_BYTES_IN_DOUBLE = 64e6  # value tables up to this size are kept in float64


@dataclass(frozen=True)
class StepModel:
    """Edges by wind states on `levels` steps of `step_wh`: cost rounded up, next wind state.

    Rounding up is what makes the tables safe: energy that the table says is left, is left.
    Shapes: cost_levels (2, E, S) loaded and empty; energy_wh (2, E, S); next_state (E, S, S).
    """

    graph: EnergyGraph
    chain: WindChain
    budget_wh: float
    levels: int
    energy_wh: Floats
    cost_levels: NDArray[np.int32]
    next_state: NDArray

    @property
    def step_wh(self) -> float:
        return self.budget_wh / self.levels

    def level(self, energy_wh: Floats) -> NDArray[np.int64]:
        """The table's row for an energy left: rounded down, clipped to the grid."""
        if self.step_wh == 0.0:
            return np.zeros(np.shape(energy_wh), dtype=np.int64)
        raw = np.floor(np.asarray(energy_wh) / self.step_wh + LEVEL_SLACK)
        return np.clip(raw, 0, self.levels).astype(np.int64)


def build_step_model(
    graph: EnergyGraph, chain: WindChain, budget_wh: float, levels: int, dtype: type | None = None
) -> StepModel:
    """The model on a grid of `levels`; `dtype` of the tables, by their size when None."""
    if dtype is None:
        bytes_in_double = 8.0 * (levels + 1) * graph.vertex_count * chain.state_count
        dtype = np.float64 if bytes_in_double <= TABLE_BYTES_IN_DOUBLE else np.float32
    duration = graph.duration_s(chain.states_en_mps)
    energy = np.stack([graph.energy_wh(chain.states_en_mps, load) for load in (False, True)])
    return StepModel(
        graph=graph,
        chain=chain,
        budget_wh=budget_wh,
        levels=levels,
        energy_wh=energy,
        cost_levels=_rounded_up(energy, budget_wh, levels),
        next_state=_next_state(chain, duration, dtype),
    )


def _rounded_up(energy_wh: Floats, budget_wh: float, levels: int) -> NDArray[np.int32]:
    """Whole levels, at least one, so that every edge goes down the grid."""
    if budget_wh == 0.0:
        return np.full(energy_wh.shape, NEVER)
    usable = energy_wh <= budget_wh * (1.0 + 1e-12)
    raw = np.ceil(np.where(usable, energy_wh, 0.0) * (levels / budget_wh) - LEVEL_SLACK)
    return np.where(usable, np.maximum(raw, 1.0), NEVER).astype(np.int32)


def _next_state(chain: WindChain, duration_s: Floats, dtype: type) -> NDArray:
    """Probability of each state after each edge; rows of infeasible edges keep their state."""
    edges, states = duration_s.shape
    rows = np.empty((edges, states, states), dtype=dtype)
    own = np.arange(states)
    for begin in range(0, edges, 4096):
        part = duration_s[begin : begin + 4096]
        rows[begin : begin + 4096] = chain.transition_rows(
            own[None, :], np.where(np.isfinite(part), part, 0.0)
        )
    return rows
