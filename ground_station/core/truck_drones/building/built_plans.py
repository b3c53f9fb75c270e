"""Initial plans of a search: truck tours at several prices of a flight; the other customers are
inserted one after another at their best position, by drone or truck.
"""

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.building.insertion import (
    InsertionParams,
    insert_customer_at_best_position,
)
from ground_station.core.truck_drones.building.priced_tour import anneal_priced_tour
from ground_station.core.truck_drones.changed_plan import simulate_and_store
from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.edits import store_route_index_by_node
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.random_stream import RandomStream, draw_integer_below
from ground_station.core.truck_drones.simulate import INFEASIBLE_S, simulate_makespan_s
from ground_station.core.truck_drones.tables import (
    NOWHERE,
    REMOVED,
    ROUTE,
    Plan,
    ProblemTables,
    WorkArrays,
    empty_plan,
)

DRIVER_SHARES = (0.5, 0.75)
LEG_SHARES = (0.0, 0.1, 0.25, 0.45, 0.7, 1.05)
"""Prices of a flight: shares of the driver's time for it in excess of a delivery's; and that time
plus shares of the mean leg of a day."""
ORDERS_PER_PRICE = 8
REPEATED_ORDERS_MAX_CUSTOMERS = 250
"""With more customers only one order per price: the time grows with the square of their number."""
NARROW_INSERTION = InsertionParams(
    near_stops=4, launch_range=3, rendezvous_range=5, skip_frac=0.02, air_price=0.05
)
WIDE_INSERTION = InsertionParams(
    near_stops=100, launch_range=100, rendezvous_range=8, skip_frac=0.0, air_price=0.05
)


def construct_plan_per_flight_price(
    problem: TruckAndDrones,
    tables: ProblemTables,
    base_work_arrays: WorkArrays,
    work_arrays: WorkArrays,
    time_per_node_s: float,
    stream: RandomStream,
) -> list[Plan]:
    """Return the best plan for each price with a feasible plan, best first. Layers are not priced.

    `time_per_node_s`: time of the initial plan per node.
    """
    found: list[tuple[float, Plan]] = []
    orders = ORDERS_PER_PRICE if problem.customers <= REPEATED_ORDERS_MAX_CUSTOMERS else 1
    for flight_s in _flight_cost_by_node_per_price_s(problem, tables, time_per_node_s):
        builder = _PlanBuilder(
            tables,
            base_work_arrays,
            work_arrays,
            anneal_priced_tour(tables, flight_s, stream),
            stream,
        )
        best_s, best = min(
            (builder.build_makespan_and_plan() for _ in range(orders)), key=lambda one: one[0]
        )
        if best_s < INFEASIBLE_S and not any((best == other).all() for _, other in found):
            found.append((best_s, best))
    found.sort(key=lambda one: one[0])
    return [plan for _, plan in found]


class _PlanBuilder:
    """Builds plans from one tour. Customers that cannot be inserted are added to the tour."""

    def __init__(
        self,
        tables: ProblemTables,
        kept: WorkArrays,
        work: WorkArrays,
        tour: NDArray[np.int64],
        stream: RandomStream,
    ) -> None:
        self._tables, self._kept, self._work, self._stream = tables, kept, work, stream
        self._tour = tour.tolist()

    def build_makespan_and_plan(self) -> tuple[float, Plan]:
        """Build one plan; return its makespan (inf if infeasible) and the plan."""
        nodes = len(self._tables.travel_s)
        position = np.zeros(nodes, dtype=np.int64)
        plan, left = empty_plan(nodes), NOWHERE
        for _ in range(nodes):
            plan[:] = empty_plan(nodes)
            plan[ROUTE, : len(self._tour)] = self._tour
            store_route_index_by_node(plan, position)
            left = _insert_unserved_in_random_order(
                self._tables,
                self._kept,
                self._work,
                plan,
                plan.copy(),
                position,
                NARROW_INSERTION,
                WIDE_INSERTION,
                self._stream,
            )
            if left == NOWHERE or not self._tables.truck_can[left]:
                break
            self._insert_into_tour_at_least_detour(int(left))
        if left != NOWHERE:
            return INFEASIBLE_S, plan
        return float(simulate_makespan_s(self._tables, plan, self._work, INFEASIBLE_S)), plan

    def _insert_into_tour_at_least_detour(self, customer: int) -> None:
        """Insert this customer into the tour at the least detour."""
        tour, travel_s = np.array(self._tour), self._tables.travel_s
        before, after = tour[:-1], tour[1:]
        more_s = travel_s[before, customer] + travel_s[customer, after] - travel_s[before, after]
        self._tour.insert(int(np.argmin(more_s)) + 1, customer)


def _flight_cost_by_node_per_price_s(
    problem: TruckAndDrones, tables: ProblemTables, mean_leg_s: float
) -> list[np.ndarray]:
    """Return the cost of a flight to each node, for each price; inf if no drone can serve it."""
    driver_s = min(kind.launch_s + kind.recover_s for kind in problem.kinds) - problem.deliver_s
    flies = tables.drone_can.any(axis=0)
    flight_costs_s = [share * driver_s for share in DRIVER_SHARES]
    flight_costs_s += [driver_s + share * mean_leg_s for share in LEG_SHARES]
    return [np.where(flies, np.maximum(price, 0.0), np.inf) for price in flight_costs_s]


@compiled
def _insert_unserved_in_random_order(
    tables,
    base_work_arrays,
    work_arrays,
    plan,
    previous_plan_buffer,
    route_index_by_node,
    narrow_params,
    wide_params,
    stream,
):
    """Insert the unserved customers in random order, customers without road access first. Returns
    the first customer that cannot be inserted, or NOWHERE.
    """
    scratch, count, by_air = work_arrays.scratch, 0, 0
    for node in range(1, plan.shape[1] - 1):
        if route_index_by_node[node] == NOWHERE:
            scratch[REMOVED, count] = node
            count += 1
            by_air += not tables.truck_can[node]
    for low in range(count):  # customers without road access at the end
        if not tables.truck_can[scratch[REMOVED, low]]:
            for high in range(count - 1, low, -1):
                if tables.truck_can[scratch[REMOVED, high]]:
                    swap = scratch[REMOVED, low]
                    scratch[REMOVED, low], scratch[REMOVED, high] = scratch[REMOVED, high], swap
                    break
    makespan_s = simulate_and_store(tables, plan, base_work_arrays)
    for left in range(count, 0, -1):
        by_road = count - by_air
        drawn = (
            by_road + draw_integer_below(stream, left - by_road)
            if left > by_road
            else draw_integer_below(stream, left)
        )
        customer = scratch[REMOVED, drawn]
        scratch[REMOVED, drawn] = scratch[REMOVED, left - 1]
        for row in range(plan.shape[0]):
            for node in range(plan.shape[1]):
                previous_plan_buffer[row, node] = plan[row, node]
        served_s, _ = insert_customer_at_best_position(
            tables,
            previous_plan_buffer,
            base_work_arrays,
            makespan_s,
            plan,
            route_index_by_node,
            work_arrays,
            customer,
            INFEASIBLE_S,
            narrow_params,
            stream,
        )
        if served_s == INFEASIBLE_S:
            served_s, _ = insert_customer_at_best_position(
                tables,
                previous_plan_buffer,
                base_work_arrays,
                makespan_s,
                plan,
                route_index_by_node,
                work_arrays,
                customer,
                INFEASIBLE_S,
                wide_params,
                stream,
            )
        if served_s == INFEASIBLE_S:
            return customer
        makespan_s = simulate_and_store(tables, plan, base_work_arrays)
    return NOWHERE
