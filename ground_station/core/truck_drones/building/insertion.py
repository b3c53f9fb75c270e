"""Inserts an unserved customer at the best position found, by truck or by drone.

The price of a position is the resulting cost plus a small share of the drone's time away from
the truck: a drone that returns early can fly again.
"""

from typing import NamedTuple

from ground_station.core.truck_drones.changed_plan import incremental_cost_s
from ground_station.core.truck_drones.compiled import compiled_inner
from ground_station.core.truck_drones.edits import insert_stop
from ground_station.core.truck_drones.random_stream import draw_uniform
from ground_station.core.truck_drones.simulate import INFEASIBLE_S
from ground_station.core.truck_drones.tables import (
    AWAY,
    IDLE,
    KIND,
    LAUNCH,
    LAUNCHED,
    NOWHERE,
    ORDER,
    RECOVERED,
    RENDEZVOUS,
    ROUTE,
)


class InsertionParams(NamedTuple):
    """Candidate positions of an insertion."""

    near_stops: int
    """Number of near stops before and after which the truck may be routed."""
    launch_range: int
    """Maximum number of route positions from the nearest stop to the launch."""
    rendezvous_range: int
    """Maximum number of route positions from launch to rendezvous."""
    skip_frac: float
    """Share of candidates skipped at random, so that two attempts differ."""
    air_price: float
    """Price of a drone's second away from the truck, in seconds of makespan."""


@compiled_inner
def store_drones_away_by_route_index(plan, route_index_by_node, scratch):
    """Count by kind and position: drones away from the truck up to the next position."""
    last = route_index_by_node[plan.shape[1] - 1]
    for row in range(AWAY, scratch.shape[0]):
        for at in range(last + 1):
            scratch[row, at] = 0
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] != NOWHERE:
            row = AWAY + plan[KIND, customer]
            for at in range(
                route_index_by_node[plan[LAUNCH, customer]],
                route_index_by_node[plan[RENDEZVOUS, customer]],
            ):
                scratch[row, at] += 1


@compiled_inner
def nearest_stop_route_index(tables, plan, route_index_by_node, customer):
    """Return the route position of the stop with the shortest road to this customer."""
    near = tables.near
    for number in range(near.shape[1]):
        if route_index_by_node[near[customer, number]] >= 0:
            return route_index_by_node[near[customer, number]]
    at = 0
    for other in range(1, route_index_by_node[plan.shape[1] - 1] + 1):
        if (
            tables.travel_s[plan[ROUTE, other], customer]
            < tables.travel_s[plan[ROUTE, at], customer]
        ):
            at = other
    return at


@compiled_inner
def undo_insert_stop(plan, route_index_by_node, route_index):
    """Undo `insert_stop` for a stop without launches and recoveries."""
    last = route_index_by_node[plan.shape[1] - 1]
    route_index_by_node[plan[ROUTE, route_index]] = NOWHERE
    for to in range(route_index, last):
        plan[ROUTE, to] = plan[ROUTE, to + 1]
        route_index_by_node[plan[ROUTE, to]] = to


@compiled_inner
def _best_truck_route_index(change, customer, cost_limit_s, params):
    """Return the best route position to serve this customer by truck (NOWHERE: none below
    `cost_limit_s`), the cost, and the number of positions tried.
    """
    tables, plan, route_index_by_node = change.tables, change.new_plan, change.new_route_index
    near = tables.near
    last = route_index_by_node[plan.shape[1] - 1]
    best_at, best_s, evaluated, stops = NOWHERE, cost_limit_s, 0, 0
    nearest = nearest_stop_route_index(tables, plan, route_index_by_node, customer)
    for number in range(near.shape[1] + 1):
        if number < near.shape[1]:
            at = route_index_by_node[near[customer, number]]
        else:
            at = nearest if stops == 0 else NOWHERE  # no near node is on the route
        if at < 0:
            continue
        stops += 1
        for to in range(max(1, at), min(last, at + 1) + 1):
            other = plan[ROUTE, to] if to > at else plan[ROUTE, to - 1]
            known = False  # tried from the other side
            for before in range(min(number, near.shape[1])):
                known = known or near[customer, before] == other
            if known or draw_uniform(change.stream) < params.skip_frac:
                continue
            insert_stop(plan, route_index_by_node, customer, to)
            evaluated += 1
            plan_cost_s, simulated = incremental_cost_s(change, best_s)
            undo_insert_stop(plan, route_index_by_node, to)
            if simulated[1] > 0 and plan_cost_s < best_s:
                best_at, best_s = to, plan_cost_s
        if stops >= params.near_stops:
            break
    return best_at, best_s, evaluated


@compiled_inner
def insert_customer_at_best_position(change, customer, cost_limit_s, params):
    """Insert this customer into the changed plan; return the cost (inf, without a change, if no
    candidate is below `cost_limit_s`) and the number of candidates tried.
    """
    tables, plan, route_index_by_node = change.tables, change.new_plan, change.new_route_index
    times_s, scratch = change.new_work.times_s, change.new_work.scratch
    best_s, evaluated, best_at = cost_limit_s, 0, NOWHERE
    if tables.truck_can[customer]:
        best_at, best_s, evaluated = _best_truck_route_index(change, customer, cost_limit_s, params)
    # Price of a candidate: cost plus share of drone time.
    best_cost_s = best_s if best_at >= 0 else INFEASIBLE_S
    best_kind, best_launch, best_rendezvous = NOWHERE, NOWHERE, NOWHERE
    end = plan.shape[1] - 1
    last = route_index_by_node[end]
    store_drones_away_by_route_index(plan, route_index_by_node, scratch)
    nearest = nearest_stop_route_index(tables, plan, route_index_by_node, customer)
    plan[ORDER, customer] = 0
    for kind in range(tables.drone_can.shape[0]):
        if not tables.drone_can[kind, customer]:
            continue
        drones = tables.fleet[kind] - (plan[IDLE, kind] if kind <= end else 0)
        plan[KIND, customer] = kind
        for launch in range(
            max(0, nearest - params.launch_range), min(last, nearest + params.launch_range) + 1
        ):
            start = plan[ROUTE, launch]
            left_s = tables.endurance_hover_s[kind] - tables.out_hover_s[kind, start, customer]
            if not left_s >= 0.0:
                continue
            furthest = launch if tables.loops_only else min(last, launch + params.rendezvous_range)
            for rendezvous in range(launch, furthest + 1):
                if rendezvous > launch and scratch[AWAY + kind, rendezvous - 1] >= drones:
                    break
                if rendezvous == launch and not tables.pads:
                    continue
                stop = plan[ROUTE, rendezvous]
                if not left_s - tables.back_hover_s[kind, customer, stop] >= 0.0:
                    continue
                if draw_uniform(change.stream) < params.skip_frac:
                    continue
                plan[LAUNCH, customer], plan[RENDEZVOUS, customer] = start, stop
                evaluated += 1
                plan_cost_s, simulated = incremental_cost_s(change, min(cost_limit_s, best_cost_s))
                if simulated[1] == 0:
                    continue
                away_s = times_s[RECOVERED, customer] - times_s[LAUNCHED, customer]
                if plan_cost_s + params.air_price * away_s < best_cost_s:
                    best_cost_s = plan_cost_s + params.air_price * away_s
                    best_s = plan_cost_s
                    best_kind, best_launch, best_rendezvous = kind, start, stop
    plan[LAUNCH, customer], plan[RENDEZVOUS, customer] = best_launch, best_rendezvous
    plan[KIND, customer] = best_kind
    if best_launch == NOWHERE:
        if best_at == NOWHERE:
            return INFEASIBLE_S, evaluated
        insert_stop(plan, route_index_by_node, customer, best_at)
    return best_s, evaluated
