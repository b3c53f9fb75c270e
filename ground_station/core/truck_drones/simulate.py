"""The times of a plan: truck, driver and drones, in one pass along the route.

A delivery is possible from the opening of its window, and a launch so that its drop is. At a node
the driver selects the first possible task of: a recovery that cannot wait for a launch;
the launch with the earliest recovery; a recovery; the truck's own delivery; a launch marked LATE.
If no task is possible, or none that ends before a drone marked AT_ONCE arrives, the driver waits. A
drone that would hover too long before its recovery is launched later by the excess (at no cost if
the truck waits on the route), and the pass is repeated from that launch. For the resulting order of
launches and recoveries these are the earliest times. If drones have their own pads, a drone that
would land before the truck's arrival is delayed likewise. If drones must be separated, a launch
without a free layer waits until the first blocking drone has landed. The truck stays until its
launched drones have taken off.
"""

import math

from ground_station.core.truck_drones.compiled import compiled, compiled_inner
from ground_station.core.truck_drones.layers.layer_pricing import find_free_layer_and_store_geometry
from ground_station.core.truck_drones.tables import (
    ARRIVE,
    BLOCKED,
    DELAYS,
    DELIVERED,
    DEPART,
    FIRST_LAUNCH,
    FIRST_RECOVERY,
    FLY,
    HOVER_LEFT,
    IDLE,
    IMMEDIATE,
    KIND,
    LATE,
    LAUNCH,
    LAUNCHED,
    LAYER,
    LEVEL,
    LOG,
    LOGGED,
    NEXT_LAUNCH,
    NEXT_RECOVERY,
    NOWHERE,
    OPENS,
    ORDER,
    PENDING,
    POSITION,
    RECOVERED,
    RELEASE,
    RENDEZVOUS,
    ROUTE,
    SPARE,
    WORK_AFTER,
)
from ground_station.core.truck_drones.timed_cost import timed_cost_s

EPSILON_S = 1e-7
MAX_DELAYS = 3
"""Maximum delays of one launch before the plan is infeasible."""

INFEASIBLE_S = math.inf
GROUND_WAIT_S = 1e7
"""Permitted waiting time of a landed drone: longer than any day."""


@compiled_inner
def store_flight_if_feasible(tables, plan, times_s, customer):
    """Store flight and spare times of a sortie; return False if it is infeasible."""
    launch, rendezvous = plan[LAUNCH, customer], plan[RENDEZVOUS, customer]
    kind = plan[KIND, customer]
    if (launch == rendezvous and not tables.pads) or (launch != rendezvous and tables.loops_only):
        return False
    left_s = tables.endurance_hover_s[kind] - tables.out_hover_s[kind, launch, customer]
    spare_s = left_s - tables.back_hover_s[kind, customer, rendezvous]
    if not spare_s >= 0.0:
        return False
    fly_s = tables.out_s[kind, launch, customer] + tables.back_s[kind, customer, rendezvous]
    times_s[FLY, customer] = times_s[LEVEL, customer] = fly_s
    times_s[SPARE, customer] = GROUND_WAIT_S if tables.pads else spare_s
    times_s[HOVER_LEFT, customer] = spare_s
    return True


@compiled_inner
def index_sortie(tables, plan, int_rows, times_s, customer):
    """Add a sortie to the launches and recoveries of its stops, and to the driver's work there."""
    launch, rendezvous = plan[LAUNCH, customer], plan[RENDEZVOUS, customer]
    kind = plan[KIND, customer]
    int_rows[DELAYS, customer] = 0
    times_s[RELEASE, customer] = max(tables.release_s[customer], tables.from_s[kind])
    if tables.is_timed:
        until_drop_s = tables.launch_s[kind] + tables.out_s[kind, launch, customer]
        times_s[RELEASE, customer] = max(
            times_s[RELEASE, customer], tables.timed[OPENS, customer] - until_drop_s
        )
    int_rows[NEXT_LAUNCH, customer] = int_rows[FIRST_LAUNCH, launch]
    int_rows[FIRST_LAUNCH, launch] = customer
    int_rows[NEXT_RECOVERY, customer] = int_rows[FIRST_RECOVERY, rendezvous]
    int_rows[FIRST_RECOVERY, rendezvous] = customer
    times_s[WORK_AFTER, int_rows[POSITION, launch]] += tables.launch_s[kind]
    times_s[WORK_AFTER, int_rows[POSITION, rendezvous]] += tables.recover_s[kind]


@compiled_inner
def index_route(tables, plan, int_rows, times_s):
    """Index node positions and the work of deliveries; return the position count."""
    end = plan.shape[1] - 1
    for node in range(end + 1):
        int_rows[POSITION, node] = NOWHERE
        int_rows[FIRST_LAUNCH, node] = NOWHERE
        int_rows[FIRST_RECOVERY, node] = NOWHERE
    at = 0
    while True:
        node = plan[ROUTE, at]
        int_rows[POSITION, node] = at
        times_s[WORK_AFTER, at] = tables.deliver_s[node]
        at += 1
        if node == end:
            return at


@compiled_inner
def accumulate_remaining_work(tables, plan, times_s, first_index, last_index):
    """Accumulate the remaining work from each of these positions."""
    for at in range(last_index, first_index - 1, -1):
        hop_s = tables.travel_s[plan[ROUTE, at], plan[ROUTE, at + 1]]
        times_s[WORK_AFTER, at] += times_s[WORK_AFTER, at + 1] + hop_s


@compiled_inner
def index_plan(tables, plan, int_rows, times_s):
    """Index positions, sorties and work; return the position count, 0 if a sortie is infeasible."""
    position_count = index_route(tables, plan, int_rows, times_s)
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] == NOWHERE:
            continue
        at = int_rows[POSITION, plan[LAUNCH, customer]]
        if at < 0 or int_rows[POSITION, plan[RENDEZVOUS, customer]] < at:
            return 0
        if not store_flight_if_feasible(tables, plan, times_s, customer):
            return 0
        index_sortie(tables, plan, int_rows, times_s, customer)
    accumulate_remaining_work(tables, plan, times_s, 0, position_count - 2)
    return position_count


@compiled_inner
def _mark_pending_sorties_of_node(plan, int_rows, times_s, node):
    """Mark the sorties of this node: 1 pending launch (loops too), 2 pending recovery."""
    customer = int_rows[FIRST_LAUNCH, node]
    while customer >= 0:
        int_rows[PENDING, customer] = 1
        times_s[BLOCKED, customer] = 0.0
        customer = int_rows[NEXT_LAUNCH, customer]
    customer = int_rows[FIRST_RECOVERY, node]
    while customer >= 0:
        if plan[LAUNCH, customer] != node:
            int_rows[PENDING, customer] = 2
        customer = int_rows[NEXT_RECOVERY, customer]


@compiled_inner
def _delay_launch_within_limit(tables, plan, int_rows, times_s, customer, launched_s):
    """Delay the launch of this drone; return False at the limit of delays."""
    int_rows[DELAYS, customer] += 1
    if int_rows[DELAYS, customer] > MAX_DELAYS:
        return False
    times_s[RELEASE, customer] = launched_s - tables.launch_s[plan[KIND, customer]]
    return True


@compiled_inner
def _launch_precedes(plan, int_rows, times_s, first_customer, second_customer):
    """Return whether the first launch precedes: LATE last, then by recovery stop and time."""
    late = (plan[ORDER, first_customer] & LATE) - (plan[ORDER, second_customer] & LATE)
    if late != 0:
        return late < 0
    sooner = (
        int_rows[POSITION, plan[RENDEZVOUS, first_customer]]
        - int_rows[POSITION, plan[RENDEZVOUS, second_customer]]
    )
    if sooner != 0:
        return sooner < 0
    return times_s[LEVEL, first_customer] > times_s[LEVEL, second_customer]


@compiled_inner
def _next_launch_and_times(plan, int_rows, times_s, available, node, now_s):
    """Return the launch to do now (or NOWHERE), time of the next possible one, number left."""
    selected, later_s, left = NOWHERE, INFEASIBLE_S, 0
    customer = int_rows[FIRST_LAUNCH, node]
    while customer >= 0:
        if int_rows[PENDING, customer] == 1:
            left += 1
            if available[plan[KIND, customer]] > 0:
                from_s = max(times_s[RELEASE, customer], times_s[BLOCKED, customer])
                if from_s > now_s + EPSILON_S:
                    later_s = min(later_s, from_s)
                elif selected < 0 or _launch_precedes(plan, int_rows, times_s, customer, selected):
                    selected = customer
        customer = int_rows[NEXT_LAUNCH, customer]
    return selected, later_s, left


@compiled_inner
def _next_recovery_and_times(plan, int_rows, times_s, node, now_s):
    """Return the recovery to do now (or NOWHERE), its deadline, time of the next possible one,
    arrival of the next marked AT_ONCE, number left."""
    selected, deadline_s, left = NOWHERE, INFEASIBLE_S, 0
    later_s, immediate_s = INFEASIBLE_S, INFEASIBLE_S
    customer = int_rows[FIRST_RECOVERY, node]
    while customer >= 0:
        if int_rows[PENDING, customer] == 2:
            left += 1
            ready_s = times_s[LAUNCHED, customer] + times_s[FLY, customer]
            if ready_s > now_s + EPSILON_S:
                later_s = min(later_s, ready_s)
                if plan[ORDER, customer] & IMMEDIATE:
                    immediate_s = min(immediate_s, ready_s)
            elif ready_s + times_s[SPARE, customer] < deadline_s:
                selected, deadline_s = customer, ready_s + times_s[SPARE, customer]
        customer = int_rows[NEXT_RECOVERY, customer]
    return selected, deadline_s, later_s, immediate_s, left


@compiled_inner
def _is_launch_first(plan, launch, recovery, is_delivery_pending, ends_s, deadline_s):
    """Return whether this launch precedes the other possible tasks."""
    if recovery >= 0 and (deadline_s < ends_s or plan[ORDER, recovery] & IMMEDIATE):
        return False
    return not (plan[ORDER, launch] & LATE and (recovery >= 0 or is_delivery_pending))


@compiled_inner
def _drone_landing_before(int_rows, times_s, node, earliest_landing_s):
    """Return a drone that would land at this node before `earliest_landing_s`, or NOWHERE."""
    customer = int_rows[FIRST_RECOVERY, node]
    while customer >= 0:
        landed_s = times_s[LAUNCHED, customer] + times_s[FLY, customer]
        if int_rows[PENDING, customer] == 2 and landed_s < earliest_landing_s - EPSILON_S:
            return customer
        customer = int_rows[NEXT_RECOVERY, customer]
    return NOWHERE


@compiled_inner
def _process_driver_tasks_at_stop(tables, plan, int_rows, times_s, available, route_index):
    """Process all tasks at this position. Returns (departure, next position; -1: infeasible)."""
    air, launch_s, recover_s = tables.air, tables.launch_s, tables.recover_s
    deliver_s = tables.deliver_s[plan[ROUTE, route_index]]
    node, now_s = plan[ROUTE, route_index], times_s[ARRIVE, route_index]
    airborne_s = now_s
    _mark_pending_sorties_of_node(plan, int_rows, times_s, node)
    deliver, logged = deliver_s > 0.0, int_rows[LOGGED, route_index]
    opens_s = tables.timed[OPENS, node] if tables.is_timed else -INFEASIBLE_S
    while True:
        open_delivery = deliver and now_s >= opens_s - EPSILON_S
        launch, later_launch_s, launches = _next_launch_and_times(
            plan, int_rows, times_s, available, node, now_s
        )
        recovery, deadline_s, later_recovery_s, immediate_s, recoveries = _next_recovery_and_times(
            plan, int_rows, times_s, node, now_s
        )
        if launches == 0 and recoveries == 0 and not deliver:
            if route_index + 1 < int_rows.shape[1]:
                int_rows[LOGGED, route_index + 1] = logged
            return max(now_s, airborne_s), route_index + 1
        if launch >= 0:
            ends_s = now_s + launch_s[plan[KIND, launch]]
            if not _is_launch_first(plan, launch, recovery, open_delivery, ends_s, deadline_s):
                launch = NOWHERE
        if launch >= 0:
            duration_s = launch_s[plan[KIND, launch]]
        elif recovery >= 0:
            duration_s = recover_s[plan[KIND, recovery]]
        elif open_delivery:
            duration_s = deliver_s
        else:
            now_s = min(later_launch_s, later_recovery_s)
            if deliver:
                now_s = min(now_s, opens_s)
            if now_s == INFEASIBLE_S:
                return INFEASIBLE_S, -1
            continue
        if now_s + duration_s > immediate_s + EPSILON_S:
            now_s = immediate_s
            continue
        if launch >= 0:
            if air.priced:
                layer, free_s = find_free_layer_and_store_geometry(
                    air,
                    plan,
                    int_rows,
                    times_s,
                    launch,
                    now_s + duration_s,
                    available[plan[KIND, launch]],
                    logged,
                )
                if layer < 0:
                    if free_s == INFEASIBLE_S:
                        return INFEASIBLE_S, -1
                    times_s[BLOCKED, launch] = max(free_s - duration_s, now_s + 2.0 * EPSILON_S)
                    continue
                int_rows[LAYER, launch], int_rows[LOG, logged] = layer, launch
                logged += 1
            times_s[LAUNCHED, launch] = now_s + duration_s
            airborne_s = now_s + duration_s + tables.takeoff_wait_s
            available[plan[KIND, launch]] -= 1
            int_rows[PENDING, launch] = 2 if plan[RENDEZVOUS, launch] == node else 0
        elif recovery >= 0:
            if now_s > deadline_s + EPSILON_S:
                launched_s = now_s - times_s[FLY, recovery] - times_s[SPARE, recovery]
                if not _delay_launch_within_limit(
                    tables, plan, int_rows, times_s, recovery, launched_s
                ):
                    return INFEASIBLE_S, -1
                return now_s, int_rows[POSITION, plan[LAUNCH, recovery]]
            times_s[RECOVERED, recovery] = now_s
            available[plan[KIND, recovery]] += 1
            int_rows[PENDING, recovery] = 0
        else:
            times_s[DELIVERED, node] = now_s
            deliver = False
        now_s += duration_s


@compiled_inner
def simulate_stop_and_next_arrival(tables, plan, work_arrays, route_index):
    """Process this position from arrival to departure, and set the next arrival.

    Returns the position to continue from: the next one, an earlier one if a launch was delayed, or
    -1: infeasible.
    """
    int_rows, times_s, drones_on_truck = work_arrays.whole, work_arrays.times_s, work_arrays.free
    available = drones_on_truck[drones_on_truck.shape[0] - 1]
    for kind in range(len(available)):
        available[kind] = drones_on_truck[route_index, kind]
    node = plan[ROUTE, route_index]
    if tables.pads:
        _mark_pending_sorties_of_node(plan, int_rows, times_s, node)
        landed_s = times_s[ARRIVE, route_index] + tables.lead_s
        early = _drone_landing_before(int_rows, times_s, node, landed_s)
        if early >= 0:
            launched_s = landed_s - times_s[FLY, early]
            if not _delay_launch_within_limit(tables, plan, int_rows, times_s, early, launched_s):
                return -1
            return int_rows[POSITION, plan[LAUNCH, early]]
    depart_s, next_position = _process_driver_tasks_at_stop(
        tables, plan, int_rows, times_s, available, route_index
    )
    if next_position > route_index:
        if route_index == 0:
            depart_s = max(depart_s, tables.hold_s)
        times_s[DEPART, route_index] = depart_s
        if node != plan.shape[1] - 1:
            times_s[ARRIVE, next_position] = (
                depart_s + tables.travel_s[node, plan[ROUTE, next_position]]
            )
            for kind in range(len(available)):
                drones_on_truck[next_position, kind] = available[kind]
    return next_position


@compiled_inner
def initialise_drones_on_truck(tables, plan, drones_on_truck):
    """Initialise the drones on the truck: all that the plan uses."""
    for kind in range(drones_on_truck.shape[1]):
        unused = plan[IDLE, kind] if kind < plan.shape[1] else 0
        drones_on_truck[0, kind] = tables.fleet[kind] - unused


@compiled
def simulate_cost_s(tables, plan, work_arrays, cost_limit_s):
    """Return the makespan plus the cost of late and urgent orders, s; inf if the plan is infeasible
    or its makespan exceeds `cost_limit_s`."""
    whole, times_s = work_arrays.whole, work_arrays.times_s
    position_count = index_plan(tables, plan, whole, times_s)
    if position_count == 0:
        return INFEASIBLE_S
    initialise_drones_on_truck(tables, plan, work_arrays.free)
    times_s[ARRIVE, 0], whole[LOGGED, 0] = 0.0, 0
    at = 0
    while at < position_count:
        if times_s[ARRIVE, at] + times_s[WORK_AFTER, at] > cost_limit_s:
            return INFEASIBLE_S
        at = simulate_stop_and_next_arrival(tables, plan, work_arrays, at)
        if at < 0:
            return INFEASIBLE_S
    return times_s[DEPART, position_count - 1] + timed_cost_s(tables, plan, times_s)
