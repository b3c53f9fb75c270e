"""Elementary changes of a plan's arrays that keep its sorties valid; all moves are made of them."""

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.random_stream import below
from ground_station.core.truck_drones.tables import (
    KIND,
    LAUNCH,
    MEET,
    NOWHERE,
    ORDER,
    ROUTE,
)


@compiled
def index_route(plan, place):
    """Note the place of each node on the route (NOWHERE: not on it); the number of places."""
    end = plan.shape[1] - 1
    for node in range(end + 1):
        place[node] = NOWHERE
    at = 0
    while plan[ROUTE, at] != end:
        place[plan[ROUTE, at]] = at
        at += 1
    place[end] = at
    return at + 1


@compiled
def insert_stop(plan, place, node, at):
    """Put a node on the route at this place (1 to the end's)."""
    last = place[plan.shape[1] - 1]
    for to in range(last, at - 1, -1):
        plan[ROUTE, to + 1] = plan[ROUTE, to]
        place[plan[ROUTE, to]] = to + 1
    plan[ROUTE, at] = node
    place[node] = at


@compiled
def remove_stop(plan, place, node, stream):
    """Take a node off the route; its launches and recoveries go to a neighbouring stop."""
    at, last = place[node], place[plan.shape[1] - 1]
    before, after = plan[ROUTE, at - 1], plan[ROUTE, at + 1]
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] == node and plan[MEET, customer] == node:
            beside = after if below(stream, 2) == 0 else before
            plan[LAUNCH, customer] = beside
            plan[MEET, customer] = beside
        elif plan[LAUNCH, customer] == node:
            onward = plan[MEET, customer] != after and below(stream, 2) == 0
            plan[LAUNCH, customer] = after if onward else before
        elif plan[MEET, customer] == node:
            back = plan[LAUNCH, customer] != before and below(stream, 2) == 0
            plan[MEET, customer] = before if back else after
    for to in range(at, last):
        plan[ROUTE, to] = plan[ROUTE, to + 1]
        place[plan[ROUTE, to]] = to
    place[node] = NOWHERE


@compiled
def take_out(plan, place, customer, stream):
    """Leave this customer unserved."""
    if place[customer] >= 0:
        remove_stop(plan, place, customer, stream)
    else:
        plan[LAUNCH, customer] = NOWHERE
        plan[MEET, customer] = NOWHERE


@compiled
def turn_sorties_forward(plan, place):
    """Turn round sorties whose rendezvous would come before their launch on the changed route."""
    for customer in range(1, plan.shape[1] - 1):
        launch, meet = plan[LAUNCH, customer], plan[MEET, customer]
        if launch != NOWHERE and place[launch] > place[meet]:
            plan[LAUNCH, customer], plan[MEET, customer] = meet, launch


@compiled
def reverse_stops(plan, place, first, last):
    """Reverse the order of these places."""
    while first < last:
        one, other = plan[ROUTE, first], plan[ROUTE, last]
        plan[ROUTE, first], plan[ROUTE, last] = other, one
        place[other], place[one] = first, last
        first += 1
        last -= 1
    turn_sorties_forward(plan, place)


@compiled
def _other_end(node, end):
    """The same node on the reversed day."""
    if node == 0:
        return end
    return 0 if node == end else node


@compiled
def reverse_day(plan, place):
    """Reverse the tour and every sortie."""
    end = plan.shape[1] - 1
    first, last = 1, place[end] - 1
    while first < last:
        plan[ROUTE, first], plan[ROUTE, last] = plan[ROUTE, last], plan[ROUTE, first]
        first += 1
        last -= 1
    for customer in range(1, end):
        launch, meet = plan[LAUNCH, customer], plan[MEET, customer]
        if launch != NOWHERE:
            plan[LAUNCH, customer] = _other_end(meet, end)
            plan[MEET, customer] = _other_end(launch, end)
    index_route(plan, place)


@compiled
def exchange(plan, place, one, other):
    """Exchange the parts of two customers in the plan, with all sorties that hang on their
    stops.
    """
    for customer in range(1, plan.shape[1] - 1):
        for row in (LAUNCH, MEET):
            if plan[row, customer] == one:
                plan[row, customer] = other
            elif plan[row, customer] == other:
                plan[row, customer] = one
    for row in (LAUNCH, MEET, KIND, ORDER):
        plan[row, one], plan[row, other] = plan[row, other], plan[row, one]
    place[one], place[other] = place[other], place[one]
    if place[one] >= 0:
        plan[ROUTE, place[one]] = one
    if place[other] >= 0:
        plan[ROUTE, place[other]] = other
