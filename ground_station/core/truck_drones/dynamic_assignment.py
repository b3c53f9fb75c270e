"""Dynamic assignment of arXiv 2604.13441, section IV-A: decided at each arrival, never revised.

First the truck's tour over all customers that it can serve is fixed. At each stop each free drone,
fastest first, gets the unserved customer nearest to the truck that it can serve and return from
within its endurance. The truck removes that customer from its tour. The paper does not specify the
recovery stop: here it is the first feasible next stop, which the truck must then keep.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.core.base.errors import LeewayError
from ground_station.core.truck_drones.edits import store_route_index_by_node
from ground_station.core.truck_drones.first_plan import MAX_RENDEZVOUS_OFFSET, assign_best_sortie
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.simulate import INFEASIBLE_S, simulate_cost_s
from ground_station.core.truck_drones.tables import (
    KIND,
    LAUNCH,
    NOWHERE,
    ORDER,
    RENDEZVOUS,
    ROUTE,
    Plan,
    ProblemTables,
    WorkArrays,
    allocate_work_arrays,
    tables_of,
)
from ground_station.core.truck_drones.tour import truck_only_plan


@dataclass(frozen=True, slots=True)
class DynamicAssignment:
    """Policy: nearest customer to the truck, fastest free drone."""

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """Return the plan of the completed tour. Draws no random numbers."""
        lost = problem.unreachable_customers()
        if lost:
            raise LeewayError(f"customers {lost}: no truck and no drone can serve them")
        return _AssignmentTour(problem, tables_of(problem)).assign_customers_along_tour()


class _AssignmentTour:
    """State of the truck on its tour."""

    def __init__(self, problem: TruckAndDrones, tables: ProblemTables) -> None:
        self._problem, self._tables = problem, tables
        self._work: WorkArrays = allocate_work_arrays(tables)
        self._plan = truck_only_plan(problem, tables)
        self._unserved = set(range(1, problem.end_node))
        self._fixed_stops: set[int] = set()
        self._recovery_stops: list[tuple[int, int]] = []
        """Recovery stop and kind of each airborne drone."""

    def assign_customers_along_tour(self) -> Plan:
        at = 0
        while True:
            node = int(self._plan[ROUTE, at])
            if node == self._problem.end_node:
                break
            self._unserved.discard(node)
            self._recovery_stops = [
                recovery for recovery in self._recovery_stops if recovery[0] != node
            ]
            for kind in self._kind_of_each_free_drone():
                self._try_assign_nearest_customer(at, kind)
            at += 1
        self._assign_off_route_customers_to_drones()
        return self._plan

    def _kind_of_each_free_drone(self) -> Iterator[int]:
        """Yield the kind of each free drone, fastest first (by mean flight time of two nodes)."""
        mean_s = [float(np.mean(leg_tables.back_s)) for leg_tables in self._problem.leg_tables]
        for kind in np.argsort(mean_s, kind="stable").tolist():
            airborne = sum(1 for _, of in self._recovery_stops if of == kind)
            for _ in range(self._problem.kinds[kind].count - airborne):
                yield kind

    def _try_assign_nearest_customer(self, route_index: int, kind: int) -> None:
        node = int(self._plan[ROUTE, route_index])
        can_serve = self._problem.kinds[kind].can_serve
        open_for_drones = [j for j in self._unserved - self._fixed_stops if can_serve[j]]
        open_for_drones.sort(key=lambda j: (self._problem.travel_s[node, j], j))
        for customer in open_for_drones:
            trial = self._plan_without_truck_stop(customer)
            for rendezvous in trial[
                ROUTE, route_index + 1 : route_index + 1 + MAX_RENDEZVOUS_OFFSET
            ].tolist():
                if rendezvous == NOWHERE:
                    break
                trial[LAUNCH, customer], trial[RENDEZVOUS, customer] = node, rendezvous
                trial[KIND, customer], trial[ORDER, customer] = kind, 0
                if simulate_cost_s(self._tables, trial, self._work, INFEASIBLE_S) < INFEASIBLE_S:
                    self._plan = trial
                    self._unserved.discard(customer)
                    self._fixed_stops.add(rendezvous)
                    self._recovery_stops.append((rendezvous, kind))
                    return

    def _plan_without_truck_stop(self, customer: int) -> Plan:
        """Return the plan without the customer on the truck's tour."""
        plan = self._plan.copy()
        route = plan[ROUTE].tolist()
        tour = [
            node for node in route[: route.index(self._problem.end_node) + 1] if node != customer
        ]
        plan[ROUTE] = NOWHERE
        plan[ROUTE, : len(tour)] = tour
        return plan

    def _assign_off_route_customers_to_drones(self) -> None:
        position = np.zeros(self._problem.nodes, dtype=np.int64)
        store_route_index_by_node(self._plan, position)
        for customer in sorted(self._unserved):
            if position[customer] >= 0:
                continue
            cost_s = assign_best_sortie(
                self._tables,
                self._work,
                self._plan,
                position,
                customer,
                INFEASIBLE_S,
                len(position),
            )
            if cost_s == INFEASIBLE_S:
                raise LeewayError(f"customer {customer}: no drone reaches it from any stop")
