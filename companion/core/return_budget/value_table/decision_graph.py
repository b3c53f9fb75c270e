"""The airframe's own decision graph: what the mission aboard can be jumped to, and what it takes.

Vertices: a virtual home (the solver's depot: whoever is there has landed), the last account, over
the depot, the outbound waypoints, the drop (the solver's target), the return waypoints. An edge is
flown loaded or empty, never both, so that each has its own energy and duration. Every landing ends
at the last account, where the wind no longer matters: its states there are the faces of a die that
draws the battery's own error, and the edge to home costs what was drawn. Energy is counted from
`ACCOUNT_STDS` of that error below the reserve, so that no price is negative.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned, over
from companion.core.return_budget.value_table.edge_transitions import (
    Rounding,
    StepModel,
    step_model_of,
)
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy, cruise_legs
from companion.core.routing.route_planner import Plan
from companion.core.wind.markov_chain import WindChain

HOME, ACCOUNT, OVER_DEPOT = 0, 1, 2
ACCOUNT_STDS = 3.5  # the die's reach: the rest, 0.02 % on either side, counts as its last faces


@dataclass(frozen=True, slots=True)
class Edge:
    """Legs flown in one go, and the leg flown before them (for the time lost in turns)."""

    tail: int
    head: int
    empty: bool
    legs: tuple[Leg, ...]
    before: Leg | None = None


@dataclass(frozen=True)
class MissionGraph:
    """The edges of one mission, sorted by (tail, head), and where things are among its vertices."""

    edges: tuple[Edge, ...]
    vertices_ned_m: tuple[Ned, ...]
    outbound: tuple[int, ...]
    drop: int

    @property
    def decision_points(self) -> tuple[int, ...]:
        """Over the depot and the outbound waypoints: where leave to go on is given."""
        return (OVER_DEPOT, *self.outbound)

    @cached_property
    def onward(self) -> tuple[int, ...]:
        """From each decision point the edge to the next; the last one's leads to the drop."""
        ends = (*self.outbound, self.drop)
        by_ends = {(e.tail, e.head): i for i, e in enumerate(self.edges) if not e.empty}
        return tuple(by_ends[pair] for pair in zip(self.decision_points, ends, strict=True))

    def energy_graph(self, route_energy: RouteEnergy) -> EnergyGraph:
        """The graph for the solver, and to draw."""
        parcel = max(leg.payload_kg for edge in self.edges for leg in edge.legs)
        north, east, down = np.array(self.vertices_ned_m).T
        return EnergyGraph(
            vertices_m=np.column_stack([east, north, -down]),
            tail=np.array([e.tail for e in self.edges]),
            head=np.array([e.head for e in self.edges]),
            depot=HOME,
            target=self.drop,
            airspeed_mps=route_energy.cruise_airspeed_mps,
            power_w=(route_energy.hover_power_w(parcel), route_energy.hover_power_w(0.0)),
        )


def build_mission_graph(
    plan: Plan, payload_kg: float, drop_height_m: float, drop_s: float
) -> MissionGraph:
    """The graph of a plan, from over the depot with the wind measured to the ground."""
    return _Builder(plan, payload_kg, drop_height_m, drop_s).graph()


class _Builder:
    """Lays the edges out; vertices are numbered in the order of the module's first lines."""

    def __init__(self, plan: Plan, payload_kg: float, drop_height_m: float, drop_s: float) -> None:
        self._plan, self._parcel = plan, payload_kg
        count = len(plan.outbound_ned_m)
        self._out = tuple(range(OVER_DEPOT + 1, OVER_DEPOT + 1 + count))
        self._drop = OVER_DEPOT + 1 + count
        self._back = tuple(range(self._drop + 1, self._drop + 1 + len(plan.return_ned_m)))
        last = plan.outbound_ned_m[-1]
        self._low = (last[0], last[1], plan.customer_ned_m[2] - drop_height_m)
        self._level = plan.return_ned_m[-1]
        self._drop_s = drop_s
        self._start = over(plan.depot_ned_m, plan.outbound_ned_m[0])

    def graph(self) -> MissionGraph:
        plan = self._plan
        edges = [*self._outward(), *self._delivery()]
        for empty in (False, True):
            edges += self._homeward(empty)
        edges += [Edge(ACCOUNT, HOME, empty, ()) for empty in (False, True)]
        return MissionGraph(
            edges=tuple(sorted(edges, key=lambda e: (e.tail, e.head))),
            vertices_ned_m=(
                plan.depot_ned_m,
                plan.depot_ned_m,
                self._start,
                *plan.outbound_ned_m,
                self._low,
                *plan.return_ned_m,
            ),
            outbound=self._out,
            drop=self._drop,
        )

    def _outward(self) -> list[Edge]:
        """Loaded: onward, into the return branch, to a rally point, from every decision point."""
        plan = self._plan
        edges = [Edge(OVER_DEPOT, ACCOUNT, False, self._not_gone())]
        here, tail, before = self._start, OVER_DEPOT, None
        for i, there in enumerate(plan.outbound_ned_m):
            onward = self._cruise(here, there, False)
            edges.append(Edge(tail, self._out[i], False, onward, before))
            here, tail, before = there, self._out[i], (onward[-1] if onward else before)
            edges += self._turning(i, False, self._change(there), before)
        return edges

    def _not_gone(self) -> tuple[Leg, ...]:
        """Home from over the launch pad: straight down, or to where it is."""
        points = (*self._plan.away_ned_m, self._plan.return_ned_m[-1])
        legs = [leg for a, b in pairwise(points) for leg in self._cruise(a, b, False)]
        above = points[-1] if self._plan.layered or legs else self._start
        return (*self._change(self._start), *legs, self._land(above, False))

    def _change(self, here: Ned) -> tuple[Leg, ...]:
        """From the layer of the way out to that of the way back, loaded; none if they are one."""
        if not self._plan.layered:
            return ()
        kind = LegKind.CLIMB if self._level[2] < here[2] else LegKind.DESCEND
        return (Leg(kind, here, over(here, self._level), self._parcel),)

    def _turning(
        self, i: int, empty: bool, change: tuple[Leg, ...], before: Leg | None
    ) -> list[Edge]:
        """Ways home from an outbound waypoint (empty: once more over the customer)."""
        plan, tail = self._plan, self._out[i]
        here = over(plan.outbound_ned_m[i], self._level)
        entry = plan.entry[i]
        joining = (*change, *self._cruise(here, plan.return_ned_m[entry], empty))
        edges = [Edge(tail, self._back[entry], empty, joining, before)]
        for rally in plan.rally:
            if i in rally.from_outbound:
                legs = (*change, *self._to_rally(here, rally.ground_ned_m, empty))
                edges.append(Edge(tail, ACCOUNT, empty, legs, before))
        return edges

    def _delivery(self) -> list[Edge]:
        """Down and the drop, loaded; up again and home, empty."""
        above, low, last = self._plan.outbound_ned_m[-1], self._low, self._out[-1]
        down = (
            Leg(LegKind.DESCEND, above, low, self._parcel),
            Leg(LegKind.HOVER, low, low, self._parcel, self._drop_s),
        )
        up = Leg(LegKind.CLIMB, low, self._plan.over_customer_ned_m, 0.0)
        return [
            Edge(last, self._drop, False, down),
            Edge(self._drop, last, True, (up,), down[-1]),
            *self._turning(len(self._out) - 1, True, (), up),
        ]

    def _homeward(self, empty: bool) -> list[Edge]:
        """Along the return branch to its end, or to a rally point that is seen from it."""
        points, edges = self._plan.return_ned_m, list[Edge]()
        before: Leg | None = None
        for j, here in enumerate(points):
            edges += [
                Edge(
                    self._back[j],
                    ACCOUNT,
                    empty,
                    self._to_rally(here, r.ground_ned_m, empty),
                    before,
                )
                for r in self._plan.rally
                if j in r.from_return
            ]
            if j + 1 < len(points):
                legs = self._cruise(here, points[j + 1], empty)
                edges.append(Edge(self._back[j], self._back[j + 1], empty, legs, before))
                before = legs[-1] if legs else before
        landing = (self._land(points[-1], empty),)
        edges.append(Edge(self._back[-1], ACCOUNT, empty, landing, before))
        return edges

    def _cruise(self, a: Ned, b: Ned, empty: bool) -> tuple[Leg, ...]:
        return cruise_legs(a, b, 0.0 if empty else self._parcel)

    def _to_rally(self, here: Ned, ground: Ned, empty: bool) -> tuple[Leg, ...]:
        above = over(ground, here)
        land = Leg(LegKind.LAND, above, ground, 0.0 if empty else self._parcel)
        return (*self._cruise(here, above, empty), land)

    def _land(self, above: Ned, empty: bool) -> Leg:
        return Leg(LegKind.LAND, above, self._plan.landing_ned_m, 0.0 if empty else self._parcel)


@dataclass(frozen=True)
class EdgePrices:
    """Wh and seconds of every edge in every wind of a chain, (E, S) each."""

    energy_wh: Floats
    time_s: Floats


def price_edges(graph: MissionGraph, route_energy: RouteEnergy, chain: WindChain) -> EdgePrices:
    """The edges as the gate prices its legs; the last account is priced by `step_model`."""
    legs = tuple(leg for edge in graph.edges for leg in edge.legs)
    before = tuple(b for edge in graph.edges for b in (edge.before, *edge.legs)[: len(edge.legs)])
    costs = route_energy.costs(
        route_energy.compile(legs, before), np.ascontiguousarray(chain.states_en_mps[:, ::-1])
    )
    owner = np.repeat(np.arange(len(graph.edges)), [len(edge.legs) for edge in graph.edges])
    shape = (len(graph.edges), chain.state_count)
    energy, time = np.zeros(shape), np.zeros(shape)
    np.add.at(energy, owner, costs.energy_wh.T)
    np.add.at(time, owner, costs.time_s.T)
    return EdgePrices(energy, time)


def step_model(
    graph: MissionGraph,
    prices: EdgePrices,
    route_energy: RouteEnergy,
    chain: WindChain,
    budget_wh: float,
    battery_std_wh: float,
    levels: int,
    rounding: Rounding = Rounding.LINEAR,
) -> StepModel:
    """The solver's model. `budget_wh`: above the reserve, in the energy model's own Wh.

    The grid reaches from `ACCOUNT_STDS` of the battery's error below the reserve to the budget.
    """
    faces, weight = _die(chain.state_count, battery_std_wh)
    empty = np.array([edge.empty for edge in graph.edges])
    settled = np.array([edge.tail == ACCOUNT for edge in graph.edges])
    lands = np.array([edge.head == ACCOUNT for edge in graph.edges])
    own = np.where(settled[:, None], faces, prices.energy_wh)
    energy = np.where(empty[None, :, None] == np.array([False, True])[:, None, None], own, np.inf)
    model = step_model_of(
        graph.energy_graph(route_energy),
        chain,
        energy,
        prices.time_s,
        budget_wh + ACCOUNT_STDS * battery_std_wh,
        levels,
        rounding,
    )
    drawn = model.next_state.copy()
    drawn[lands] = weight
    return replace(model, next_state=drawn)


def _die(faces: int, std_wh: float) -> tuple[Floats, Floats]:
    """Prices (Wh) and weights of a normal error's die: equal steps, the density as weight."""
    z = np.linspace(-ACCOUNT_STDS, ACCOUNT_STDS, faces)
    weight = np.exp(-0.5 * z**2)
    return std_wh * (z + ACCOUNT_STDS), weight / weight.sum()
