"""Small random changes of a plan, which the search tries. False: nothing was changed."""

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.edits import (
    exchange,
    insert_stop,
    reverse_day,
    reverse_stops,
    take_out,
    turn_sorties_forward,
)
from ground_station.core.truck_drones.random_stream import below, uniform
from ground_station.core.truck_drones.tables import (
    AT_ONCE,
    IDLE,
    KIND,
    LATE,
    LAUNCH,
    MEET,
    NOWHERE,
    ORDER,
    ROUTE,
)

TRIES = 8
REACH = 4
"""How many places from the nearest stop a new sortie may be launched or recovered."""


@compiled
def near_node(t, node, stream):
    """A node near this one; nearer ones are more likely."""
    near = t.near
    drawn = uniform(stream)
    return near[node, int(drawn * drawn * near.shape[1])]


@compiled
def near_place(t, place, node, stream):
    """The place on the route of a stop near this node."""
    for _ in range(TRIES):
        at = place[near_node(t, node, stream)]
        if at >= 0:
            return at
    return below(stream, place[len(place) - 1] + 1)


@compiled
def any_flown(plan, stream):
    """A random customer served by a drone, or NOWHERE."""
    customers = plan.shape[1] - 2
    start = below(stream, customers)
    for step in range(customers):
        customer = 1 + (start + step) % customers
        if plan[LAUNCH, customer] != NOWHERE:
            return customer
    return NOWHERE


@compiled
def any_kind(t, customer, stream):
    """A kind of drone that can serve this customer, or NOWHERE."""
    can = t.drone_can
    start = below(stream, can.shape[0])
    for step in range(can.shape[0]):
        kind = (start + step) % can.shape[0]
        if can[kind, customer]:
            return kind
    return NOWHERE


@compiled
def put_on_truck(t, plan, place, customer, stream):
    """Serve a customer by truck, next to a stop near it."""
    if not t.truck_can[customer]:
        return False
    at = near_place(t, place, customer, stream) + below(stream, 2)
    insert_stop(plan, place, customer, max(1, min(at, place[plan.shape[1] - 1])))
    return True


@compiled
def put_on_drone(t, plan, place, customer, stream):
    """Serve a customer by drone, launched and recovered around a stop near it."""
    kind = any_kind(t, customer, stream)
    if kind == NOWHERE:
        return False
    last = place[plan.shape[1] - 1]
    at = near_place(t, place, customer, stream)
    drawn, also = uniform(stream), uniform(stream)
    launch = max(0, at - int(drawn * drawn * REACH))
    meet = min(last, at + int(also * also * REACH))
    if t.loops_only:
        launch = meet = at
    elif launch == meet and not t.pads:
        if meet < last and (launch == 0 or below(stream, 2) == 0):
            meet += 1
        else:
            launch -= 1
    plan[LAUNCH, customer] = plan[ROUTE, launch]
    plan[MEET, customer] = plan[ROUTE, meet]
    plan[KIND, customer] = kind
    plan[ORDER, customer] = below(stream, 4) if below(stream, 4) == 0 else 0
    return True


@compiled
def relocate(t, plan, place, stream):
    """Serve one customer elsewhere, by truck or drone."""
    customer = 1 + below(stream, plan.shape[1] - 2)
    take_out(plan, place, customer, stream)
    if below(stream, 2) == 0 and put_on_drone(t, plan, place, customer, stream):
        return True
    return put_on_truck(t, plan, place, customer, stream)


@compiled
def retime(t, plan, place, stream):
    """Launch or recover one drone a stop or two earlier or later, or in another order at its
    stops, or use another kind of drone.
    """
    customer = any_flown(plan, stream)
    if customer == NOWHERE:
        return False
    what = below(stream, 5)
    if what == 4:
        plan[ORDER, customer] ^= AT_ONCE if below(stream, 2) == 0 else LATE
        return True
    by = 1 + below(stream, 2)
    if below(stream, 2) == 0:
        by = -by
    launch, meet = place[plan[LAUNCH, customer]], place[plan[MEET, customer]]
    if what != 1:
        launch += by
    if what != 0:
        meet += by
    if t.loops_only:
        meet = launch
    if what == 3:
        plan[KIND, customer] = any_kind(t, customer, stream)
    if launch < 0 or meet > place[plan.shape[1] - 1] or launch > meet:
        return False
    if launch == meet and not t.pads:
        return False
    plan[LAUNCH, customer] = plan[ROUTE, launch]
    plan[MEET, customer] = plan[ROUTE, meet]
    return True


@compiled
def _fits(t, plan, place, customer, role):
    """Whether this customer can take the part of that other one."""
    if place[role] >= 0:
        return t.truck_can[customer]
    return t.drone_can[plan[KIND, role], customer]


@compiled
def trade(t, plan, place, stream):
    """Exchange the parts of two customers near each other."""
    end = plan.shape[1] - 1
    one = 1 + below(stream, end - 1)
    other = near_node(t, one, stream)
    if other == 0 or other == end:
        return False
    if not (_fits(t, plan, place, one, other) and _fits(t, plan, place, other, one)):
        return False
    exchange(plan, place, one, other)
    return True


@compiled
def turn_round(t, plan, place, stream):
    """Reverse a part of the route (2-opt), beginning next to a near stop."""
    last = place[plan.shape[1] - 1]
    one = below(stream, last)
    other = near_place(t, place, plan[ROUTE, one], stream)
    first, final = min(one, other) + 1, max(one, other)
    if final >= last:
        final = last - 1
    if first >= final:
        return False
    reverse_stops(plan, place, first, final)
    return True


@compiled
def shift_stops(t, plan, place, stream):
    """Move one to three stops in a row next to a near stop (Or-opt)."""
    last = place[plan.shape[1] - 1]
    if last < 4:
        return False
    length = 1 + below(stream, 3)
    first = 1 + below(stream, last - 1)
    final = min(first + length - 1, last - 1)
    to = near_place(t, place, plan[ROUTE, first], stream)
    if first - 1 <= to <= final:
        return False
    back = below(stream, 2) == 0
    if to > final:  # three reversals make a rotation
        if not back:
            reverse_stops(plan, place, first, final)
        final_to = min(to, last - 1)
        reverse_stops(plan, place, first, final_to)
        reverse_stops(plan, place, first, first + final_to - final - 1)
    else:
        if not back:
            reverse_stops(plan, place, first, final)
        reverse_stops(plan, place, to + 1, final)
        reverse_stops(plan, place, to + 1 + final - first + 1, final)
    turn_sorties_forward(plan, place)
    return True


@compiled
def leave_aboard(t, plan, stream):
    """Leave one drone of a kind aboard all day, or use one more."""
    kind = below(stream, len(t.fleet))
    if kind >= plan.shape[1]:
        return False
    left = plan[IDLE, kind] + (1 if below(stream, 2) == 0 else -1)
    if left < 0 or left >= t.fleet[kind]:
        return False
    plan[IDLE, kind] = left
    return True


@compiled
def any_move(t, plan, place, stream):
    """A random move, by fixed shares (chosen by hand, not tuned)."""
    drawn = uniform(stream)
    if drawn < 0.001:
        reverse_day(plan, place)
        return True
    if drawn < 0.002:
        return leave_aboard(t, plan, stream)
    if drawn < 0.35:
        return relocate(t, plan, place, stream)
    if drawn < 0.60:
        return retime(t, plan, place, stream)
    if drawn < 0.75:
        return trade(t, plan, place, stream)
    if drawn < 0.85:
        return turn_round(t, plan, place, stream)
    return shift_stops(t, plan, place, stream)
