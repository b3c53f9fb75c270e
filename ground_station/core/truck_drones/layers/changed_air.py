"""Who is in the air, in a plan that differs little from another one: the launches before a place of
the route, and whether the same drones fly there alike.
"""

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.layers.layer_pricing import FLEETS_BACK
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
    MEET,
    NOWHERE,
    ORDER,
    PAD,
    PAD_N,
    PLACE,
)

SAME_SHIFT_S = 1e-8
"""Shifts of time that differ by less are the same: rounding is a thousandth of it."""


@compiled
def _copy_flight(whole, times_s, to, to_s, customer):
    """Layer, pads and corners of a sortie."""
    for row in (LAYER, PAD, HOME, CORNERS):
        to[row, customer] = whole[row, customer]
    for row in range(PAD_N, PAD_N + 2 * whole[CORNERS, customer]):
        to_s[row, customer] = times_s[row, customer]


@compiled
def adopt_log(plan, kept, w, begin, at, places):
    """The launches that came before, those of the places passed, and those that follow."""
    whole, times_s, was, was_s = w.whole, w.times_s, kept.whole, kept.times_s
    end = plan.shape[1] - 1
    before = at - (places - 1 - was[PLACE, end])
    if at < places:
        later, total = whole[LOGGED, at] - was[LOGGED, before], 0
        for customer in range(1, end):
            total += 1 if plan[LAUNCH, customer] != NOWHERE else 0
        for number in range(whole[LOGGED, at], total):
            whole[LOG, number] = was[LOG, number - later]
        for to in range(at, places):
            whole[LOGGED, to] = was[LOGGED, to - (at - before)] + later
    for to in range(begin):
        whole[LOGGED, to] = was[LOGGED, to]
    for number in range(whole[LOGGED, begin]):
        whole[LOG, number] = was[LOG, number]
    for node in range(end + 1):
        was[LOGGED, node], was[LOG, node] = whole[LOGGED, node], whole[LOG, node]
    for customer in range(1, end):
        launch = plan[LAUNCH, customer]
        if launch == NOWHERE:
            continue
        if begin <= whole[PLACE, launch] < at:
            _copy_flight(whole, times_s, was, was_s, customer)
        else:
            times_s[FLY, customer] = was_s[FLY, customer]


@compiled
def differs(old, plan, customer):
    return (
        old[LAUNCH, customer] != plan[LAUNCH, customer]
        or old[MEET, customer] != plan[MEET, customer]
        or old[KIND, customer] != plan[KIND, customer]
        or old[ORDER, customer] != plan[ORDER, customer]
    )


@compiled
def take_log(air, kept, w, begin):
    """The launches before this place, and where those fly that may be in the air there."""
    whole, times_s, was, was_s = w.whole, w.times_s, kept.whole, kept.times_s
    logged = was[LOGGED, begin]
    whole[LOGGED, begin] = logged
    for number in range(max(0, logged - FLEETS_BACK * air.fleet), logged):
        customer = was[LOG, number]
        whole[LOG, number] = customer
        _copy_flight(was, was_s, whole, times_s, customer)
        times_s[FLY, customer] = was_s[FLY, customer]
        times_s[LAUNCHED, customer] = was_s[LAUNCHED, customer]


@compiled
def _in_air(slack_s, whole, times_s, number, least, now_s):
    """The number, in the log, of the last launch before this one that may be in the air; -1: none
    from the number `least` on.
    """
    for before in range(number - 1, least - 1, -1):
        customer = whole[LOG, before]
        if times_s[LAUNCHED, customer] + times_s[FLY, customer] + slack_s > now_s:
            return before
    return -1


@compiled
def air_alike(air, old, kept, plan, w, at, before):
    """Whether the same sorties are in the air at this place as there in the old plan, alike but for
    a shift of time.
    """
    whole, times_s, was, was_s = w.whole, w.times_s, kept.whole, kept.times_s
    now_s, then_s = times_s[ARRIVE, at], was_s[ARRIVE, before]
    one, other = whole[LOGGED, at], was[LOGGED, before]
    back, slack_s = FLEETS_BACK * air.fleet, air.slack_s
    least, their_least = max(0, one - back), max(0, other - back)
    while True:
        one = _in_air(slack_s, whole, times_s, one, least, now_s)
        other = _in_air(slack_s, was, was_s, other, their_least, then_s)
        if one < 0 and other < 0:
            return True
        if one < 0 or other < 0 or whole[LOG, one] != was[LOG, other]:
            return False
        customer = whole[LOG, one]
        for row in (LAYER, PAD, HOME):
            if whole[row, customer] != was[row, customer]:
                return False
        late_s = times_s[LAUNCHED, customer] - was_s[LAUNCHED, customer]
        if abs(late_s - (now_s - then_s)) > SAME_SHIFT_S or differs(old, plan, customer):
            return False
