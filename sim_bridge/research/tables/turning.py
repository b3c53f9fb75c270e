"""Corners in the graph's mission model: what turning from edge to edge takes, and how sharp it is.

The graph has straight edges only (docs/reference/outcomes.md). Here each corner between two edges
is flown too: rounded (`dubins.corners`), or by stopping and accelerating again. Planners know a
typical worst cost of turning into an edge (`EnergyGraph.turning_s`). Vehicles pay for the corner
that they fly, in the wind at that moment.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import WH_PER_J, EnergyGraph
from companion.core.routing.planner_interface import Decider, Look
from sim_bridge.research.dubins.corners import (
    WINDOW_S,
    held_course,
    hover_turn_s,
    round_corners,
    stopping_s,
)
from sim_bridge.research.dubins.limits import FlightLimits
from sim_bridge.research.planners.markov_chain import WindChain
from sim_bridge.research.planners.mission_model import ChainWinds

ROOM = 0.5
"""Share of a leg that the corner at either end may use."""

ALLOWED_QUANTILE = 0.8
"""Of what turning into an edge costs from the edges before it: what planners count on. With the
median the gate lost three times its bound (seed 5, four days)."""


@dataclass(frozen=True)
class Turning:
    """How corners are flown: rounded at the limits, or by stopping at this acceleration."""

    limits: FlightLimits
    accel_mps2: float
    rounded: bool


@dataclass(frozen=True)
class Turned:
    """n corners: what they cost (s), how sharp they are (rad within 2 s), how far off (m)."""

    extra_s: Floats
    turn_rad: Floats
    off_m: Floats


def turned(
    graph: EnergyGraph, turning: Turning, before: Ints, after: Ints, wind_en_mps: Floats
) -> Turned:
    """The corners between pairs of edges, each in its wind (n, 2)."""
    course = np.arctan2(graph.course_en[:, 0], graph.course_en[:, 1])
    wind_ne = wind_en_mps[:, ::-1]
    speed = turning.limits.airspeed_mps
    headings = [held_course(course[edge], speed, wind_ne).heading_rad for edge in (before, after)]
    turn = np.abs(np.remainder(headings[1] - headings[0] + np.pi, 2.0 * np.pi) - np.pi)
    if not turning.rounded:
        return Turned(stopping_s(turn, speed, turning.accel_mps2), turn, np.zeros(len(turn)))
    room = ROOM * graph.length_m
    corners = round_corners(
        course[before], course[after], room[before], room[after], turning.limits, wind_ne
    )
    # Where no single turn fits, whichever is quicker: a Dubins path, or a hover and a slow turn.
    hover_s = hover_turn_s(turn, turning.limits, turning.accel_mps2)
    hovers = ~corners.cut & (hover_s < corners.extra_s)
    slow_rad = np.minimum(turn, turning.limits.turn_rate_rps * WINDOW_S)
    return Turned(
        np.where(hovers, hover_s, corners.extra_s),
        np.where(hovers, slow_rad, corners.turn_rad),
        np.where(hovers, 0.0, corners.off_m),
    )


def with_turning(graph: EnergyGraph, turning: Turning) -> EnergyGraph:
    """The graph whose edges cost what turning into them does in calm air, by most ways in.

    Ways straight back are left out: no route takes them. Edges out of depot and target begin from
    a hover.
    """
    before, after = np.nonzero(graph.head[:, None] == graph.tail[None, :])
    forth = graph.tail[before] != graph.head[after]
    before, after = before[forth], after[forth]
    calm = turned(graph, turning, before, after, np.zeros((len(before), 2)))
    allowed = np.zeros(graph.edge_count)
    for edge in np.unique(after):
        allowed[edge] = np.quantile(calm.extra_s[after == edge], ALLOWED_QUANTILE)
    hover = np.isin(graph.tail, (graph.depot, graph.target))
    return replace(graph, turning_s=np.where(hover, 0.0, allowed))


class TurningWinds:
    """Winds of a chain over a graph `with_turning`, where every corner costs what it does."""

    def __init__(self, winds: ChainWinds, graph: EnergyGraph, chain: WindChain, how: Turning):
        self._winds, self._graph, self._chain, self._how = winds, graph, chain, how
        self._before = np.full(winds.count, -1, dtype=np.int64)
        self._power_wh_per_s = np.asarray(graph.power_w) * WH_PER_J
        self._straight_s = replace(graph, turning_s=None).duration_s(chain.states_en_mps)
        self.unforeseen_wh = np.zeros(winds.count)
        self.turn_rad = np.full(winds.count, np.nan)
        self.off_m = np.zeros(winds.count)

    @property
    def count(self) -> int:
        return self._winds.count

    def look(self, mission: Ints, time_s: Floats) -> tuple[Ints, Floats]:
        return self._winds.look(mission, time_s)

    def fly(
        self, mission: Ints, edge: Ints, time_s: Floats, energy_wh: Floats, delivered: NDArray
    ) -> tuple[Floats, Floats]:
        planned_s, _ = self._winds.fly(mission, edge, time_s, energy_wh, delivered)
        state = self._winds.state_at(mission, time_s)
        took_s = self._straight_s[edge, state]
        hover = np.isin(self._graph.tail[edge], (self._graph.depot, self._graph.target))
        turns = np.flatnonzero((self._before[mission] >= 0) & ~hover)
        if len(turns):
            at = mission[turns]
            corner = turned(
                self._graph,
                self._how,
                self._before[at],
                edge[turns],
                self._chain.states_en_mps[state[turns]],
            )
            took_s[turns] = np.maximum(took_s[turns] + corner.extra_s, 0.0)
            self.turn_rad[at] = np.fmax(self.turn_rad[at], corner.turn_rad)
            self.off_m[at] = np.maximum(self.off_m[at], corner.off_m)
        self._before[mission] = edge
        power = self._power_wh_per_s[delivered.astype(np.int64)]
        self.unforeseen_wh[mission] = (took_s - planned_s) * power
        return took_s, took_s * power


class AsPlanned:
    """Shows a planner its energy as its own edge costs explain it, never more than there is.

    A planner tells a hidden wind by what an edge used; a corner dearer or cheaper than the average
    must not look like another wind. Where corners were dearer it is shown the truth instead.
    """

    def __init__(self, decider: Decider, winds: TurningWinds) -> None:
        self._decider, self._winds = decider, winds
        self._kept_wh = np.zeros(winds.count)  # held back so far

    def decide(self, look: Look) -> NDArray[np.int64]:
        at = look.mission
        kept = self._kept_wh[at] - self._winds.unforeseen_wh[at]
        self._kept_wh[at] = np.maximum(kept, 0.0)
        self._winds.unforeseen_wh[at] = 0.0
        return self._decider.decide(
            replace(look, energy_wh=np.maximum(look.energy_wh - self._kept_wh[at], 0.0))
        )
