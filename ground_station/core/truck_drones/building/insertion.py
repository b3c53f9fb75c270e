"""A customer who is not served yet, served at the best place that is found: by truck or by drone.

Each place is priced by the makespan of the plan that it gives, and a drone's seconds away from the
truck by a small share of them: a drone that is home soon can fly once more.
"""

from typing import NamedTuple

from ground_station.core.truck_drones.changed_plan import changed_makespan_s
from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.edits import insert_stop
from ground_station.core.truck_drones.random_stream import uniform
from ground_station.core.truck_drones.simulate import IMPOSSIBLE
from ground_station.core.truck_drones.tables import (
    IDLE,
    KIND,
    LAUNCH,
    LAUNCHED,
    MEET,
    MET,
    NOWHERE,
    ORDER,
    ROUTE,
    WAYS,
)


class Insertion(NamedTuple):
    """Which places are looked at."""

    stops: int
    """Near stops, before and behind which the truck may go."""
    reach: int
    """A drone is launched at most so many places from the nearest stop,"""
    ahead: int
    """and met at most so many places later."""
    skip_frac: float
    """Share of the places that is left out by chance, so that two tries differ."""
    air_price: float
    """Seconds of makespan that a drone's second away from the truck counts for."""


@compiled
def count_away(plan, place, taken):
    """By kind and place: drones away from the truck on its way to the next place."""
    last = place[plan.shape[1] - 1]
    for row in range(WAYS, taken.shape[0]):
        for at in range(last + 1):
            taken[row, at] = 0
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] != NOWHERE:
            row = WAYS + plan[KIND, customer]
            for at in range(place[plan[LAUNCH, customer]], place[plan[MEET, customer]]):
                taken[row, at] += 1


@compiled
def nearest_place(t, plan, place, customer):
    """The place of the stop from which the road to this customer is shortest."""
    near = t.near
    for number in range(near.shape[1]):
        if place[near[customer, number]] >= 0:
            return place[near[customer, number]]
    at = 0
    for other in range(1, place[plan.shape[1] - 1] + 1):
        if t.travel_s[plan[ROUTE, other], customer] < t.travel_s[plan[ROUTE, at], customer]:
            at = other
    return at


@compiled
def take_off_route(plan, place, at):
    """The undoing of `insert_stop`: nothing hangs on that stop."""
    last = place[plan.shape[1] - 1]
    place[plan[ROUTE, at]] = NOWHERE
    for to in range(at, last):
        plan[ROUTE, to] = plan[ROUTE, to + 1]
        place[plan[ROUTE, to]] = to


@compiled
def _best_gap(t, old, kept, old_s, plan, place, w, customer, give_up_s, how, stream):
    """The place on the route at which the truck serves this customer soonest (NOWHERE: none by
    `give_up_s`), the makespan, and how many were tried.
    """
    near = t.near
    last = place[plan.shape[1] - 1]
    best_at, best_s, tried, stops = NOWHERE, give_up_s, 0, 0
    nearest = nearest_place(t, plan, place, customer)
    for number in range(near.shape[1] + 1):
        if number < near.shape[1]:
            at = place[near[customer, number]]
        else:
            at = nearest if stops == 0 else NOWHERE  # none of those near is on the route
        if at < 0:
            continue
        stops += 1
        for to in range(max(1, at), min(last, at + 1) + 1):
            other = plan[ROUTE, to] if to > at else plan[ROUTE, to - 1]
            known = False  # from the other side
            for before in range(min(number, near.shape[1])):
                known = known or near[customer, before] == other
            if known or uniform(stream) < how.skip_frac:
                continue
            insert_stop(plan, place, customer, to)
            tried += 1
            makespan_s, _, passed, _ = changed_makespan_s(t, old, kept, old_s, plan, w, best_s)
            take_off_route(plan, place, to)
            if passed > 0 and makespan_s < best_s:
                best_at, best_s = to, makespan_s
        if stops >= how.stops:
            break
    return best_at, best_s, tried


@compiled
def insert_customer(t, old, kept, old_s, plan, place, w, customer, give_up_s, how, stream):
    """Serve this customer; the makespan (inf, and nothing is changed: no place by `give_up_s`) and
    how many places were tried.

    `old`, `kept`, `old_s`: a plan near this one, as `changed_makespan_s` wants it.
    """
    best_s, tried, best_at = give_up_s, 0, NOWHERE
    if t.truck_can[customer]:
        best_at, best_s, tried = _best_gap(
            t, old, kept, old_s, plan, place, w, customer, give_up_s, how, stream
        )
    # What a place costs: makespan and the drone's time.
    best_cost_s = best_s if best_at >= 0 else IMPOSSIBLE
    best_kind, best_launch, best_meet = NOWHERE, NOWHERE, NOWHERE
    end = plan.shape[1] - 1
    last = place[end]
    count_away(plan, place, w.taken)
    nearest = nearest_place(t, plan, place, customer)
    plan[ORDER, customer] = 0
    for kind in range(t.drone_can.shape[0]):
        if not t.drone_can[kind, customer]:
            continue
        drones = t.fleet[kind] - (plan[IDLE, kind] if kind <= end else 0)
        plan[KIND, customer] = kind
        for launch in range(max(0, nearest - how.reach), min(last, nearest + how.reach) + 1):
            start = plan[ROUTE, launch]
            left_s = t.endurance_hover_s[kind] - t.out_hover_s[kind, start, customer]
            if not left_s >= 0.0:
                continue
            furthest = launch if t.loops_only else min(last, launch + how.ahead)
            for meet in range(launch, furthest + 1):
                if meet > launch and w.taken[WAYS + kind, meet - 1] >= drones:
                    break
                if meet == launch and not t.pads:
                    continue
                stop = plan[ROUTE, meet]
                if not left_s - t.back_hover_s[kind, customer, stop] >= 0.0:
                    continue
                if uniform(stream) < how.skip_frac:
                    continue
                plan[LAUNCH, customer], plan[MEET, customer] = start, stop
                tried += 1
                makespan_s, _, passed, _ = changed_makespan_s(
                    t, old, kept, old_s, plan, w, min(give_up_s, best_cost_s)
                )
                if passed == 0:
                    continue
                away_s = w.times_s[MET, customer] - w.times_s[LAUNCHED, customer]
                if makespan_s + how.air_price * away_s < best_cost_s:
                    best_cost_s = makespan_s + how.air_price * away_s
                    best_s = makespan_s
                    best_kind, best_launch, best_meet = kind, start, stop
    plan[LAUNCH, customer], plan[MEET, customer] = best_launch, best_meet
    plan[KIND, customer] = best_kind
    if best_launch == NOWHERE:
        if best_at == NOWHERE:
            return IMPOSSIBLE, tried
        insert_stop(plan, place, customer, best_at)
    return best_s, tried
