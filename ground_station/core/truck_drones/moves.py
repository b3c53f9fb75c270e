"""Small random changes of a plan for the search. False: nothing changed."""

from ground_station.core.truck_drones.compiled import compiled_inner
from ground_station.core.truck_drones.edits import (
    insert_stop,
    orient_sorties,
    remove_customer,
    reverse_stops,
    reverse_tour_and_sorties,
    swap_customers,
)
from ground_station.core.truck_drones.random_stream import draw_integer_below, draw_uniform
from ground_station.core.truck_drones.tables import (
    IDLE,
    IMMEDIATE,
    KIND,
    LATE,
    LAUNCH,
    NOWHERE,
    ORDER,
    RENDEZVOUS,
    ROUTE,
)

MAX_DRAWS = 8
MAX_SORTIE_OFFSET = 4
"""Range of launch and recovery of a new sortie, in route positions from the nearest stop."""


@compiled_inner
def draw_near_node(tables, node, stream):
    """Draw a node near this one; nearer nodes are more likely."""
    near = tables.near
    drawn = draw_uniform(stream)
    return near[node, int(drawn * drawn * near.shape[1])]


@compiled_inner
def draw_near_route_index(tables, route_index_by_node, node, stream):
    """Draw the route position of a stop near this node."""
    for _ in range(MAX_DRAWS):
        at = route_index_by_node[draw_near_node(tables, node, stream)]
        if at >= 0:
            return at
    return draw_integer_below(stream, route_index_by_node[len(route_index_by_node) - 1] + 1)


@compiled_inner
def draw_customer_served_by_drone(plan, stream):
    """Draw a customer served by a drone, or NOWHERE."""
    customers = plan.shape[1] - 2
    start = draw_integer_below(stream, customers)
    for step in range(customers):
        customer = 1 + (start + step) % customers
        if plan[LAUNCH, customer] != NOWHERE:
            return customer
    return NOWHERE


@compiled_inner
def draw_capable_drone_kind(tables, customer, stream):
    """Draw a kind of drone that can serve this customer, or NOWHERE."""
    can = tables.drone_can
    start = draw_integer_below(stream, can.shape[0])
    for step in range(can.shape[0]):
        kind = (start + step) % can.shape[0]
        if can[kind, customer]:
            return kind
    return NOWHERE


@compiled_inner
def try_insert_near_random_stop(tables, plan, route_index_by_node, customer, stream):
    """Serve a customer by truck, next to a stop near it."""
    if not tables.truck_can[customer]:
        return False
    at = draw_near_route_index(tables, route_index_by_node, customer, stream) + draw_integer_below(
        stream, 2
    )
    insert_stop(
        plan, route_index_by_node, customer, max(1, min(at, route_index_by_node[plan.shape[1] - 1]))
    )
    return True


@compiled_inner
def try_assign_random_sortie(tables, plan, route_index_by_node, customer, stream):
    """Serve a customer by drone, launched and recovered around a stop near it."""
    kind = draw_capable_drone_kind(tables, customer, stream)
    if kind == NOWHERE:
        return False
    last = route_index_by_node[plan.shape[1] - 1]
    at = draw_near_route_index(tables, route_index_by_node, customer, stream)
    drawn, also = draw_uniform(stream), draw_uniform(stream)
    launch = max(0, at - int(drawn * drawn * MAX_SORTIE_OFFSET))
    rendezvous = min(last, at + int(also * also * MAX_SORTIE_OFFSET))
    if tables.loops_only:
        launch = rendezvous = at
    elif launch == rendezvous and not tables.pads:
        if rendezvous < last and (launch == 0 or draw_integer_below(stream, 2) == 0):
            rendezvous += 1
        else:
            launch -= 1
    plan[LAUNCH, customer] = plan[ROUTE, launch]
    plan[RENDEZVOUS, customer] = plan[ROUTE, rendezvous]
    plan[KIND, customer] = kind
    plan[ORDER, customer] = (
        draw_integer_below(stream, 4) if draw_integer_below(stream, 4) == 0 else 0
    )
    return True


@compiled_inner
def try_relocate_random_customer(tables, plan, route_index_by_node, stream):
    """Serve one customer elsewhere, by truck or drone."""
    customer = 1 + draw_integer_below(stream, plan.shape[1] - 2)
    remove_customer(plan, route_index_by_node, customer, stream)
    if draw_integer_below(stream, 2) == 0 and try_assign_random_sortie(
        tables, plan, route_index_by_node, customer, stream
    ):
        return True
    return try_insert_near_random_stop(tables, plan, route_index_by_node, customer, stream)


@compiled_inner
def try_retime_random_sortie(tables, plan, route_index_by_node, stream):
    """Launch or recover one drone a stop or two earlier or later, or in another order at its
    stops, or use another kind of drone.
    """
    customer = draw_customer_served_by_drone(plan, stream)
    if customer == NOWHERE:
        return False
    variant = draw_integer_below(stream, 5)
    if variant == 4:
        plan[ORDER, customer] ^= IMMEDIATE if draw_integer_below(stream, 2) == 0 else LATE
        return True
    by = 1 + draw_integer_below(stream, 2)
    if draw_integer_below(stream, 2) == 0:
        by = -by
    launch, rendezvous = (
        route_index_by_node[plan[LAUNCH, customer]],
        route_index_by_node[plan[RENDEZVOUS, customer]],
    )
    if variant != 1:
        launch += by
    if variant != 0:
        rendezvous += by
    if tables.loops_only:
        rendezvous = launch
    if variant == 3:
        plan[KIND, customer] = draw_capable_drone_kind(tables, customer, stream)
    if launch < 0 or rendezvous > route_index_by_node[plan.shape[1] - 1] or launch > rendezvous:
        return False
    if launch == rendezvous and not tables.pads:
        return False
    plan[LAUNCH, customer] = plan[ROUTE, launch]
    plan[RENDEZVOUS, customer] = plan[ROUTE, rendezvous]
    return True


@compiled_inner
def _can_serve_in_place_of(tables, plan, route_index_by_node, customer, other_customer):
    """Return whether this customer can be served in the role of the other."""
    if route_index_by_node[other_customer] >= 0:
        return tables.truck_can[customer]
    return tables.drone_can[plan[KIND, other_customer], customer]


@compiled_inner
def try_random_swap_of_near_customers(tables, plan, route_index_by_node, stream):
    """Swap two customers near each other."""
    end = plan.shape[1] - 1
    one = 1 + draw_integer_below(stream, end - 1)
    other = draw_near_node(tables, one, stream)
    if other == 0 or other == end:
        return False
    if not (
        _can_serve_in_place_of(tables, plan, route_index_by_node, one, other)
        and _can_serve_in_place_of(tables, plan, route_index_by_node, other, one)
    ):
        return False
    swap_customers(plan, route_index_by_node, one, other)
    return True


@compiled_inner
def try_random_segment_reversal(tables, plan, route_index_by_node, stream):
    """Reverse a part of the route (2-opt), beginning next to a near stop."""
    last = route_index_by_node[plan.shape[1] - 1]
    one = draw_integer_below(stream, last)
    other = draw_near_route_index(tables, route_index_by_node, plan[ROUTE, one], stream)
    first, final = min(one, other) + 1, max(one, other)
    if final >= last:
        final = last - 1
    if first >= final:
        return False
    reverse_stops(plan, route_index_by_node, first, final)
    return True


@compiled_inner
def try_random_move_of_stops(tables, plan, route_index_by_node, stream):
    """Move one to three stops in a row next to a near stop (Or-opt)."""
    last = route_index_by_node[plan.shape[1] - 1]
    if last < 4:
        return False
    length = 1 + draw_integer_below(stream, 3)
    first = 1 + draw_integer_below(stream, last - 1)
    final = min(first + length - 1, last - 1)
    to = draw_near_route_index(tables, route_index_by_node, plan[ROUTE, first], stream)
    if first - 1 <= to <= final:
        return False
    back = draw_integer_below(stream, 2) == 0
    if to > final:  # three reversals make a rotation
        if not back:
            reverse_stops(plan, route_index_by_node, first, final)
        final_to = min(to, last - 1)
        reverse_stops(plan, route_index_by_node, first, final_to)
        reverse_stops(plan, route_index_by_node, first, first + final_to - final - 1)
    else:
        if not back:
            reverse_stops(plan, route_index_by_node, first, final)
        reverse_stops(plan, route_index_by_node, to + 1, final)
        reverse_stops(plan, route_index_by_node, to + 1 + final - first + 1, final)
    orient_sorties(plan, route_index_by_node)
    return True


@compiled_inner
def try_random_change_of_unused_drones(tables, plan, stream):
    """Leave one more drone of a kind unused on the truck, or one fewer."""
    kind = draw_integer_below(stream, len(tables.fleet))
    if kind >= plan.shape[1]:
        return False
    left = plan[IDLE, kind] + (1 if draw_integer_below(stream, 2) == 0 else -1)
    if left < 0 or left >= tables.fleet[kind]:
        return False
    plan[IDLE, kind] = left
    return True


@compiled_inner
def try_random_move(tables, plan, route_index_by_node, stream):
    """Apply a random move, by fixed probabilities (not tuned)."""
    drawn = draw_uniform(stream)
    if drawn < 0.001:
        reverse_tour_and_sorties(plan, route_index_by_node)
        return True
    if drawn < 0.002:
        return try_random_change_of_unused_drones(tables, plan, stream)
    if drawn < 0.35:
        return try_relocate_random_customer(tables, plan, route_index_by_node, stream)
    if drawn < 0.60:
        return try_retime_random_sortie(tables, plan, route_index_by_node, stream)
    if drawn < 0.75:
        return try_random_swap_of_near_customers(tables, plan, route_index_by_node, stream)
    if drawn < 0.85:
        return try_random_segment_reversal(tables, plan, route_index_by_node, stream)
    return try_random_move_of_stops(tables, plan, route_index_by_node, stream)
