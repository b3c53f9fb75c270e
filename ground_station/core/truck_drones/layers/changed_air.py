"""Airborne sorties in a plan that differs little from another one: the launches before a route
position, and whether the same sorties are airborne there.
"""

from ground_station.core.truck_drones.compiled import compiled_inner
from ground_station.core.truck_drones.layers.layer_pricing import LOG_DEPTH_FLEETS
from ground_station.core.truck_drones.tables import (
    ARRIVE,
    CORNERS,
    FLY,
    HOME,
    KIND,
    LAUNCH,
    LAUNCHED,
    LAYER,
    LOG,
    LOGGED,
    NOWHERE,
    ORDER,
    PAD,
    PAD_N,
    POSITION,
    RENDEZVOUS,
)

SAME_SHIFT_S = 1e-8
"""Tolerance of equal time shifts: a thousand times the rounding error."""


@compiled_inner
def _copy_sortie_geometry(int_rows, times_s, target_int_rows, target_times_s, customer):
    """Copy layer, pads and corners of a sortie."""
    for row in (LAYER, PAD, HOME, CORNERS):
        target_int_rows[row, customer] = int_rows[row, customer]
    for row in range(PAD_N, PAD_N + 2 * int_rows[CORNERS, customer]):
        target_times_s[row, customer] = times_s[row, customer]


@compiled_inner
def merge_launch_log_into_base(
    plan, old, new, first_simulated_index, end_simulated_index, position_count
):
    """Combine the log of earlier launches, of the simulated positions, and of later launches."""
    whole, times_s, old_whole, old_times_s = new.whole, new.times_s, old.whole, old.times_s
    end = plan.shape[1] - 1
    before = end_simulated_index - (position_count - 1 - old_whole[POSITION, end])
    if end_simulated_index < position_count:
        later, total = whole[LOGGED, end_simulated_index] - old_whole[LOGGED, before], 0
        for customer in range(1, end):
            total += 1 if plan[LAUNCH, customer] != NOWHERE else 0
        for number in range(whole[LOGGED, end_simulated_index], total):
            whole[LOG, number] = old_whole[LOG, number - later]
        for to in range(end_simulated_index, position_count):
            whole[LOGGED, to] = old_whole[LOGGED, to - (end_simulated_index - before)] + later
    for to in range(first_simulated_index):
        whole[LOGGED, to] = old_whole[LOGGED, to]
    for number in range(whole[LOGGED, first_simulated_index]):
        whole[LOG, number] = old_whole[LOG, number]
    for node in range(end + 1):
        old_whole[LOGGED, node], old_whole[LOG, node] = whole[LOGGED, node], whole[LOG, node]
    for customer in range(1, end):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        if first_simulated_index <= whole[POSITION, launch] < end_simulated_index:
            _copy_sortie_geometry(whole, times_s, old_whole, old_times_s, customer)
        else:
            times_s[FLY, customer] = old_times_s[FLY, customer]


@compiled_inner
def sortie_differs(base_plan, plan, customer):
    return (
        base_plan[LAUNCH, customer] != plan[LAUNCH, customer]
        or base_plan[RENDEZVOUS, customer] != plan[RENDEZVOUS, customer]
        or base_plan[KIND, customer] != plan[KIND, customer]
        or base_plan[ORDER, customer] != plan[ORDER, customer]
    )


@compiled_inner
def copy_earlier_launch_log(air, old, new, route_index):
    """Copy the launches before this position, and the routes of those possibly airborne there."""
    whole, times_s, old_whole, old_times_s = new.whole, new.times_s, old.whole, old.times_s
    logged = old_whole[LOGGED, route_index]
    whole[LOGGED, route_index] = logged
    for number in range(max(0, logged - LOG_DEPTH_FLEETS * air.fleet), logged):
        customer = old_whole[LOG, number]
        whole[LOG, number] = customer
        _copy_sortie_geometry(old_whole, old_times_s, whole, times_s, customer)
        times_s[FLY, customer] = old_times_s[FLY, customer]
        times_s[LAUNCHED, customer] = old_times_s[LAUNCHED, customer]


@compiled_inner
def _last_possibly_airborne_log_index(
    slack_s, int_rows, times_s, log_index, least_log_index, now_s
):
    """Return the log index of the last launch before `log_index` that may be airborne; -1: none
    from index `least_log_index` on.
    """
    for before in range(log_index - 1, least_log_index - 1, -1):
        customer = int_rows[LOG, before]
        if times_s[LAUNCHED, customer] + times_s[FLY, customer] + slack_s > now_s:
            return before
    return -1


@compiled_inner
def has_same_airborne_sorties(change, route_index, base_route_index):
    """Return whether the same sorties are airborne at this position as in the old plan, equal
    except for a time shift.
    """
    new, old, air = change.new_work, change.work, change.tables.air
    whole, times_s, old_whole, old_times_s = new.whole, new.times_s, old.whole, old.times_s
    now_s, then_s = times_s[ARRIVE, route_index], old_times_s[ARRIVE, base_route_index]
    one, other = whole[LOGGED, route_index], old_whole[LOGGED, base_route_index]
    back, slack_s = LOG_DEPTH_FLEETS * air.fleet, air.slack_s
    least, other_least = max(0, one - back), max(0, other - back)
    while True:
        one = _last_possibly_airborne_log_index(slack_s, whole, times_s, one, least, now_s)
        other = _last_possibly_airborne_log_index(
            slack_s, old_whole, old_times_s, other, other_least, then_s
        )
        if one < 0 and other < 0:
            return True
        if one < 0 or other < 0 or whole[LOG, one] != old_whole[LOG, other]:
            return False
        customer = whole[LOG, one]
        for row in (LAYER, PAD, HOME):
            if whole[row, customer] != old_whole[row, customer]:
                return False
        late_s = times_s[LAUNCHED, customer] - old_times_s[LAUNCHED, customer]
        if abs(late_s - (now_s - then_s)) > SAME_SHIFT_S:
            return False
        if sortie_differs(change.plan, change.new_plan, customer):
            return False
