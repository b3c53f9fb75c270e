"""Corners in the graph's mission model: duration and sharpness of the turn between two edges.

The graph has straight edges only (docs/reference/outcomes.md). Here each corner between two edges
is also flown: rounded (`dubins.corners`), or by stopping and accelerating. Planners use a typical
worst cost of turning into an edge (stored in `EnergyGraph`). Vehicles pay for the corner that they
fly, in the current wind.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import WH_PER_J, EnergyGraph
from companion.core.routing.planner_interface import BatchPlanner, PlannerObservation
from sim_bridge.research.dubins.corners import (
    WINDOW_S,
    round_corners,
    solve_wind_triangle,
    stop_and_yaw_time_loss_s,
    unrounded_corner_time_loss_s,
)
from sim_bridge.research.dubins.level_paths import FlightLimits
from sim_bridge.research.planners.markov_chain import WindChain
from sim_bridge.research.planners.mission_model import ChainWinds

CORNER_LEG_SHARE = 0.5
"""Share of a leg that the corner at either end can use."""

ALLOWED_QUANTILE = 0.8
"""Quantile, over preceding edges, of the cost of turning into an edge, as planned. With the median
the gate lost three times its bound (seed 5, four days)."""


@dataclass(frozen=True)
class CornerModel:
    """Corner model: rounded at the limits, or by stopping at this acceleration."""

    limits: FlightLimits
    accel_mps2: float
    rounded: bool


@dataclass(frozen=True)
class CornerCosts:
    """n corners: cost (s), sharpness (rad within 2 s), distance from the waypoint (m)."""

    extra_s: Floats
    turn_rad: Floats
    off_m: Floats


def corner_costs_between_edges(
    graph: EnergyGraph,
    corner_model: CornerModel,
    incoming_edge: Ints,
    outgoing_edge: Ints,
    wind_en_mps: Floats,
) -> CornerCosts:
    """Compute the corners between pairs of edges, each in its wind (n, 2)."""
    course = np.arctan2(
        graph.edge_course_unit_vector_en[:, 0], graph.edge_course_unit_vector_en[:, 1]
    )
    wind_ne = wind_en_mps[:, ::-1]
    speed = corner_model.limits.airspeed_mps
    headings = [
        solve_wind_triangle(course[edge], speed, wind_ne).heading_rad
        for edge in (incoming_edge, outgoing_edge)
    ]
    turn = np.abs(np.remainder(headings[1] - headings[0] + np.pi, 2.0 * np.pi) - np.pi)
    if not corner_model.rounded:
        return CornerCosts(
            unrounded_corner_time_loss_s(turn, speed, corner_model.accel_mps2),
            turn,
            np.zeros(len(turn)),
        )
    available_m = CORNER_LEG_SHARE * graph.edge_length_m
    corners = round_corners(
        course[incoming_edge],
        course[outgoing_edge],
        available_m[incoming_edge],
        available_m[outgoing_edge],
        corner_model.limits,
        wind_ne,
    )
    # Where no single turn fits, the faster one: a Dubins path, or a hover and a slow turn.
    hover_s = stop_and_yaw_time_loss_s(turn, corner_model.limits, corner_model.accel_mps2)
    hovers = ~corners.cut & (hover_s < corners.extra_s)
    slow_rad = np.minimum(turn, corner_model.limits.turn_rate_rps * WINDOW_S)
    return CornerCosts(
        np.where(hovers, hover_s, corners.extra_s),
        np.where(hovers, slow_rad, corners.turn_rad),
        np.where(hovers, 0.0, corners.off_m),
    )


def graph_with_calm_corner_costs(graph: EnergyGraph, corner_model: CornerModel) -> EnergyGraph:
    """Return the graph with the cost of turning into each edge in calm air (a quantile).

    Turns straight back are excluded, because no route uses them. Edges out of depot and target
    start from a hover and cost no turn.
    """
    before, after = np.nonzero(graph.head[:, None] == graph.tail[None, :])
    not_reversed = graph.tail[before] != graph.head[after]
    before, after = before[not_reversed], after[not_reversed]
    calm = corner_costs_between_edges(
        graph, corner_model, before, after, np.zeros((len(before), 2))
    )
    allowed = np.zeros(graph.edge_count)
    for edge in np.unique(after):
        allowed[edge] = np.quantile(calm.extra_s[after == edge], ALLOWED_QUANTILE)
    hover = np.isin(graph.tail, (graph.depot, graph.target))
    return replace(graph, turn_s=np.where(hover, 0.0, allowed))


class CornerWinds:
    """Winds of a chain over a graph with corner costs, with the actual cost of every corner."""

    def __init__(
        self, winds: ChainWinds, graph: EnergyGraph, chain: WindChain, corner_model: CornerModel
    ):
        self._winds, self._graph, self._chain, self._corner_model = (
            winds,
            graph,
            chain,
            corner_model,
        )
        self._before = np.full(winds.mission_count, -1, dtype=np.int64)
        self._power_wh_per_s = np.asarray(graph.power_w) * WH_PER_J
        self._straight_s = replace(graph, turn_s=None).edge_duration_s(chain.states_en_mps)
        self.unpredicted_wh = np.zeros(winds.mission_count)
        self.turn_rad = np.full(winds.mission_count, np.nan)
        self.off_m = np.zeros(winds.mission_count)

    @property
    def mission_count(self) -> int:
        return self._winds.mission_count

    def observe_wind_index_and_vector(
        self, mission_index: Ints, time_s: Floats
    ) -> tuple[Ints, Floats]:
        return self._winds.observe_wind_index_and_vector(mission_index, time_s)

    def edge_durations_s_and_energies_wh(
        self, mission: Ints, edge: Ints, time_s: Floats, remaining_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        planned_s, _ = self._winds.edge_durations_s_and_energies_wh(
            mission, edge, time_s, remaining_wh, delivered
        )
        state = self._winds.advance_to_states_at(mission, time_s)
        elapsed_s = self._straight_s[edge, state]
        hover = np.isin(self._graph.tail[edge], (self._graph.depot, self._graph.target))
        cornering = np.flatnonzero((self._before[mission] >= 0) & ~hover)
        if len(cornering):
            at = mission[cornering]
            corner = corner_costs_between_edges(
                self._graph,
                self._corner_model,
                self._before[at],
                edge[cornering],
                self._chain.states_en_mps[state[cornering]],
            )
            elapsed_s[cornering] = np.maximum(elapsed_s[cornering] + corner.extra_s, 0.0)
            self.turn_rad[at] = np.fmax(self.turn_rad[at], corner.turn_rad)
            self.off_m[at] = np.maximum(self.off_m[at], corner.off_m)
        self._before[mission] = edge
        power = self._power_wh_per_s[delivered.astype(np.int64)]
        self.unpredicted_wh[mission] = (elapsed_s - planned_s) * power
        return elapsed_s, elapsed_s * power


class PredictedEnergyPlanner:
    """Shows a planner its energy as predicted by its own edge costs, never more than the true one.

    A planner infers a hidden wind from the energy that an edge used. A corner that costs more or
    less than average must not look like another wind. Where corners cost more, it sees the truth.
    """

    def __init__(self, decider: BatchPlanner, winds: CornerWinds) -> None:
        self._decider, self._winds = decider, winds
        self._withheld_wh = np.zeros(winds.mission_count)  # withheld so far

    def select_edges(self, observation: PlannerObservation) -> NDArray[np.int64]:
        at = observation.mission
        withheld_wh = self._withheld_wh[at] - self._winds.unpredicted_wh[at]
        self._withheld_wh[at] = np.maximum(withheld_wh, 0.0)
        self._winds.unpredicted_wh[at] = 0.0
        return self._decider.select_edges(
            replace(
                observation,
                energy_wh=np.maximum(observation.energy_wh - self._withheld_wh[at], 0.0),
            )
        )
