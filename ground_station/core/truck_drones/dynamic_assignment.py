"""The dynamic assignment of arXiv 2604.13441, section IV-A: decided at each arrival, never revised.

The truck's tour over all customers that it can serve is fixed first. At each stop each free drone,
fastest first, gets the customer nearest to the truck, of those not yet served that it can carry to
and be recovered from within its endurance. The truck drops that customer from its tour. The paper
leaves open where a drone is recovered: here at the first possible stop ahead, which the truck then
must not drop.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.core.base.errors import LeewayError
from ground_station.core.truck_drones.edits import index_route
from ground_station.core.truck_drones.first_plan import AHEAD, hand_to_drone
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.simulate import IMPOSSIBLE, simulate
from ground_station.core.truck_drones.tables import (
    KIND,
    LAUNCH,
    MEET,
    NOWHERE,
    ORDER,
    ROUTE,
    Plan,
    Tables,
    Work,
    tables_of,
    work_for,
)
from ground_station.core.truck_drones.tour import truck_alone


@dataclass(frozen=True, slots=True)
class DynamicAssignment:
    """`Policy`: nearest customer to the truck, fastest free drone."""

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """The plan after the truck has driven its tour. It draws no random numbers."""
        lost = problem.unreachable()
        if lost:
            raise LeewayError(f"customers {lost}: no truck and no drone can serve them")
        return _Tour(problem, tables_of(problem)).driven()


class _Tour:
    """The truck on its tour."""

    def __init__(self, problem: TruckAndDrones, tables: Tables) -> None:
        self._problem, self._tables = problem, tables
        self._work: Work = work_for(tables)
        self._plan = truck_alone(problem, tables)
        self._unserved = set(range(1, problem.end))
        self._promised: set[int] = set()
        self._met_at: list[tuple[int, int]] = []
        """Where each drone in the air will be recovered, and its kind."""

    def driven(self) -> Plan:
        at = 0
        while True:
            node = int(self._plan[ROUTE, at])
            if node == self._problem.end:
                break
            self._unserved.discard(node)
            self._met_at = [met for met in self._met_at if met[0] != node]
            for kind in self._free_kinds():
                self._send_one(at, kind)
            at += 1
        self._serve_whom_no_road_reaches()
        return self._plan

    def _free_kinds(self) -> Iterator[int]:
        """The kind of each free drone, fastest first (by its mean flight between two nodes)."""
        mean_s = [float(np.mean(legs.back_s)) for legs in self._problem.legs]
        for kind in np.argsort(mean_s, kind="stable").tolist():
            flying = sum(1 for _, of in self._met_at if of == kind)
            for _ in range(self._problem.kinds[kind].count - flying):
                yield kind

    def _send_one(self, at: int, kind: int) -> None:
        node = int(self._plan[ROUTE, at])
        can_serve = self._problem.kinds[kind].can_serve
        open_for_drones = [j for j in self._unserved - self._promised if can_serve[j]]
        open_for_drones.sort(key=lambda j: (self._problem.travel_s[node, j], j))
        for customer in open_for_drones:
            trial = self._without(customer)
            for meet in trial[ROUTE, at + 1 : at + 1 + AHEAD].tolist():
                if meet == NOWHERE:
                    break
                trial[LAUNCH, customer], trial[MEET, customer] = node, meet
                trial[KIND, customer], trial[ORDER, customer] = kind, 0
                if simulate(self._tables, trial, self._work, IMPOSSIBLE) < IMPOSSIBLE:
                    self._plan = trial
                    self._unserved.discard(customer)
                    self._promised.add(meet)
                    self._met_at.append((meet, kind))
                    return

    def _without(self, customer: int) -> Plan:
        """The plan with the customer off the truck's tour."""
        plan = self._plan.copy()
        route = plan[ROUTE].tolist()
        tour = [node for node in route[: route.index(self._problem.end) + 1] if node != customer]
        plan[ROUTE] = NOWHERE
        plan[ROUTE, : len(tour)] = tour
        return plan

    def _serve_whom_no_road_reaches(self) -> None:
        place = np.zeros(self._problem.nodes, dtype=np.int32)
        index_route(self._plan, place)
        for customer in sorted(self._unserved):
            if place[customer] >= 0:
                continue
            cost_s = hand_to_drone(
                self._tables, self._work, self._plan, place, customer, IMPOSSIBLE, len(place)
            )
            if cost_s == IMPOSSIBLE:
                raise LeewayError(f"customer {customer}: no drone reaches it from any stop")
