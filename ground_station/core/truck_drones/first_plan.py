"""Fast initial plan: a tour of the truck; then drones replace stops where that saves time."""

import numpy as np

from companion.core.base.errors import LeewayError
from ground_station.core.truck_drones.compiled import compiled, compiled_with_arrays
from ground_station.core.truck_drones.edits import insert_stop, store_route_index_by_node
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
)
from ground_station.core.truck_drones.tour import truck_only_plan

MAX_RENDEZVOUS_OFFSET = 6
"""Maximum number of stops from launch to recovery in the initial plan."""


def build_first_plan(problem: TruckAndDrones, tables: ProblemTables, work: WorkArrays) -> Plan:
    """Build a feasible plan. Raises LeewayError with the customers that no vehicle can serve."""
    lost = problem.unreachable_customers()
    if lost:
        raise LeewayError(f"customers {lost}: no truck and no drone can serve them")
    plan = truck_only_plan(problem, tables)
    position = np.zeros(problem.nodes, dtype=np.int64)
    store_route_index_by_node(plan, position)
    for customer in range(1, problem.end_node):
        if not problem.truck_can_serve[customer]:
            cost_s = assign_best_sortie(
                tables, work, plan, position, customer, INFEASIBLE_S, problem.nodes
            )
            if cost_s == INFEASIBLE_S:
                raise LeewayError(f"customer {customer}: no drone reaches it from any stop")
    plan_cost_s = simulate_cost_s(tables, plan, work, INFEASIBLE_S)
    replace_stops_by_sorties(tables, work, plan, position, plan_cost_s)
    return plan


@compiled
def assign_best_sortie(
    tables, work_arrays, plan, route_index_by_node, customer, cost_limit_s, max_offset
):
    """Assign an unserved customer to the sortie with the least cost; return the cost.

    Returns inf, and the customer stays unserved, if no sortie gives a cost below
    `cost_limit_s`. Launch and recovery are at most `max_offset` route positions from the
    nearest stop.
    """
    last = route_index_by_node[plan.shape[1] - 1]
    at = 0
    for stop in range(last + 1):
        if (
            tables.travel_s[plan[ROUTE, stop], customer]
            < tables.travel_s[plan[ROUTE, at], customer]
        ):
            at = stop
    best_s, best_launch, best_rendezvous, best_kind = cost_limit_s, NOWHERE, NOWHERE, NOWHERE
    plan[ORDER, customer] = 0
    for kind in range(tables.drone_can.shape[0]):
        if not tables.drone_can[kind, customer]:
            continue
        plan[KIND, customer] = kind
        for launch in range(max(0, at - max_offset), min(last - 1, at + max_offset) + 1):
            furthest = launch if tables.loops_only else min(last, launch + MAX_RENDEZVOUS_OFFSET)
            for rendezvous in range(launch + (0 if tables.pads else 1), furthest + 1):
                plan[LAUNCH, customer] = plan[ROUTE, launch]
                plan[RENDEZVOUS, customer] = plan[ROUTE, rendezvous]
                cost_s = simulate_cost_s(tables, plan, work_arrays, best_s)
                if cost_s < best_s:
                    best_s, best_kind = cost_s, kind
                    best_launch, best_rendezvous = plan[ROUTE, launch], plan[ROUTE, rendezvous]
    plan[LAUNCH, customer] = best_launch
    plan[RENDEZVOUS, customer] = best_rendezvous
    plan[KIND, customer] = best_kind
    return best_s if best_launch != NOWHERE else INFEASIBLE_S


@compiled_with_arrays
def replace_stops_by_sorties(tables, work_arrays, plan, route_index_by_node, plan_cost_s):
    """Replace each stop without launches and recoveries by a sortie if that saves time."""
    used_by_sorties = np.zeros(plan.shape[1], dtype=np.bool_)
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] != NOWHERE:
            used_by_sorties[plan[LAUNCH, customer]] = True
            used_by_sorties[plan[RENDEZVOUS, customer]] = True
    for customer in range(1, plan.shape[1] - 1):
        at = route_index_by_node[customer]
        if at < 0 or used_by_sorties[customer] or not tables.drone_can[:, customer].any():
            continue
        for to in range(at, route_index_by_node[plan.shape[1] - 1]):
            plan[ROUTE, to] = plan[ROUTE, to + 1]
        store_route_index_by_node(plan, route_index_by_node)
        route_index_by_node[customer] = NOWHERE
        cost_s = assign_best_sortie(
            tables, work_arrays, plan, route_index_by_node, customer, plan_cost_s - 1e-6, 2
        )
        if cost_s == INFEASIBLE_S:
            plan[KIND, customer] = NOWHERE
            insert_stop(plan, route_index_by_node, customer, at)
            continue
        plan_cost_s = cost_s
        used_by_sorties[plan[LAUNCH, customer]] = True
        used_by_sorties[plan[RENDEZVOUS, customer]] = True
    return plan_cost_s
