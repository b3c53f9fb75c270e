"""Incremental makespan of a plan that differs little from a simulated plan.

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
    GROUND_WAIT_S,
    INFEASIBLE_S,
    initialise_drones_on_truck,
    simulate_makespan_s,
    simulate_stop_and_next_arrival,
)
from ground_station.core.truck_drones.tables import (
    ARRIVE,
    DELAYS,
    DEPART,
    FIRST_LAUNCH,
    FIRST_RECOVERY,
    FLY,
    FURTHEST,
    HOVER_LEFT,
    IDLE,
    KIND,
    LAUNCH,
    LAUNCHED,
    LEVEL,
    NEXT_LAUNCH,
    NEXT_RECOVERY,
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


@compiled_inner
def simulate_and_store(tables, plan, work_arrays):
    """Simulate a plan and store the state for `incremental_makespan_s` in `work_arrays`; return the
    makespan.
    """
    makespan_s = simulate_makespan_s(tables, plan, work_arrays, INFEASIBLE_S)
    _store_restart_and_span_rows(plan, work_arrays.whole)
    return makespan_s


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
def _recovery_time_of_customer_s(
    plan,
    base_work_arrays,
    work_arrays,
    first_simulated_index,
    end_simulated_index,
    shift_s,
    customer,
):
    """Return the recovery time of a customer's drone after `incremental_makespan_s`."""
    rendezvous = work_arrays.whole[POSITION, plan[RENDEZVOUS, customer]]
    if rendezvous < first_simulated_index:
        return base_work_arrays.times_s[RECOVERED, customer]
    return (
        work_arrays.times_s[RECOVERED, customer]
        if rendezvous < end_simulated_index
        else base_work_arrays.times_s[RECOVERED, customer] + shift_s
    )


@compiled_inner
def changed_drone_time_away_s(
    plan, base_work_arrays, work_arrays, first_simulated_index, end_simulated_index, shift_s
):
    """Return the total time of all drones away from the truck, after `incremental_makespan_s`."""
    away_s = 0.0
    for customer in range(1, plan.shape[1] - 1):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        position = work_arrays.whole[POSITION, launch]
        if position < first_simulated_index:
            launched_s = base_work_arrays.times_s[LAUNCHED, customer]
        elif position < end_simulated_index:
            launched_s = work_arrays.times_s[LAUNCHED, customer]
        else:
            launched_s = base_work_arrays.times_s[LAUNCHED, customer] + shift_s
        away_s += (
            _recovery_time_of_customer_s(
                plan,
                base_work_arrays,
                work_arrays,
                first_simulated_index,
                end_simulated_index,
                shift_s,
                customer,
            )
            - launched_s
        )
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
def commit_changed_simulation(
    tables, plan, base_work_arrays, work_arrays, first_simulated_index, end_simulated_index, shift_s
):
    """Commit a simulation of `incremental_makespan_s`, which covered positions
    `first_simulated_index` to `end_simulated_index` - 1, to `base_work_arrays`: earlier positions
    are unchanged, later ones shifted.
    """
    whole, times_s, free = work_arrays.whole, work_arrays.times_s, work_arrays.free
    old_whole, old_times_s, old_free = (
        base_work_arrays.whole,
        base_work_arrays.times_s,
        base_work_arrays.free,
    )
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
        times_s[RECOVERED, customer] = _recovery_time_of_customer_s(
            plan,
            base_work_arrays,
            work_arrays,
            first_simulated_index,
            end_simulated_index,
            shift_s,
            customer,
        )
    if tables.air.priced:
        merge_launch_log_into_base(
            plan,
            base_work_arrays,
            work_arrays,
            first_simulated_index,
            end_simulated_index,
            position_count,
        )
    for node in range(end + 1):
        for row in (POSITION, DELAYS, FIRST_LAUNCH, NEXT_LAUNCH):
            old_whole[row, node] = whole[row, node]
        for row in (ARRIVE, DEPART, LAUNCHED, RECOVERED, FLY, SPARE, RELEASE, LEVEL, HOVER_LEFT):
            old_times_s[row, node] = times_s[row, node]
        for kind in range(free.shape[1]):
            old_free[node, kind] = free[node, kind]
    _store_restart_and_span_rows(plan, old_whole)


@compiled_inner
def _index_changed_sorties(
    tables,
    base_plan,
    base_int_rows,
    base_times_s,
    plan,
    int_rows,
    times_s,
    first_changed_index,
    last_changed_index,
):
    """Index sorties by node, as simulate.py does, but copy unchanged flights.

    `first_changed_index`, `last_changed_index`: first and last changed route positions. Returns
    them extended by the changed sorties; (-1, -1) if a sortie is infeasible.
    """
    launch_s, recover_s, out_s, back_s = (
        tables.launch_s,
        tables.recover_s,
        tables.out_s,
        tables.back_s,
    )
    out_hover_s, back_hover_s, endurance_s = (
        tables.out_hover_s,
        tables.back_hover_s,
        tables.endurance_hover_s,
    )
    release_s, from_s = tables.release_s, tables.from_s
    end = plan.shape[1] - 1
    added_positions = int_rows[POSITION, end] - base_int_rows[POSITION, end]
    for customer in range(1, end):
        launch = plan[LAUNCH, customer]
        changed = sortie_differs(base_plan, plan, customer)
        if changed and base_plan[LAUNCH, customer] != NOWHERE:
            first_changed_index = min(
                first_changed_index, base_int_rows[POSITION, base_plan[LAUNCH, customer]]
            )
            last_changed_index = max(
                last_changed_index,
                base_int_rows[POSITION, base_plan[RENDEZVOUS, customer]] + added_positions,
            )
        if launch == NOWHERE:
            continue
        rendezvous, kind = plan[RENDEZVOUS, customer], plan[KIND, customer]
        at, to = int_rows[POSITION, launch], int_rows[POSITION, rendezvous]
        if at < 0 or to < at:
            return -1, -1
        if changed:
            first_changed_index, last_changed_index = (
                min(first_changed_index, at),
                max(last_changed_index, to),
            )
            if (launch == rendezvous and not tables.pads) or (
                launch != rendezvous and tables.loops_only
            ):
                return -1, -1
            spare_s = (endurance_s[kind] - out_hover_s[kind, launch, customer]) - back_hover_s[
                kind, customer, rendezvous
            ]
            if not spare_s >= 0.0:
                return -1, -1
            times_s[SPARE, customer] = GROUND_WAIT_S if tables.pads else spare_s
            times_s[FLY, customer] = (
                out_s[kind, launch, customer] + back_s[kind, customer, rendezvous]
            )
            times_s[LEVEL, customer], times_s[HOVER_LEFT, customer] = (
                times_s[FLY, customer],
                spare_s,
            )
        else:
            times_s[SPARE, customer] = base_times_s[SPARE, customer]
            times_s[FLY, customer] = base_times_s[FLY, customer]
            times_s[LEVEL, customer] = base_times_s[LEVEL, customer]
            times_s[HOVER_LEFT, customer] = base_times_s[HOVER_LEFT, customer]
        int_rows[DELAYS, customer] = 0
        times_s[RELEASE, customer] = max(release_s[customer], from_s[kind])
        int_rows[NEXT_LAUNCH, customer] = int_rows[FIRST_LAUNCH, launch]
        int_rows[FIRST_LAUNCH, launch] = customer
        int_rows[NEXT_RECOVERY, customer] = int_rows[FIRST_RECOVERY, rendezvous]
        int_rows[FIRST_RECOVERY, rendezvous] = customer
        times_s[WORK_AFTER, at] += launch_s[kind]
        times_s[WORK_AFTER, to] += recover_s[kind]
    return first_changed_index, last_changed_index


@compiled_inner
def _index_route_and_changed_range(tables, base_plan, base_int_rows, plan, int_rows, times_s):
    """Index node positions, as simulate.py does. Returns the number of positions, the length of the
    prefix equal to the old plan's, and the last position before the equal suffix.
    """
    deliver_s = tables.deliver_s
    end = plan.shape[1] - 1
    for node in range(end + 1):
        int_rows[POSITION, node] = NOWHERE
        int_rows[FIRST_LAUNCH, node] = NOWHERE
        int_rows[FIRST_RECOVERY, node] = NOWHERE
    at, first = 0, 0
    while True:
        node = plan[ROUTE, at]
        int_rows[POSITION, node] = at
        times_s[WORK_AFTER, at] = deliver_s[node]
        if first == at and base_plan[ROUTE, at] == node:
            first = at + 1
        if node == end:
            break
        at += 1
    if first > at:
        return at + 1, first, NOWHERE
    last, before = at, base_int_rows[POSITION, end]
    while plan[ROUTE, last] == base_plan[ROUTE, before]:
        last -= 1
        before -= 1
    return at + 1, first, last


@compiled_inner
def _accumulate_remaining_work(tables, plan, times_s, first_index, last_index):
    """Accumulate the remaining work from each of these positions."""
    travel_s = tables.travel_s
    for at in range(last_index, first_index - 1, -1):
        hop_s = travel_s[plan[ROUTE, at], plan[ROUTE, at + 1]]
        times_s[WORK_AFTER, at] += times_s[WORK_AFTER, at + 1] + hop_s


@compiled_inner
def _restore_base_state_in_range(
    tables, base_work_arrays, plan, work_arrays, first_index, end_index
):
    """Restore the old state before `end_index`, since a launch before it is delayed."""
    whole, times_s, free = work_arrays.whole, work_arrays.times_s, work_arrays.free
    old_whole, old_times_s, old_free = (
        base_work_arrays.whole,
        base_work_arrays.times_s,
        base_work_arrays.free,
    )
    for at in range(first_index, end_index):
        times_s[ARRIVE, at] = old_times_s[ARRIVE, at]
        for kind in range(free.shape[1]):
            free[at, kind] = old_free[at, kind]
    if tables.air.priced:
        copy_earlier_launch_log(tables.air, base_work_arrays, work_arrays, first_index)
    _accumulate_remaining_work(tables, plan, times_s, first_index, end_index - 1)
    for customer in range(1, plan.shape[1] - 1):
        if (
            plan[LAUNCH, customer] != NOWHERE
            and whole[POSITION, plan[RENDEZVOUS, customer]] < end_index
        ):
            whole[DELAYS, customer] = old_whole[DELAYS, customer]
            times_s[RELEASE, customer] = old_times_s[RELEASE, customer]


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
def incremental_makespan_s(
    tables, base_plan, base_work_arrays, base_makespan_s, plan, work_arrays, makespan_limit_s
):
    """Simulate a plan near `base_plan`, whose makespan is `base_makespan_s`, simulation in
    `base_work_arrays` (by `simulate_and_store` or `commit_changed_simulation`).

    Returns the makespan, and for `commit_changed_simulation` the first simulated position, the one
    after the last, and the time shift there. The positions are 0 if nothing has changed.
    """
    whole, times_s, free = work_arrays.whole, work_arrays.times_s, work_arrays.free
    old_whole, old_times_s, old_free = (
        base_work_arrays.whole,
        base_work_arrays.times_s,
        base_work_arrays.free,
    )
    launch_s, recover_s = tables.launch_s, tables.recover_s
    position_count, first, last = _index_route_and_changed_range(
        tables, base_plan, old_whole, plan, whole, times_s
    )
    first, last = _index_changed_sorties(
        tables, base_plan, old_whole, old_times_s, plan, whole, times_s, first, last
    )
    if first < 0:
        return INFEASIBLE_S, 0, 0, 0.0
    end = plan.shape[1] - 1
    for kind in range(min(free.shape[1], end + 1)):
        if plan[IDLE, kind] != base_plan[IDLE, kind]:
            first, last = 0, position_count
    if first == position_count:
        return base_makespan_s, 0, 0, 0.0
    begin = old_whole[RESTART, first]
    _accumulate_remaining_work(tables, plan, times_s, begin, position_count - 2)
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
    if tables.air.priced:
        copy_earlier_launch_log(tables.air, base_work_arrays, work_arrays, begin)

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
        if times_s[ARRIVE, at] + times_s[WORK_AFTER, at] > makespan_limit_s:
            return INFEASIBLE_S, 0, 0, 0.0
        if at > last:
            arrived_s = old_times_s[ARRIVE, at - added_positions]
            now_s = times_s[ARRIVE, at] - arrived_s
            if abs(now_s - shift_s) > SAME_SHIFT_S:
                shift_s, others, uniform = now_s, max(others, uniform), NOWHERE
            if (
                others < at
                and old_whole[SPANNED, at - added_positions] == 0
                and min(arrived_s, arrived_s + now_s) >= tables.fixed_until_s
                and _has_same_available_drones(free, at, old_free, at - added_positions)
                and (
                    not tables.air.priced
                    or has_same_airborne_sorties(
                        tables.air,
                        base_plan,
                        base_work_arrays,
                        plan,
                        work_arrays,
                        at,
                        at - added_positions,
                    )
                )
            ):
                return base_makespan_s + now_s, begin, at, now_s
        next_position = simulate_stop_and_next_arrival(
            tables, plan, whole, times_s, free, launch_s, recover_s, at
        )
        if next_position < 0:
            return INFEASIBLE_S, 0, 0, 0.0
        if next_position <= at:
            if next_position < begin:
                _restore_base_state_in_range(
                    tables, base_work_arrays, plan, work_arrays, next_position, begin
                )
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
    return times_s[DEPART, position_count - 1], begin, position_count, 0.0
