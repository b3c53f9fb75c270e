"""A time that no plan of a day can beat, from what the driver and the drones must do in any case.

Two relaxations, each without everything that ties the other down: separation in the air, waiting,
energy, and where drones are launched and met.

- The driver does one thing at a time, and drives the truck too. Each order costs at least the
  cheapest of a delivery at the door, and a launch with a recovery. Where no drone may or can serve,
  the truck must come by: the shortest way past these places (Held and Karp, J. SIAM 10, 1962).
- Each order that only a drone may serve takes a drone for its launch, its way out and back by the
  best stops, and its recovery; a fleet has only so many.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from companion.core.base.arrays import Floats
from ground_station.core.truck_drones.problem import TruckAndDrones

MOST_FORCED = 14
"""Places that the truck must come by, for an exact shortest way (2^n n^2 steps); past more the way
is at least the shortest tree that joins them."""


@dataclass(frozen=True, slots=True)
class PlanBound:
    """Seconds: the driver's work and the way, and the fleet's work over its drones."""

    driver_work_s: float
    way_s: float
    forced_stops: int
    fleet_s: float

    @property
    def makespan_s(self) -> float:
        """No plan ends sooner."""
        return max(self.driver_work_s + self.way_s, self.fleet_s)


def plan_bound(problem: TruckAndDrones) -> PlanBound:
    """The bound for this problem."""
    forced, work_s, fleet_work_s = list[int](), 0.0, 0.0
    for customer in range(1, problem.end):
        by_truck = bool(problem.truck_can_serve[customer])
        flights_s = _flights_s(problem, customer)
        choices_s = [handling for handling, _ in flights_s]
        if by_truck:
            choices_s.append(float(problem.deliver_s[customer]))
        if not choices_s:
            continue  # nobody can serve it: no plan does
        work_s += min(choices_s)
        if not flights_s:
            forced.append(customer)
        if not by_truck:
            fleet_work_s += min(handling + fly for handling, fly in flights_s)
    way_s = shortest_way_s if len(forced) <= MOST_FORCED else spanning_way_s
    drones = sum(kind.count for kind in problem.kinds)
    fleet_s = fleet_work_s / drones if drones else 0.0
    return PlanBound(work_s, way_s(problem.travel_s, forced), len(forced), fleet_s)


def _flights_s(problem: TruckAndDrones, customer: int) -> list[tuple[float, float]]:
    """By kind that can serve it: the driver's time, and the flight's by the best stops."""
    found: list[tuple[float, float]] = []
    stops = [0, *np.flatnonzero(problem.truck_can_serve).tolist(), problem.end]
    for kind, legs in zip(problem.kinds, problem.legs, strict=True):
        if kind.count == 0 or not kind.can_serve[customer]:
            continue
        spent_s = legs.out_hover_s[stops, customer][:, None] + legs.back_hover_s[customer, stops]
        fly_s = legs.out_s[stops, customer][:, None] + legs.back_s[customer, stops]
        within = spent_s <= legs.endurance_hover_s
        if within.any():
            found.append((kind.launch_s + kind.recover_s, float(fly_s[within].min())))
    return found


def shortest_way_s(travel_s: Floats, places: list[int]) -> float:
    """From the first node to the last past all of these, in any order, through any others and
    more than once where that is shorter.
    """
    between_s = _by_any_way_s(travel_s)
    end = len(travel_s) - 1
    if not places:
        return float(between_s[0, end])
    full = 1 << len(places)
    least_s = np.full((full, len(places)), math.inf)
    for last, place in enumerate(places):
        least_s[1 << last, last] = between_s[0, place]
    for seen in range(1, full):
        for last, place in enumerate(places):
            for ahead, there in enumerate(places):
                if not seen >> ahead & 1:
                    come_s = least_s[seen, last] + between_s[place, there]
                    wider = seen | 1 << ahead
                    least_s[wider, ahead] = min(least_s[wider, ahead], come_s)
    return float(min(least_s[full - 1, k] + between_s[p, end] for k, p in enumerate(places)))


def spanning_way_s(travel_s: Floats, places: list[int]) -> float:
    """No way from the first node to the last past all of these is shorter: it joins them, and the
    lightest tree that does (each pair by its faster direction) weighs no more.
    """
    nodes = [0, *places, len(travel_s) - 1]
    between_s = _by_any_way_s(travel_s)[np.ix_(nodes, nodes)]
    either_s = np.maximum(np.minimum(between_s, between_s.T), 1e-9)  # 0 would be no edge there
    return float(minimum_spanning_tree(either_s).sum())


def _by_any_way_s(travel_s: Floats) -> Floats:
    """From each node to each, through others where that is shorter: roads may have detours."""
    between_s = travel_s.copy()
    for via in range(len(between_s)):  # Floyd and Warshall
        between_s = np.minimum(between_s, between_s[:, via, None] + between_s[via])
    return between_s
