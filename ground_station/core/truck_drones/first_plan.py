"""A first plan, fast: the truck serves whom it can, then drones take over where that saves time."""

import numpy as np

from companion.core.base.errors import LeewayError
from ground_station.core.truck_drones.compiled import compiled, compiled_with_arrays
from ground_station.core.truck_drones.edits import index_route, insert_stop
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
)
from ground_station.core.truck_drones.tour import truck_alone

AHEAD = 6
"""How many stops after its launch a drone is recovered at the latest, at first."""


def first_plan(problem: TruckAndDrones, tables: Tables, work: Work) -> Plan:
    """A feasible plan; LeewayError names the customers that nobody can serve."""
    lost = problem.unreachable()
    if lost:
        raise LeewayError(f"customers {lost}: no truck and no drone can serve them")
    plan = truck_alone(problem, tables)
    place = np.zeros(problem.nodes, dtype=np.int32)
    index_route(plan, place)
    for customer in range(1, problem.end):
        if not problem.truck_can_serve[customer]:
            cost_s = hand_to_drone(tables, work, plan, place, customer, IMPOSSIBLE, problem.nodes)
            if cost_s == IMPOSSIBLE:
                raise LeewayError(f"customer {customer}: no drone reaches it from any stop")
    makespan_s = simulate(tables, plan, work, IMPOSSIBLE)
    hand_over(tables, work, plan, place, makespan_s)
    return plan


@compiled
def hand_to_drone(t, w, plan, place, customer, give_up_s, reach):
    """Serve this customer, who is on no stop, by the drone that ends the day soonest; the makespan.

    inf, and the customer stays unserved, where no sortie ends the day by `give_up_s`. Launch and
    recovery are at most `reach` places from the nearest stop.
    """
    last = place[plan.shape[1] - 1]
    at = 0
    for stop in range(last + 1):
        if t.travel_s[plan[ROUTE, stop], customer] < t.travel_s[plan[ROUTE, at], customer]:
            at = stop
    best_s, best_launch, best_meet, best_kind = give_up_s, NOWHERE, NOWHERE, NOWHERE
    plan[ORDER, customer] = 0
    for kind in range(t.drone_can.shape[0]):
        if not t.drone_can[kind, customer]:
            continue
        plan[KIND, customer] = kind
        for launch in range(max(0, at - reach), min(last - 1, at + reach) + 1):
            furthest = launch if t.loops_only else min(last, launch + AHEAD)
            for meet in range(launch + (0 if t.pads else 1), furthest + 1):
                plan[LAUNCH, customer] = plan[ROUTE, launch]
                plan[MEET, customer] = plan[ROUTE, meet]
                cost_s = simulate(t, plan, w, best_s)
                if cost_s < best_s:
                    best_s, best_kind = cost_s, kind
                    best_launch, best_meet = plan[ROUTE, launch], plan[ROUTE, meet]
    plan[LAUNCH, customer] = best_launch
    plan[MEET, customer] = best_meet
    plan[KIND, customer] = best_kind
    return best_s if best_launch != NOWHERE else IMPOSSIBLE


@compiled_with_arrays
def hand_over(t, w, plan, place, makespan_s):
    """For each stop without launches and recoveries, in turn: by drone instead, if that saves
    time.
    """
    busy = np.zeros(plan.shape[1], dtype=np.bool_)
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] != NOWHERE:
            busy[plan[LAUNCH, customer]] = True
            busy[plan[MEET, customer]] = True
    for customer in range(1, plan.shape[1] - 1):
        at = place[customer]
        if at < 0 or busy[customer] or not t.drone_can[:, customer].any():
            continue
        for to in range(at, place[plan.shape[1] - 1]):
            plan[ROUTE, to] = plan[ROUTE, to + 1]
        index_route(plan, place)
        place[customer] = NOWHERE
        cost_s = hand_to_drone(t, w, plan, place, customer, makespan_s - 1e-6, 2)
        if cost_s == IMPOSSIBLE:
            plan[KIND, customer] = NOWHERE
            insert_stop(plan, place, customer, at)
            continue
        makespan_s = cost_s
        busy[plan[LAUNCH, customer]] = True
        busy[plan[MEET, customer]] = True
    return makespan_s
