"""Initial plans of a search: truck tours at several prices of a flight; the other customers are
inserted one after another at their best position, by drone or truck.
"""

import numpy as np

from ground_station.core.truck_drones.building.insertion import (
    InsertionParams,
    insert_customer_at_best_position,
)
from ground_station.core.truck_drones.building.priced_tour import anneal_priced_tour
from ground_station.core.truck_drones.changed_plan import simulate_and_store
from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.edits import store_route_index_by_node
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.random_stream import draw_integer_below
from ground_station.core.truck_drones.simulate import INFEASIBLE_S, simulate_cost_s
from ground_station.core.truck_drones.tables import (
    NOWHERE,
    REMOVED,
    ROUTE,
    ChangeArrays,
    Plan,
    ProblemTables,
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
    problem: TruckAndDrones, change: ChangeArrays, time_per_node_s: float
) -> list[Plan]:
    """Return the best plan for each price with a feasible plan, best first. Layers are not priced.

    Overwrites the plans in `change`. `time_per_node_s`: time of the initial plan per node.
    """
    found: list[tuple[float, Plan]] = []
    orders = ORDERS_PER_PRICE if problem.customers <= REPEATED_ORDERS_MAX_CUSTOMERS else 1
    for flight_s in _flight_cost_by_node_per_price_s(problem, change.tables, time_per_node_s):
        tour = anneal_priced_tour(change.tables, flight_s, change.stream).tolist()
        best_s, best = min(
            (_build_makespan_and_plan(change, tour) for _ in range(orders)), key=lambda one: one[0]
        )
        if best_s < INFEASIBLE_S and not any((best == other).all() for _, other in found):
            found.append((best_s, best))
    found.sort(key=lambda one: one[0])
    return [plan for _, plan in found]


def _build_makespan_and_plan(change: ChangeArrays, tour: list[int]) -> tuple[float, Plan]:
    """Build one plan; return its makespan (inf if infeasible) and the plan. Customers that cannot
    be inserted are added to the tour.
    """
    tables, plan, left = change.tables, change.new_plan, NOWHERE
    for _ in range(len(tables.travel_s)):
        plan[:] = empty_plan(len(tables.travel_s))
        plan[ROUTE, : len(tour)] = tour
        store_route_index_by_node(plan, change.new_route_index)
        left = _insert_unserved_in_random_order(change, NARROW_INSERTION, WIDE_INSERTION)
        if left == NOWHERE or not tables.truck_can[left]:
            break
        _insert_into_tour_at_least_detour(tables, tour, int(left))
    if left != NOWHERE:
        return INFEASIBLE_S, plan.copy()
    return float(simulate_cost_s(tables, plan, change.new_work, INFEASIBLE_S)), plan.copy()


def _insert_into_tour_at_least_detour(
    tables: ProblemTables, tour: list[int], customer: int
) -> None:
    before, after, travel_s = np.array(tour[:-1]), np.array(tour[1:]), tables.travel_s
    more_s = travel_s[before, customer] + travel_s[customer, after] - travel_s[before, after]
    tour.insert(int(np.argmin(more_s)) + 1, customer)


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
def _insert_unserved_in_random_order(change, narrow_params, wide_params):
    """Insert the customers that the changed plan does not serve in random order, those without road
    access first. Returns the first customer that cannot be inserted, or NOWHERE.
    """
    tables, plan, stream = change.tables, change.new_plan, change.stream
    route_index_by_node = change.new_route_index
    scratch, count, by_air = change.new_work.scratch, 0, 0
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
    change.costs_s[0] = simulate_and_store(tables, plan, change.work)
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
                change.plan[row, node] = plan[row, node]
        served_s, _ = insert_customer_at_best_position(
            change, customer, INFEASIBLE_S, narrow_params
        )
        if served_s == INFEASIBLE_S:
            served_s, _ = insert_customer_at_best_position(
                change, customer, INFEASIBLE_S, wide_params
            )
        if served_s == INFEASIBLE_S:
            return customer
        change.costs_s[0] = simulate_and_store(tables, plan, change.work)
    return NOWHERE
