"""The times of a plan: truck, driver and drones, in one pass along the route.

At a node the driver takes, of what can be done now: a recovery that cannot wait for a launch; else
the launch that is recovered first; else a recovery; else the truck's own delivery; else a launch
that is marked LATE. Where nothing can be done, or nothing that ends before a drone marked AT_ONCE
comes, the driver waits. A drone that would hover too long before its recovery is launched later by
as much (this costs nothing where the truck waits on the way), and the pass is repeated from there.
With the order of launches and recoveries thus given, these are the earliest times. Where drones
have pads of their own, the same is done with one that would land before the truck has come. Where
drones must be separated, a launch without a free layer waits until the first drone that blocks it
has landed. The truck stays until what it has launched has taken off.
"""

import math

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.layers.layer_pricing import layer_for
from ground_station.core.truck_drones.tables import (
    ARRIVE,
    AT_ONCE,
    BLOCKED,
    DELIVERED,
    DEPART,
    FIRST_LAUNCH,
    FIRST_MEET,
    FLY,
    HOVER_LEFT,
    IDLE,
    KIND,
    LATE,
    LAUNCH,
    LAUNCHED,
    LAYER,
    LEVEL,
    LOG,
    LOGGED,
    MEET,
    MET,
    NEXT_LAUNCH,
    NEXT_MEET,
    NOWHERE,
    ORDER,
    PENDING,
    PLACE,
    PUSHES,
    RELEASE,
    ROUTE,
    SPARE,
    WORK_AFTER,
)

EPSILON_S = 1e-7
MOST_PUSHES = 3
"""How often one launch is put off before the plan counts as impossible."""

IMPOSSIBLE = math.inf
ON_THE_GROUND_S = 1e7
"""How long a landed drone can wait: longer than any day."""


@compiled
def _index_sorties(t, plan, whole, times_s):
    """Sorties by node, with their flight and spare times; False where one is impossible."""
    launch_s, recover_s, out_s, back_s = t.launch_s, t.recover_s, t.out_s, t.back_s
    out_hover_s, back_hover_s, endurance_s = t.out_hover_s, t.back_hover_s, t.endurance_hover_s
    release_s, from_s = t.release_s, t.from_s
    for customer in range(1, plan.shape[1] - 1):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        meet, kind = plan[MEET, customer], plan[KIND, customer]
        if whole[PLACE, launch] < 0 or whole[PLACE, meet] < whole[PLACE, launch]:
            return False
        if (launch == meet and not t.pads) or (launch != meet and t.loops_only):
            return False
        spare_s = (endurance_s[kind] - out_hover_s[kind, launch, customer]) - back_hover_s[
            kind, customer, meet
        ]
        if not spare_s >= 0.0:
            return False
        times_s[SPARE, customer] = ON_THE_GROUND_S if t.pads else spare_s
        times_s[FLY, customer] = out_s[kind, launch, customer] + back_s[kind, customer, meet]
        times_s[RELEASE, customer] = max(release_s[customer], from_s[kind])
        whole[PUSHES, customer] = 0
        whole[NEXT_LAUNCH, customer] = whole[FIRST_LAUNCH, launch]
        whole[FIRST_LAUNCH, launch] = customer
        whole[NEXT_MEET, customer] = whole[FIRST_MEET, meet]
        whole[FIRST_MEET, meet] = customer
        times_s[WORK_AFTER, whole[PLACE, launch]] += launch_s[kind]
        times_s[WORK_AFTER, whole[PLACE, meet]] += recover_s[kind]
        times_s[LEVEL, customer] = times_s[FLY, customer]
        times_s[HOVER_LEFT, customer] = spare_s
    return True


@compiled
def index_plan(t, plan, whole, times_s):
    """Places, sorties by node, sum of work; the number of places, or 0 where a sortie is
    impossible.
    """
    travel_s, deliver_s = t.travel_s, t.deliver_s
    end = plan.shape[1] - 1
    for node in range(end + 1):
        whole[PLACE, node] = NOWHERE
        whole[FIRST_LAUNCH, node] = NOWHERE
        whole[FIRST_MEET, node] = NOWHERE
    at = 0
    while True:
        node = plan[ROUTE, at]
        whole[PLACE, node] = at
        times_s[WORK_AFTER, at] = deliver_s[node]
        if node == end:
            break
        at += 1
    if not _index_sorties(t, plan, whole, times_s):
        return 0
    for before in range(at - 1, -1, -1):
        hop_s = travel_s[plan[ROUTE, before], plan[ROUTE, before + 1]]
        times_s[WORK_AFTER, before] += times_s[WORK_AFTER, before + 1] + hop_s
    return at + 1


@compiled
def _mark_pending(plan, whole, times_s, node):
    """Mark the sorties of this node: 1 to be launched, 2 to be recovered; loops first 1."""
    customer = whole[FIRST_LAUNCH, node]
    while customer >= 0:
        whole[PENDING, customer] = 1
        times_s[BLOCKED, customer] = 0.0
        customer = whole[NEXT_LAUNCH, customer]
    customer = whole[FIRST_MEET, node]
    while customer >= 0:
        if plan[LAUNCH, customer] != node:
            whole[PENDING, customer] = 2
        customer = whole[NEXT_MEET, customer]


@compiled
def _put_off(plan, whole, times_s, launch_s, customer, launched_s):
    """Launch this drone later; whether that is allowed once more."""
    whole[PUSHES, customer] += 1
    if whole[PUSHES, customer] > MOST_PUSHES:
        return False
    times_s[RELEASE, customer] = launched_s - launch_s[plan[KIND, customer]]
    return True


@compiled
def _launch_before(plan, whole, times_s, one, other):
    """Whether this launch is done before that one: LATE ones last, then by place and time of
    recovery.
    """
    late = (plan[ORDER, one] & LATE) - (plan[ORDER, other] & LATE)
    if late != 0:
        return late < 0
    sooner = whole[PLACE, plan[MEET, one]] - whole[PLACE, plan[MEET, other]]
    if sooner != 0:
        return sooner < 0
    return times_s[LEVEL, one] > times_s[LEVEL, other]


@compiled
def _launch_to_do(plan, whole, times_s, aboard, node, now_s):
    """The launch to do now (or NOWHERE), when else one could be done, how many are left."""
    chosen, later_s, left = NOWHERE, IMPOSSIBLE, 0
    customer = whole[FIRST_LAUNCH, node]
    while customer >= 0:
        if whole[PENDING, customer] == 1:
            left += 1
            if aboard[plan[KIND, customer]] > 0:
                from_s = max(times_s[RELEASE, customer], times_s[BLOCKED, customer])
                if from_s > now_s + EPSILON_S:
                    later_s = min(later_s, from_s)
                elif chosen < 0 or _launch_before(plan, whole, times_s, customer, chosen):
                    chosen = customer
        customer = whole[NEXT_LAUNCH, customer]
    return chosen, later_s, left


@compiled
def _meeting_to_do(plan, whole, times_s, node, now_s):
    """The recovery to do now (or NOWHERE), its deadline, when else one could be done, when one
    comes that is marked AT_ONCE, how many are left."""
    chosen, deadline_s, left = NOWHERE, IMPOSSIBLE, 0
    later_s, at_once_s = IMPOSSIBLE, IMPOSSIBLE
    customer = whole[FIRST_MEET, node]
    while customer >= 0:
        if whole[PENDING, customer] == 2:
            left += 1
            ready_s = times_s[LAUNCHED, customer] + times_s[FLY, customer]
            if ready_s > now_s + EPSILON_S:
                later_s = min(later_s, ready_s)
                if plan[ORDER, customer] & AT_ONCE:
                    at_once_s = min(at_once_s, ready_s)
            elif ready_s + times_s[SPARE, customer] < deadline_s:
                chosen, deadline_s = customer, ready_s + times_s[SPARE, customer]
        customer = whole[NEXT_MEET, customer]
    return chosen, deadline_s, later_s, at_once_s, left


@compiled
def _launch_goes_first(plan, launch, meet, deliver, ends_s, deadline_s):
    """Whether this launch is done before what else can be done now."""
    if meet >= 0 and (deadline_s < ends_s or plan[ORDER, meet] & AT_ONCE):
        return False
    return not (plan[ORDER, launch] & LATE and (meet >= 0 or deliver))


@compiled
def _too_early(whole, times_s, node, from_s):
    """A drone that would land at this node before `from_s`, or NOWHERE."""
    customer = whole[FIRST_MEET, node]
    while customer >= 0:
        landed_s = times_s[LAUNCHED, customer] + times_s[FLY, customer]
        if whole[PENDING, customer] == 2 and landed_s < from_s - EPSILON_S:
            return customer
        customer = whole[NEXT_MEET, customer]
    return NOWHERE


@compiled
def _stop_here(air, plan, whole, times_s, aboard, launch_s, recover_s, deliver_s, stay_s, at):
    """Do everything at this place. Returns (departure, place to go on from; -1: impossible)."""
    node, now_s = plan[ROUTE, at], times_s[ARRIVE, at]
    taken_off_s = now_s
    _mark_pending(plan, whole, times_s, node)
    deliver, logged = deliver_s > 0.0, whole[LOGGED, at]
    while True:
        launch, launch_later_s, launches = _launch_to_do(plan, whole, times_s, aboard, node, now_s)
        meet, deadline_s, meet_later_s, at_once_s, meetings = _meeting_to_do(
            plan, whole, times_s, node, now_s
        )
        if launches == 0 and meetings == 0 and not deliver:
            if at + 1 < whole.shape[1]:
                whole[LOGGED, at + 1] = logged
            return max(now_s, taken_off_s), at + 1
        if launch >= 0:
            ends_s = now_s + launch_s[plan[KIND, launch]]
            if not _launch_goes_first(plan, launch, meet, deliver, ends_s, deadline_s):
                launch = NOWHERE
        if launch >= 0:
            lasts_s = launch_s[plan[KIND, launch]]
        elif meet >= 0:
            lasts_s = recover_s[plan[KIND, meet]]
        elif deliver:
            lasts_s = deliver_s
        else:
            now_s = min(launch_later_s, meet_later_s)
            if now_s == IMPOSSIBLE:
                return IMPOSSIBLE, -1
            continue
        if now_s + lasts_s > at_once_s + EPSILON_S:
            now_s = at_once_s
            continue
        if launch >= 0:
            if air.priced:
                layer, free_s = layer_for(
                    air,
                    plan,
                    whole,
                    times_s,
                    launch,
                    now_s + lasts_s,
                    aboard[plan[KIND, launch]],
                    logged,
                )
                if layer < 0:
                    if free_s == IMPOSSIBLE:
                        return IMPOSSIBLE, -1
                    times_s[BLOCKED, launch] = max(free_s - lasts_s, now_s + 2.0 * EPSILON_S)
                    continue
                whole[LAYER, launch], whole[LOG, logged] = layer, launch
                logged += 1
            times_s[LAUNCHED, launch] = now_s + lasts_s
            taken_off_s = now_s + lasts_s + stay_s
            aboard[plan[KIND, launch]] -= 1
            whole[PENDING, launch] = 2 if plan[MEET, launch] == node else 0
        elif meet >= 0:
            if now_s > deadline_s + EPSILON_S:
                launched_s = now_s - times_s[FLY, meet] - times_s[SPARE, meet]
                if not _put_off(plan, whole, times_s, launch_s, meet, launched_s):
                    return IMPOSSIBLE, -1
                return now_s, whole[PLACE, plan[LAUNCH, meet]]
            times_s[MET, meet] = now_s
            aboard[plan[KIND, meet]] += 1
            whole[PENDING, meet] = 0
        else:
            times_s[DELIVERED, node] = now_s
            deliver = False
        now_s += lasts_s


@compiled
def visit(t, plan, whole, times_s, free, launch_s, recover_s, at):
    """Everything at this place, from its arrival on; its departure and the next arrival.

    Returns the place to go on from: the next one, an earlier one where a launch was put off, or
    -1: impossible.
    """
    aboard = free[free.shape[0] - 1]
    for kind in range(len(aboard)):
        aboard[kind] = free[at, kind]
    node = plan[ROUTE, at]
    if t.pads:
        _mark_pending(plan, whole, times_s, node)
        landed_s = times_s[ARRIVE, at] + t.lead_s
        early = _too_early(whole, times_s, node, landed_s)
        if early >= 0:
            launched_s = landed_s - times_s[FLY, early]
            if not _put_off(plan, whole, times_s, launch_s, early, launched_s):
                return -1
            return whole[PLACE, plan[LAUNCH, early]]
    depart_s, go_on = _stop_here(
        t.air, plan, whole, times_s, aboard, launch_s, recover_s, t.deliver_s[node], t.stay_s, at
    )
    if go_on > at:
        if at == 0:
            depart_s = max(depart_s, t.hold_s)
        times_s[DEPART, at] = depart_s
        if node != plan.shape[1] - 1:
            times_s[ARRIVE, go_on] = depart_s + t.travel_s[node, plan[ROUTE, go_on]]
            for kind in range(len(aboard)):
                free[go_on, kind] = aboard[kind]
    return go_on


@compiled
def board(t, plan, free):
    """All drones that the plan uses are aboard at first."""
    for kind in range(free.shape[1]):
        free[0, kind] = t.fleet[kind] - left_behind(plan, kind)


@compiled
def left_behind(plan, kind):
    """How many drones of this kind the plan never launches."""
    return plan[IDLE, kind] if kind < plan.shape[1] else 0


@compiled
def simulate(t, plan, w, give_up_s):
    """The makespan, s; inf where the plan is impossible or must end after `give_up_s`."""
    whole, times_s, free = w.whole, w.times_s, w.free
    launch_s, recover_s = t.launch_s, t.recover_s
    places = index_plan(t, plan, whole, times_s)
    if places == 0:
        return IMPOSSIBLE
    board(t, plan, free)
    times_s[ARRIVE, 0], whole[LOGGED, 0] = 0.0, 0
    at = 0
    while at < places:
        if times_s[ARRIVE, at] + times_s[WORK_AFTER, at] > give_up_s:
            return IMPOSSIBLE
        at = visit(t, plan, whole, times_s, free, launch_s, recover_s, at)
        if at < 0:
            return IMPOSSIBLE
    return times_s[DEPART, places - 1]
