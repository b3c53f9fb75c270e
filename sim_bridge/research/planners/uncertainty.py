"""`Unc(e, w)`: uncertainty of an edge's energy at the time when the planner would fly it.

The time until an edge is flown is that of the straight line to its tail at airspeed.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.planners.markov_chain import OrnsteinUhlenbeckWind, Sight, WindChain

LAG_STEP_S = 5.0  # s; short against dwell times, so a chain's spread changes little within it


class Uncertainty(Protocol):
    """Source of the planner's wind distribution."""

    def duration_std_s(self, origin: Ints, wind_index: Ints, wind_en_mps: Floats) -> Floats:
        """Return the std of each edge's duration, s, planned from `origin` (n,); shape (E, n)."""
        ...


def lag_until_edge_s(graph: EnergyGraph, origin: Ints) -> Floats:
    """Return seconds until each edge can start, from each origin (n,), in calm; shape (E, n)."""
    tails = graph.vertices_m[graph.tail][:, None, :]
    span = tails - graph.vertices_m[origin][None, :, :]
    return np.sqrt(np.sum(span**2, axis=2)) / graph.airspeed_mps


@dataclass(frozen=True)
class ChainUncertainty:
    """Uncertainty of a known chain: its spread after the lag, given the observed wind.

    An edge that is infeasible in some state counts with the longest duration there.
    """

    graph: EnergyGraph
    chain: WindChain
    sight: Sight
    longest_s: float

    @cached_property
    def _duration_std_by_lag_s(self) -> Floats:
        """Return the std of each edge's duration by lag step and wind seen; (L, O, E)."""
        span = self.graph.vertices_m.max(axis=0) - self.graph.vertices_m.min(axis=0)
        max_lag_s = float(np.hypot.reduce(span)) / self.graph.airspeed_mps
        steps = int(min(max_lag_s, self.longest_s) / LAG_STEP_S) + 2
        duration = np.minimum(
            self.graph.edge_duration_s(self.chain.states_en_mps), self.longest_s
        ).T
        prior = state_probability_by_observed_wind(self.chain, self.sight)
        jump = self.chain.transition_matrix(LAG_STEP_S)
        std = np.empty((steps, self.sight.observed_wind_count, self.graph.edge_count))
        middle = duration.mean(axis=0)
        for step in range(steps):
            mean = prior @ (duration - middle)
            second = prior @ (duration - middle) ** 2
            std[step] = np.sqrt(np.maximum(second - mean**2, 0.0))
            std[step][std[step] < 1e-6 * middle] = 0.0  # removes rounding errors
            prior = prior @ jump
        return std

    def duration_std_s(self, origin: Ints, wind_index: Ints, wind_en_mps: Floats) -> Floats:
        table = self._duration_std_by_lag_s
        step = np.minimum(lag_until_edge_s(self.graph, origin) / LAG_STEP_S + 0.5, len(table) - 1)
        return table[
            step.astype(np.int64), wind_index[None, :], np.arange(self.graph.edge_count)[:, None]
        ]


def state_probability_by_observed_wind(chain: WindChain, sight: Sight) -> Floats:
    """Return P(state) given each wind seen, from the chain's initial distribution; (O, S)."""
    member = sight.of_state[None, :] == np.arange(sight.observed_wind_count)[:, None]
    share = np.where(member, chain.initial, 0.0)
    total = share.sum(axis=1, keepdims=True)
    even = member / member.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, share / np.where(total > 0.0, total, 1.0), even)


@dataclass(frozen=True)
class DriftUncertainty:
    """Uncertainty of an Ornstein-Uhlenbeck wind: |dE/dw| with its covariance after the lag.

    `sector_rad` is the width of the sectors that hide the direction, 0 without sectors.
    """

    graph: EnergyGraph
    process: OrnsteinUhlenbeckWind
    longest_s: float
    sector_rad: float = 0.0

    def duration_std_s(self, origin: Ints, wind_index: Ints, wind_en_mps: Floats) -> Floats:
        variance = self.process.predictive_variance_m2ps2(lag_until_edge_s(self.graph, origin))
        speed = np.hypot(wind_en_mps[:, 0], wind_en_mps[:, 1])
        variance = variance + (speed * self.sector_rad) ** 2 / 12.0
        slope = duration_sensitivity_to_wind_s2pm(self.graph, wind_en_mps)
        return np.minimum(np.sqrt(variance) * slope, self.longest_s)


def duration_sensitivity_to_wind_s2pm(graph: EnergyGraph, wind_en_mps: Floats) -> Floats:
    """|d duration / dw| of each edge at each wind (n, 2), s per m/s; 0 where infeasible; (E, n)."""
    speed = graph.edge_ground_speed_mps(wind_en_mps)
    normal = np.stack(
        [-graph.edge_course_unit_vector_en[:, 1], graph.edge_course_unit_vector_en[:, 0]], axis=1
    )
    across = normal @ wind_en_mps.T
    head = np.sqrt(np.maximum(graph.airspeed_mps**2 - across**2, 1e-6))
    with np.errstate(invalid="ignore"):
        slope = graph.edge_length_m[:, None] / speed**2 * np.sqrt(1.0 + (across / head) ** 2)
    return np.where(np.isnan(slope), 0.0, slope)


@dataclass(frozen=True)
class RiskCost:
    """Surrogate cost of the paper: `EnergyCost(e, w) + lambda Unc(e, w)`."""

    graph: EnergyGraph
    risk_weight: float
    uncertainty: Uncertainty

    def depends_on_origin(self) -> bool:
        """Return True if an edge's cost differs by the vertex that it is planned from."""
        return self.risk_weight > 0.0

    def surrogate_duration_s(self, origin: Ints, wind_index: Ints, wind_en_mps: Floats) -> Floats:
        """Surrogate cost over power: seconds; infinite where infeasible; (E, n)."""
        duration = self.graph.edge_duration_s(wind_en_mps)
        if self.risk_weight == 0.0:
            return duration
        spread = self.uncertainty.duration_std_s(origin, wind_index, wind_en_mps)
        return duration + self.risk_weight * spread
