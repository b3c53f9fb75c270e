"""Incremental cost of a plan that differs little from a simulated plan.

The pass along the route begins where the first change takes effect, and ends where the truck
arrives in the old plan's state except for a time shift: from there the old plan's times hold,
shifted. The result equals that of `simulate` (to rounding) at a fraction of the cost.
"""

from ground_station.core.truck_drones.compiled import compiled_inner
from ground_station.core.truck_drones.layers.changed_air import (
    SAME_SHIFT_S,
    copy_earlier_launch_log,
    has_same_airborne_sorties,
    merge_launch_log_into_base,
    sortie_differs,
)
from ground_station.core.truck_drones.simulate import (
    INFEASIBLE_S,
    accumulate_remaining_work,
    index_route,
    index_sortie,
    initialise_drones_on_truck,
    simulate_cost_s,
    simulate_stop_and_next_arrival,
    store_flight_if_feasible,
)
from ground_station.core.truck_drones.tables import (
    ARRIVE,
    DELAYS,
    DELIVERED,
    DEPART,
    FIRST_LAUNCH,
    FLY,
    FURTHEST,
    HOVER_LEFT,
    IDLE,
    LAUNCH,
    LAUNCHED,
    LEVEL,
    NEXT_LAUNCH,
    NOWHERE,
    POSITION,
    RECOVERED,
    RELEASE,
    RENDEZVOUS,
    RESTART,
    ROUTE,
    SPANNED,
    SPARE,
    WORK_AFTER,
)
from ground_station.core.truck_drones.timed_cost import timed_cost_s

UNCHANGED = (0, 0, 0.0)
"""The simulated part if there is none."""


@compiled_inner
def simulate_and_store(tables, plan, work_arrays):
    """Simulate a plan and store the state for `incremental_cost_s` in `work_arrays`; return the
    cost.
    """
    cost_s = simulate_cost_s(tables, plan, work_arrays, INFEASIBLE_S)
    _store_restart_and_span_rows(plan, work_arrays.whole)
    return cost_s


@compiled_inner
def _store_restart_and_span_rows(plan, int_rows):
    """Compute by route position: where a pass must begin to leave earlier positions unchanged
    (RESTART), whether a delayed sortie is airborne (SPANNED), and the last rendezvous of the
    airborne sorties (FURTHEST).
    """
    end = plan.shape[1] - 1
    position_count = int_rows[POSITION, end] + 1
    for at in range(position_count):
        int_rows[RESTART, at] = at
        int_rows[SPANNED, at] = 0
        int_rows[FURTHEST, at] = NOWHERE
    for customer in range(1, end):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        first, last = int_rows[POSITION, launch], int_rows[POSITION, plan[RENDEZVOUS, customer]]
        pushed = int_rows[DELAYS, customer] > 0
        # The order of two launches at one stop depends on their rendezvous.
        shared_launch_stop = (
            int_rows[NEXT_LAUNCH, customer] != NOWHERE or int_rows[FIRST_LAUNCH, launch] != customer
        )
        for at in range(first + 1, last + 1):
            int_rows[FURTHEST, at] = max(int_rows[FURTHEST, at], last)
            if pushed or shared_launch_stop:
                int_rows[RESTART, at] = min(int_rows[RESTART, at], first)
            if pushed:
                int_rows[SPANNED, at] = 1
    for at in range(position_count):
        int_rows[RESTART, at] = int_rows[RESTART, int_rows[RESTART, at]]


@compiled_inner
def _time_after_change_s(change, row, customer, route_index, simulated):
    """Return a time of a customer's sortie at this position, after `incremental_cost_s`."""
    first, end, shift_s = simulated
    if route_index < first:
        return change.work.times_s[row, customer]
    if route_index < end:
        return change.new_work.times_s[row, customer]
    return change.work.times_s[row, customer] + shift_s


@compiled_inner
def changed_drone_time_away_s(change, simulated):
    """Return the total time of all drones away from the truck, after `incremental_cost_s`."""
    away_s, plan, whole = 0.0, change.new_plan, change.new_work.whole
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] == NOWHERE:
            continue
        at, to = (
            whole[POSITION, plan[LAUNCH, customer]],
            whole[POSITION, plan[RENDEZVOUS, customer]],
        )
        launched_s = _time_after_change_s(change, LAUNCHED, customer, at, simulated)
        away_s += _time_after_change_s(change, RECOVERED, customer, to, simulated) - launched_s
    return away_s


@compiled_inner
def total_drone_time_away_s(plan, work_arrays):
    """Return the total time of all drones away from the truck, after a full simulation."""
    total_s = 0.0
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] != NOWHERE:
            total_s += (
                work_arrays.times_s[RECOVERED, customer] - work_arrays.times_s[LAUNCHED, customer]
            )
    return total_s


@compiled_inner
def commit_changed_simulation(change, simulated):
    """Commit a simulation of `incremental_cost_s` to the work arrays of the plan: earlier
    positions than `simulated` are unchanged, later ones shifted.
    """
    plan, new, old = change.new_plan, change.new_work, change.work
    whole, times_s, free = new.whole, new.times_s, new.free
    old_whole, old_times_s, old_free = old.whole, old.times_s, old.free
    first_simulated_index, end_simulated_index, shift_s = simulated
    end = plan.shape[1] - 1
    position_count = whole[POSITION, end] + 1
    added_positions = position_count - 1 - old_whole[POSITION, end]
    for to in range(first_simulated_index):
        times_s[ARRIVE, to], times_s[DEPART, to] = old_times_s[ARRIVE, to], old_times_s[DEPART, to]
        for kind in range(free.shape[1]):
            free[to, kind] = old_free[to, kind]
    for to in range(end_simulated_index, position_count):
        times_s[ARRIVE, to] = old_times_s[ARRIVE, to - added_positions] + shift_s
        times_s[DEPART, to] = old_times_s[DEPART, to - added_positions] + shift_s
        for kind in range(free.shape[1]):
            free[to, kind] = old_free[to - added_positions, kind]
    for customer in range(1, end):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        if whole[POSITION, launch] < first_simulated_index:
            whole[DELAYS, customer] = old_whole[DELAYS, customer]
            times_s[RELEASE, customer] = old_times_s[RELEASE, customer]
        elif whole[POSITION, launch] >= end_simulated_index:
            times_s[LAUNCHED, customer] = old_times_s[LAUNCHED, customer] + shift_s
            whole[DELAYS, customer] = old_whole[DELAYS, customer]
            if old_whole[DELAYS, customer] > 0:
                times_s[RELEASE, customer] = old_times_s[RELEASE, customer] + shift_s
        to = whole[POSITION, plan[RENDEZVOUS, customer]]
        times_s[RECOVERED, customer] = _time_after_change_s(
            change, RECOVERED, customer, to, simulated
        )
    if change.tables.air.priced:
        merge_launch_log_into_base(
            plan, old, new, first_simulated_index, end_simulated_index, position_count
        )
    for node in range(end + 1):
        for row in (POSITION, DELAYS, FIRST_LAUNCH, NEXT_LAUNCH):
            old_whole[row, node] = whole[row, node]
        for row in (ARRIVE, DEPART, LAUNCHED, RECOVERED, FLY, SPARE, RELEASE, LEVEL, HOVER_LEFT):
            old_times_s[row, node] = times_s[row, node]
        old_times_s[DELIVERED, node] = times_s[DELIVERED, node]
        for kind in range(free.shape[1]):
            old_free[node, kind] = free[node, kind]
    _store_restart_and_span_rows(plan, old_whole)


@compiled_inner
def _index_changed_sorties(change, first_changed_index, last_changed_index):
    """Index sorties by node, but copy unchanged flights.

    `first_changed_index`, `last_changed_index`: first and last changed route positions. Returns
    them extended by the changed sorties; (-1, -1) if a sortie is infeasible.
    """
    tables, plan, base_plan = change.tables, change.new_plan, change.plan
    whole, times_s, old_whole = change.new_work.whole, change.new_work.times_s, change.work.whole
    end = plan.shape[1] - 1
    added_positions = whole[POSITION, end] - old_whole[POSITION, end]
    for customer in range(1, end):
        changed = sortie_differs(base_plan, plan, customer)
        if changed and base_plan[LAUNCH, customer] != NOWHERE:
            at = old_whole[POSITION, base_plan[LAUNCH, customer]]
            to = old_whole[POSITION, base_plan[RENDEZVOUS, customer]] + added_positions
            first_changed_index = min(first_changed_index, at)
            last_changed_index = max(last_changed_index, to)
        if plan[LAUNCH, customer] == NOWHERE:
            continue
        at, to = (
            whole[POSITION, plan[LAUNCH, customer]],
            whole[POSITION, plan[RENDEZVOUS, customer]],
        )
        if at < 0 or to < at:
            return -1, -1
        if changed:
            first_changed_index = min(first_changed_index, at)
            last_changed_index = max(last_changed_index, to)
            if not store_flight_if_feasible(tables, plan, times_s, customer):
                return -1, -1
        else:
            for row in (SPARE, FLY, LEVEL, HOVER_LEFT):
                times_s[row, customer] = change.work.times_s[row, customer]
        index_sortie(tables, plan, whole, times_s, customer)
    return first_changed_index, last_changed_index


@compiled_inner
def _changed_route_range(base_plan, base_position_count, plan, position_count):
    """Return the length of the prefix of the route equal to the old plan's, and the last position
    before the equal suffix.
    """
    first = 0
    while first < position_count and base_plan[ROUTE, first] == plan[ROUTE, first]:
        first += 1
    if first == position_count:
        return first, NOWHERE
    last, before = position_count - 1, base_position_count - 1
    while plan[ROUTE, last] == base_plan[ROUTE, before]:
        last -= 1
        before -= 1
    return first, last


@compiled_inner
def _restore_base_state_in_range(change, first_index, end_index):
    """Restore the old state before `end_index`, since a launch before it is delayed."""
    plan, new, old = change.new_plan, change.new_work, change.work
    for at in range(first_index, end_index):
        new.times_s[ARRIVE, at] = old.times_s[ARRIVE, at]
        for kind in range(new.free.shape[1]):
            new.free[at, kind] = old.free[at, kind]
    if change.tables.air.priced:
        copy_earlier_launch_log(change.tables.air, old, new, first_index)
    accumulate_remaining_work(change.tables, plan, new.times_s, first_index, end_index - 1)
    for customer in range(1, plan.shape[1] - 1):
        if (
            plan[LAUNCH, customer] != NOWHERE
            and new.whole[POSITION, plan[RENDEZVOUS, customer]] < end_index
        ):
            new.whole[DELAYS, customer] = old.whole[DELAYS, customer]
            new.times_s[RELEASE, customer] = old.times_s[RELEASE, customer]


@compiled_inner
def _has_same_available_drones(
    drones_on_truck, route_index, base_drones_on_truck, base_route_index
):
    alike = True
    for kind in range(drones_on_truck.shape[1]):
        alike = (
            alike
            and drones_on_truck[route_index, kind] == base_drones_on_truck[base_route_index, kind]
        )
    return alike


@compiled_inner
def _copy_deliveries_from_base(change, first_index):
    """Copy the times of deliveries by truck and of launches from this position on."""
    plan, new, old = change.new_plan, change.new_work, change.work
    for customer in range(1, plan.shape[1] - 1):
        launch = plan[LAUNCH, customer]
        at = new.whole[POSITION, customer if launch == NOWHERE else launch]
        if at >= first_index:
            new.times_s[LAUNCHED, customer] = old.times_s[LAUNCHED, customer]
            new.times_s[DELIVERED, customer] = old.times_s[DELIVERED, customer]


@compiled_inner
def incremental_cost_s(change, cost_limit_s):
    """Simulate the changed plan, starting from the simulation of the plan.

    Returns the cost, and for `commit_changed_simulation` the simulated part: its first
    position, the one after the last, and the time shift there. The positions are 0 if nothing has
    changed.
    """
    tables, plan, base_plan = change.tables, change.new_plan, change.plan
    new, old, base_cost_s = change.new_work, change.work, change.costs_s[0]
    whole, times_s, free = new.whole, new.times_s, new.free
    old_whole, old_times_s, old_free = old.whole, old.times_s, old.free
    position_count = index_route(tables, plan, whole, times_s)
    first, last = _changed_route_range(
        base_plan, old_whole[POSITION, plan.shape[1] - 1] + 1, plan, position_count
    )
    first, last = _index_changed_sorties(change, first, last)
    if first < 0:
        return INFEASIBLE_S, UNCHANGED
    end = plan.shape[1] - 1
    for kind in range(min(free.shape[1], end + 1)):
        if plan[IDLE, kind] != base_plan[IDLE, kind]:
            first, last = 0, position_count
    if first == position_count:
        return base_cost_s, UNCHANGED
    begin = old_whole[RESTART, first]
    accumulate_remaining_work(tables, plan, times_s, begin, position_count - 2)
    if begin == 0:
        times_s[ARRIVE, 0] = 0.0
        initialise_drones_on_truck(tables, plan, free)
    else:
        hop_s = tables.travel_s[plan[ROUTE, begin - 1], plan[ROUTE, begin]]
        times_s[ARRIVE, begin] = old_times_s[DEPART, begin - 1] + hop_s
        for kind in range(free.shape[1]):
            free[begin, kind] = old_free[begin, kind]
        for customer in range(1, end):
            times_s[LAUNCHED, customer] = old_times_s[LAUNCHED, customer]
            times_s[DELIVERED, customer] = old_times_s[DELIVERED, customer]
    if tables.air.priced:
        copy_earlier_launch_log(tables.air, old, new, begin)

    # A drone airborne at the tail of the route was launched with a time shift. `uniform` is the
    # furthest rendezvous of drones with the latest shift, `others` of drones with another one.
    added_positions = position_count - 1 - old_whole[POSITION, end]
    uniform = (
        NOWHERE
        if old_whole[FURTHEST, begin] < 0
        else max(last, old_whole[FURTHEST, begin] + added_positions)
    )
    shift_s, others, furthest = 0.0, NOWHERE, uniform
    at = begin
    while at < position_count:
        if times_s[ARRIVE, at] + times_s[WORK_AFTER, at] > cost_limit_s:
            return INFEASIBLE_S, UNCHANGED
        if at > last:
            arrived_s = old_times_s[ARRIVE, at - added_positions]
            now_s = times_s[ARRIVE, at] - arrived_s
            if abs(now_s - shift_s) > SAME_SHIFT_S:
                shift_s, others, uniform = now_s, max(others, uniform), NOWHERE
            if (
                others < at
                and old_whole[SPANNED, at - added_positions] == 0
                and (
                    min(arrived_s, arrived_s + now_s) >= tables.fixed_until_s
                    or (tables.is_timed and abs(now_s) <= SAME_SHIFT_S)
                )
                and _has_same_available_drones(free, at, old_free, at - added_positions)
                and (
                    not tables.air.priced
                    or has_same_airborne_sorties(change, at, at - added_positions)
                )
            ):
                if not tables.is_timed:
                    return base_cost_s + now_s, (begin, at, now_s)
                _copy_deliveries_from_base(change, at)
                makespan_s = old_times_s[DEPART, position_count - 1 - added_positions]
                cost_s = makespan_s + timed_cost_s(tables, plan, times_s)
                return cost_s, (begin, at, 0.0)
        next_position = simulate_stop_and_next_arrival(tables, plan, new, at)
        if next_position < 0:
            return INFEASIBLE_S, UNCHANGED
        if next_position <= at:
            if next_position < begin:
                _restore_base_state_in_range(change, next_position, begin)
                begin = next_position
            others, uniform = max(others, furthest), NOWHERE
        else:
            customer = whole[FIRST_LAUNCH, plan[ROUTE, at]]
            while customer >= 0:
                to = whole[POSITION, plan[RENDEZVOUS, customer]]
                furthest = max(furthest, to)
                if to > last:
                    now_s = times_s[LAUNCHED, customer] - old_times_s[LAUNCHED, customer]
                    if abs(now_s - shift_s) > SAME_SHIFT_S:
                        shift_s, others, uniform = now_s, max(others, uniform), to
                    else:
                        uniform = max(uniform, to)
                customer = whole[NEXT_LAUNCH, customer]
        at = next_position
    cost_s = times_s[DEPART, position_count - 1] + timed_cost_s(tables, plan, times_s)
    return cost_s, (begin, position_count, 0.0)
