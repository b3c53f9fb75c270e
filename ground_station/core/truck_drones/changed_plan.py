"""The makespan of a plan that differs little from another one, whose simulation is at hand.

The pass along the route begins where the first change is felt, and ends where the truck arrives
with everything as it was there before but for a shift of time: from there on the old plan's times
hold, shifted. The result is that of `simulate` (to rounding), after a part of the work.
"""

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.layers.changed_air import (
    SAME_SHIFT_S,
    adopt_log,
    air_alike,
    differs,
    take_log,
)
from ground_station.core.truck_drones.simulate import (
    IMPOSSIBLE,
    ON_THE_GROUND_S,
    board,
    simulate,
    visit,
)
from ground_station.core.truck_drones.tables import (
    ARRIVE,
    DEPART,
    FIRST_LAUNCH,
    FIRST_MEET,
    FLY,
    FURTHEST,
    HOVER_LEFT,
    IDLE,
    KIND,
    LAUNCH,
    LAUNCHED,
    LEVEL,
    MEET,
    MET,
    NEXT_LAUNCH,
    NEXT_MEET,
    NOWHERE,
    PLACE,
    PUSHES,
    RELEASE,
    RESTART,
    ROUTE,
    SPANNED,
    SPARE,
    WORK_AFTER,
)


@compiled
def note_simulation(t, plan, w):
    """The makespan, with all that `changed_makespan_s` needs of this plan's simulation in `w`."""
    makespan_s = simulate(t, plan, w, IMPOSSIBLE)
    _note_spans(plan, w.whole)
    return makespan_s


@compiled
def _note_spans(plan, whole):
    """By place: where a pass must begin so that all before it stays (RESTART), whether a sortie
    that was put off is in the air (SPANNED), and the last meeting of those in the air (FURTHEST).
    """
    end = plan.shape[1] - 1
    places = whole[PLACE, end] + 1
    for at in range(places):
        whole[RESTART, at] = at
        whole[SPANNED, at] = 0
        whole[FURTHEST, at] = NOWHERE
    for customer in range(1, end):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        first, last = whole[PLACE, launch], whole[PLACE, plan[MEET, customer]]
        pushed = whole[PUSHES, customer] > 0
        # The order of two launches of one stop depends on where they are met.
        several = whole[NEXT_LAUNCH, customer] != NOWHERE or whole[FIRST_LAUNCH, launch] != customer
        for at in range(first + 1, last + 1):
            whole[FURTHEST, at] = max(whole[FURTHEST, at], last)
            if pushed or several:
                whole[RESTART, at] = min(whole[RESTART, at], first)
            if pushed:
                whole[SPANNED, at] = 1
    for at in range(places):
        whole[RESTART, at] = whole[RESTART, whole[RESTART, at]]


@compiled
def _met_s(plan, kept, w, begin, at, shift_s, customer):
    """When a customer's drone is met in a simulation of `changed_makespan_s`."""
    meet = w.whole[PLACE, plan[MEET, customer]]
    if meet < begin:
        return kept.times_s[MET, customer]
    return w.times_s[MET, customer] if meet < at else kept.times_s[MET, customer] + shift_s


@compiled
def changed_away_s(plan, kept, w, begin, at, shift_s):
    """After `changed_makespan_s`: the time that all drones together are away from the truck."""
    away_s = 0.0
    for customer in range(1, plan.shape[1] - 1):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        place = w.whole[PLACE, launch]
        if place < begin:
            launched_s = kept.times_s[LAUNCHED, customer]
        elif place < at:
            launched_s = w.times_s[LAUNCHED, customer]
        else:
            launched_s = kept.times_s[LAUNCHED, customer] + shift_s
        away_s += _met_s(plan, kept, w, begin, at, shift_s, customer) - launched_s
    return away_s


@compiled
def away_s(plan, w):
    """After a whole simulation: the time that all drones together are away from the truck."""
    total_s = 0.0
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] != NOWHERE:
            total_s += w.times_s[MET, customer] - w.times_s[LAUNCHED, customer]
    return total_s


@compiled
def adopt(t, plan, kept, w, begin, at, shift_s):
    """Make a simulation of `changed_makespan_s`, which passed the places from `begin` to before
    `at`, that of the new plan, in `kept`: what came before is as it was, what follows is shifted.
    """
    whole, times_s, free = w.whole, w.times_s, w.free
    was, was_s, had = kept.whole, kept.times_s, kept.free
    end = plan.shape[1] - 1
    places = whole[PLACE, end] + 1
    longer = places - 1 - was[PLACE, end]
    for to in range(begin):
        times_s[ARRIVE, to], times_s[DEPART, to] = was_s[ARRIVE, to], was_s[DEPART, to]
        for kind in range(free.shape[1]):
            free[to, kind] = had[to, kind]
    for to in range(at, places):
        times_s[ARRIVE, to] = was_s[ARRIVE, to - longer] + shift_s
        times_s[DEPART, to] = was_s[DEPART, to - longer] + shift_s
        for kind in range(free.shape[1]):
            free[to, kind] = had[to - longer, kind]
    for customer in range(1, end):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        if whole[PLACE, launch] < begin:
            whole[PUSHES, customer] = was[PUSHES, customer]
            times_s[RELEASE, customer] = was_s[RELEASE, customer]
        elif whole[PLACE, launch] >= at:
            times_s[LAUNCHED, customer] = was_s[LAUNCHED, customer] + shift_s
            whole[PUSHES, customer] = was[PUSHES, customer]
            if was[PUSHES, customer] > 0:
                times_s[RELEASE, customer] = was_s[RELEASE, customer] + shift_s
        times_s[MET, customer] = _met_s(plan, kept, w, begin, at, shift_s, customer)
    if t.air.priced:
        adopt_log(plan, kept, w, begin, at, places)
    for node in range(end + 1):
        for row in (PLACE, PUSHES, FIRST_LAUNCH, NEXT_LAUNCH):
            was[row, node] = whole[row, node]
        for row in (ARRIVE, DEPART, LAUNCHED, MET, FLY, SPARE, RELEASE, LEVEL, HOVER_LEFT):
            was_s[row, node] = times_s[row, node]
        for kind in range(free.shape[1]):
            had[node, kind] = free[node, kind]
    _note_spans(plan, was)


@compiled
def _index_sorties(t, old, was, was_s, plan, whole, times_s, first, last):
    """Sorties by node, as `simulate` does it, but flights that have not changed are copied.

    `first`, `last`: places of the route from and up to which it differs. Returns them with the
    sorties' changes taken in; (-1, -1) where a sortie is impossible.
    """
    launch_s, recover_s, out_s, back_s = t.launch_s, t.recover_s, t.out_s, t.back_s
    out_hover_s, back_hover_s, endurance_s = t.out_hover_s, t.back_hover_s, t.endurance_hover_s
    release_s, from_s = t.release_s, t.from_s
    end = plan.shape[1] - 1
    shorter = whole[PLACE, end] - was[PLACE, end]
    for customer in range(1, end):
        launch = plan[LAUNCH, customer]
        changed = differs(old, plan, customer)
        if changed and old[LAUNCH, customer] != NOWHERE:
            first = min(first, was[PLACE, old[LAUNCH, customer]])
            last = max(last, was[PLACE, old[MEET, customer]] + shorter)
        if launch == NOWHERE:
            continue
        meet, kind = plan[MEET, customer], plan[KIND, customer]
        at, to = whole[PLACE, launch], whole[PLACE, meet]
        if at < 0 or to < at:
            return -1, -1
        if changed:
            first, last = min(first, at), max(last, to)
            if (launch == meet and not t.pads) or (launch != meet and t.loops_only):
                return -1, -1
            spare_s = (endurance_s[kind] - out_hover_s[kind, launch, customer]) - back_hover_s[
                kind, customer, meet
            ]
            if not spare_s >= 0.0:
                return -1, -1
            times_s[SPARE, customer] = ON_THE_GROUND_S if t.pads else spare_s
            times_s[FLY, customer] = out_s[kind, launch, customer] + back_s[kind, customer, meet]
            times_s[LEVEL, customer], times_s[HOVER_LEFT, customer] = (
                times_s[FLY, customer],
                spare_s,
            )
        else:
            times_s[SPARE, customer] = was_s[SPARE, customer]
            times_s[FLY, customer] = was_s[FLY, customer]
            times_s[LEVEL, customer] = was_s[LEVEL, customer]
            times_s[HOVER_LEFT, customer] = was_s[HOVER_LEFT, customer]
        whole[PUSHES, customer] = 0
        times_s[RELEASE, customer] = max(release_s[customer], from_s[kind])
        whole[NEXT_LAUNCH, customer] = whole[FIRST_LAUNCH, launch]
        whole[FIRST_LAUNCH, launch] = customer
        whole[NEXT_MEET, customer] = whole[FIRST_MEET, meet]
        whole[FIRST_MEET, meet] = customer
        times_s[WORK_AFTER, at] += launch_s[kind]
        times_s[WORK_AFTER, to] += recover_s[kind]
    return first, last


@compiled
def _index_route(t, old, was, plan, whole, times_s):
    """Places of the nodes, as `simulate` does it; the number of places, how many of them are the
    old plan's from the depot on, and the last place that is not the old plan's from the end on.
    """
    deliver_s = t.deliver_s
    end = plan.shape[1] - 1
    for node in range(end + 1):
        whole[PLACE, node] = NOWHERE
        whole[FIRST_LAUNCH, node] = NOWHERE
        whole[FIRST_MEET, node] = NOWHERE
    at, first = 0, 0
    while True:
        node = plan[ROUTE, at]
        whole[PLACE, node] = at
        times_s[WORK_AFTER, at] = deliver_s[node]
        if first == at and old[ROUTE, at] == node:
            first = at + 1
        if node == end:
            break
        at += 1
    if first > at:
        return at + 1, first, NOWHERE
    last, before = at, was[PLACE, end]
    while plan[ROUTE, last] == old[ROUTE, before]:
        last -= 1
        before -= 1
    return at + 1, first, last


@compiled
def _sum_work(t, plan, times_s, first, last):
    """The work still to do from each of these places on."""
    travel_s = t.travel_s
    for at in range(last, first - 1, -1):
        hop_s = travel_s[plan[ROUTE, at], plan[ROUTE, at + 1]]
        times_s[WORK_AFTER, at] += times_s[WORK_AFTER, at + 1] + hop_s


@compiled
def _take_back(t, kept, plan, w, first, begin):
    """A launch before the place where the pass began is put off: what was before comes back."""
    whole, times_s, free = w.whole, w.times_s, w.free
    was, was_s, had = kept.whole, kept.times_s, kept.free
    for at in range(first, begin):
        times_s[ARRIVE, at] = was_s[ARRIVE, at]
        for kind in range(free.shape[1]):
            free[at, kind] = had[at, kind]
    if t.air.priced:
        take_log(t.air, kept, w, first)
    _sum_work(t, plan, times_s, first, begin - 1)
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] != NOWHERE and whole[PLACE, plan[MEET, customer]] < begin:
            whole[PUSHES, customer] = was[PUSHES, customer]
            times_s[RELEASE, customer] = was_s[RELEASE, customer]


@compiled
def _aboard_alike(free, at, had, before):
    alike = True
    for kind in range(free.shape[1]):
        alike = alike and free[at, kind] == had[before, kind]
    return alike


@compiled
def changed_makespan_s(t, old, kept, old_s, plan, w, give_up_s):
    """`simulate` of a plan near `old`, whose makespan is `old_s` and whose simulation in `kept`
    was made by `note_simulation` or `adopt`.

    Returns the makespan, and for `adopt` the first place passed and the one after the last, and
    the shift of time there. Both are 0 where nothing has changed.
    """
    whole, times_s, free = w.whole, w.times_s, w.free
    was, was_s, had = kept.whole, kept.times_s, kept.free
    launch_s, recover_s = t.launch_s, t.recover_s
    places, first, last = _index_route(t, old, was, plan, whole, times_s)
    first, last = _index_sorties(t, old, was, was_s, plan, whole, times_s, first, last)
    if first < 0:
        return IMPOSSIBLE, 0, 0, 0.0
    end = plan.shape[1] - 1
    for kind in range(min(free.shape[1], end + 1)):
        if plan[IDLE, kind] != old[IDLE, kind]:
            first, last = 0, places
    if first == places:
        return old_s, 0, 0, 0.0
    begin = was[RESTART, first]
    _sum_work(t, plan, times_s, begin, places - 2)
    if begin == 0:
        times_s[ARRIVE, 0] = 0.0
        board(t, plan, free)
    else:
        hop_s = t.travel_s[plan[ROUTE, begin - 1], plan[ROUTE, begin]]
        times_s[ARRIVE, begin] = was_s[DEPART, begin - 1] + hop_s
        for kind in range(free.shape[1]):
            free[begin, kind] = had[begin, kind]
        for customer in range(1, end):
            times_s[LAUNCHED, customer] = was_s[LAUNCHED, customer]
    if t.air.priced:
        take_log(t.air, kept, w, begin)

    # A drone in the air at the tail of the route was launched with a shift of time. `uniform` is
    # the furthest meeting of those with the latest shift, `others` of those with another one.
    longer = places - 1 - was[PLACE, end]
    uniform = NOWHERE if was[FURTHEST, begin] < 0 else max(last, was[FURTHEST, begin] + longer)
    shift_s, others, furthest = 0.0, NOWHERE, uniform
    at = begin
    while at < places:
        if times_s[ARRIVE, at] + times_s[WORK_AFTER, at] > give_up_s:
            return IMPOSSIBLE, 0, 0, 0.0
        if at > last:
            arrived_s = was_s[ARRIVE, at - longer]
            now_s = times_s[ARRIVE, at] - arrived_s
            if abs(now_s - shift_s) > SAME_SHIFT_S:
                shift_s, others, uniform = now_s, max(others, uniform), NOWHERE
            if (
                others < at
                and was[SPANNED, at - longer] == 0
                and min(arrived_s, arrived_s + now_s) >= t.fixed_until_s
                and _aboard_alike(free, at, had, at - longer)
                and (not t.air.priced or air_alike(t.air, old, kept, plan, w, at, at - longer))
            ):
                return old_s + now_s, begin, at, now_s
        go_on = visit(t, plan, whole, times_s, free, launch_s, recover_s, at)
        if go_on < 0:
            return IMPOSSIBLE, 0, 0, 0.0
        if go_on <= at:
            if go_on < begin:
                _take_back(t, kept, plan, w, go_on, begin)
                begin = go_on
            others, uniform = max(others, furthest), NOWHERE
        else:
            customer = whole[FIRST_LAUNCH, plan[ROUTE, at]]
            while customer >= 0:
                to = whole[PLACE, plan[MEET, customer]]
                furthest = max(furthest, to)
                if to > last:
                    now_s = times_s[LAUNCHED, customer] - was_s[LAUNCHED, customer]
                    if abs(now_s - shift_s) > SAME_SHIFT_S:
                        shift_s, others, uniform = now_s, max(others, uniform), to
                    else:
                        uniform = max(uniform, to)
                customer = whole[NEXT_LAUNCH, customer]
        at = go_on
    return times_s[DEPART, places - 1], begin, places, 0.0
