"""`Unc(e, w)`: how far an edge's energy may stray by the time that the planner would fly it.

The time until an edge is flown is that of the straight line to its tail at airspeed.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import WH_PER_J, EnergyGraph
from sim_bridge.research.planners.markov_chain import OrnsteinUhlenbeckWind, Sight, WindChain

LAG_STEP_S = 5.0  # a chain's spread changes little within it: dwell times are longer


class Uncertainty(Protocol):
    """Where the planner's wind distribution comes from."""

    def duration_std_s(self, origin: Ints, seen: Ints, wind_en_mps: Floats) -> Floats:
        """Std of each edge's duration, s, seen from `origin` (n,); shape (E, n)."""
        ...


def lag_s(graph: EnergyGraph, origin: Ints) -> Floats:
    """Seconds until each edge could begin, from each origin (n,), in calm; shape (E, n)."""
    tails = graph.vertices_m[graph.tail][:, None, :]
    span = tails - graph.vertices_m[origin][None, :, :]
    return np.sqrt(np.sum(span**2, axis=2)) / graph.airspeed_mps


@dataclass(frozen=True)
class ChainUncertainty:
    """Under a known chain: the chain's own spread after the lag, from what is seen now.

    An edge that some state makes infeasible counts as taking all the time that there is.
    """

    graph: EnergyGraph
    chain: WindChain
    sight: Sight
    longest_s: float

    @cached_property
    def _std_by_lag_s(self) -> Floats:
        """Std of each edge's duration by lag step and wind seen; (L, O, E)."""
        span = self.graph.vertices_m.max(axis=0) - self.graph.vertices_m.min(axis=0)
        reach_s = float(np.hypot.reduce(span)) / self.graph.airspeed_mps
        steps = int(min(reach_s, self.longest_s) / LAG_STEP_S) + 2
        duration = np.minimum(self.graph.duration_s(self.chain.states_en_mps), self.longest_s).T
        prior = seen_prior(self.chain, self.sight)
        jump = self.chain.transition(LAG_STEP_S)
        std = np.empty((steps, self.sight.count, self.graph.edge_count))
        middle = duration.mean(axis=0)
        for step in range(steps):
            mean = prior @ (duration - middle)
            second = prior @ (duration - middle) ** 2
            std[step] = np.sqrt(np.maximum(second - mean**2, 0.0))
            std[step][std[step] < 1e-6 * middle] = 0.0  # rounding, not spread
            prior = prior @ jump
        return std

    def duration_std_s(self, origin: Ints, seen: Ints, wind_en_mps: Floats) -> Floats:
        table = self._std_by_lag_s
        step = np.minimum(lag_s(self.graph, origin) / LAG_STEP_S + 0.5, len(table) - 1)
        return table[
            step.astype(np.int64), seen[None, :], np.arange(self.graph.edge_count)[:, None]
        ]


def seen_prior(chain: WindChain, sight: Sight) -> Floats:
    """Shares of the states behind each wind seen, by the chain's initial shares; (O, S)."""
    member = sight.of_state[None, :] == np.arange(sight.count)[:, None]
    share = np.where(member, chain.initial, 0.0)
    total = share.sum(axis=1, keepdims=True)
    even = member / member.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, share / np.where(total > 0.0, total, 1.0), even)


@dataclass(frozen=True)
class DriftUncertainty:
    """Under an Ornstein-Uhlenbeck wind: |dE/dw| under its covariance after the lag.

    `sector_rad` is the width of the sectors that hide the direction, 0 where none do.
    """

    graph: EnergyGraph
    process: OrnsteinUhlenbeckWind
    longest_s: float
    sector_rad: float = 0.0

    def duration_std_s(self, origin: Ints, seen: Ints, wind_en_mps: Floats) -> Floats:
        variance = self.process.predictive_cov_m2ps2(lag_s(self.graph, origin))[..., 0, 0]
        speed = np.hypot(wind_en_mps[:, 0], wind_en_mps[:, 1])
        variance = variance + (speed * self.sector_rad) ** 2 / 12.0
        slope = duration_slope_s2pm(self.graph, wind_en_mps)
        return np.minimum(np.sqrt(variance) * slope, self.longest_s)


def duration_slope_s2pm(graph: EnergyGraph, wind_en_mps: Floats) -> Floats:
    """|d duration / dw| of each edge at each wind (n, 2), s per m/s; 0 where infeasible; (E, n)."""
    speed = graph.ground_speed_mps(wind_en_mps)
    normal = np.stack([-graph.course_en[:, 1], graph.course_en[:, 0]], axis=1)
    across = normal @ wind_en_mps.T
    head = np.sqrt(np.maximum(graph.airspeed_mps**2 - across**2, 1e-6))
    with np.errstate(invalid="ignore"):
        slope = graph.length_m[:, None] / speed**2 * np.sqrt(1.0 + (across / head) ** 2)
    return np.where(np.isnan(slope), 0.0, slope)


@dataclass(frozen=True)
class RiskCost:
    """The surrogate cost of the paper: `EnergyCost(e, w) + lambda Unc(e, w)`."""

    graph: EnergyGraph
    risk_weight: float
    uncertainty: Uncertainty | None

    def depends_on_origin(self) -> bool:
        """True when the same edge costs differently seen from different vertices."""
        return self.risk_weight > 0.0 and self.uncertainty is not None

    def duration_s(self, origin: Ints, seen: Ints, wind_en_mps: Floats) -> Floats:
        """Surrogate cost over power: seconds; infinite where infeasible; (E, n)."""
        duration = self.graph.duration_s(wind_en_mps)
        if self.uncertainty is None or self.risk_weight == 0.0:
            return duration
        spread = self.uncertainty.duration_std_s(origin, seen, wind_en_mps)
        return duration + self.risk_weight * spread

    def power_wh_per_s(self, delivered: ArrayLike) -> Floats:
        """Wh per second, by load."""
        return np.asarray(self.graph.power_w)[np.asarray(delivered, dtype=int)] * WH_PER_J
