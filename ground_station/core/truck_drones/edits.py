"""Elementary changes of a plan's arrays that keep its sorties valid; the basis of all moves."""

from ground_station.core.truck_drones.compiled import compiled, compiled_inner
from ground_station.core.truck_drones.random_stream import draw_integer_below
from ground_station.core.truck_drones.tables import (
    KIND,
    LAUNCH,
    NOWHERE,
    ORDER,
    RENDEZVOUS,
    ROUTE,
)


@compiled
def store_route_index_by_node(plan, route_index_by_node):
    """Index the route position of each node (NOWHERE: absent); return the number of positions."""
    end = plan.shape[1] - 1
    for node in range(end + 1):
        route_index_by_node[node] = NOWHERE
    at = 0
    while plan[ROUTE, at] != end:
        route_index_by_node[plan[ROUTE, at]] = at
        at += 1
    route_index_by_node[end] = at
    return at + 1


@compiled_inner
def insert_stop(plan, route_index_by_node, node, route_index):
    """Insert a node into the route at this position (1 to the end's)."""
    last = route_index_by_node[plan.shape[1] - 1]
    for to in range(last, route_index - 1, -1):
        plan[ROUTE, to + 1] = plan[ROUTE, to]
        route_index_by_node[plan[ROUTE, to]] = to + 1
    plan[ROUTE, route_index] = node
    route_index_by_node[node] = route_index


@compiled_inner
def remove_stop_and_move_sorties(plan, route_index_by_node, node, stream):
    """Remove a node from the route; move its launches and recoveries to a neighbouring stop."""
    at, last = route_index_by_node[node], route_index_by_node[plan.shape[1] - 1]
    before, after = plan[ROUTE, at - 1], plan[ROUTE, at + 1]
    for customer in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, customer] == node and plan[RENDEZVOUS, customer] == node:
            neighbour = after if draw_integer_below(stream, 2) == 0 else before
            plan[LAUNCH, customer] = neighbour
            plan[RENDEZVOUS, customer] = neighbour
        elif plan[LAUNCH, customer] == node:
            onward = plan[RENDEZVOUS, customer] != after and draw_integer_below(stream, 2) == 0
            plan[LAUNCH, customer] = after if onward else before
        elif plan[RENDEZVOUS, customer] == node:
            back = plan[LAUNCH, customer] != before and draw_integer_below(stream, 2) == 0
            plan[RENDEZVOUS, customer] = before if back else after
    for to in range(at, last):
        plan[ROUTE, to] = plan[ROUTE, to + 1]
        route_index_by_node[plan[ROUTE, to]] = to
    route_index_by_node[node] = NOWHERE


@compiled_inner
def remove_customer(plan, route_index_by_node, customer, stream):
    """Remove this customer's stop or sortie."""
    if route_index_by_node[customer] >= 0:
        remove_stop_and_move_sorties(plan, route_index_by_node, customer, stream)
    else:
        plan[LAUNCH, customer] = NOWHERE
        plan[RENDEZVOUS, customer] = NOWHERE


@compiled_inner
def orient_sorties(plan, route_index_by_node):
    """Swap launch and rendezvous of sorties whose rendezvous precedes their launch."""
    for customer in range(1, plan.shape[1] - 1):
        launch, rendezvous = plan[LAUNCH, customer], plan[RENDEZVOUS, customer]
        if launch != NOWHERE and route_index_by_node[launch] > route_index_by_node[rendezvous]:
            plan[LAUNCH, customer], plan[RENDEZVOUS, customer] = rendezvous, launch


@compiled_inner
def reverse_stops(plan, route_index_by_node, first_index, last_index):
    """Reverse the order of these route positions."""
    while first_index < last_index:
        one, other = plan[ROUTE, first_index], plan[ROUTE, last_index]
        plan[ROUTE, first_index], plan[ROUTE, last_index] = other, one
        route_index_by_node[other], route_index_by_node[one] = first_index, last_index
        first_index += 1
        last_index -= 1
    orient_sorties(plan, route_index_by_node)


@compiled_inner
def _node_in_reversed_day(node, end):
    """Return the corresponding node of the reversed day."""
    if node == 0:
        return end
    return 0 if node == end else node


@compiled_inner
def reverse_tour_and_sorties(plan, route_index_by_node):
    """Reverse the tour and every sortie."""
    end = plan.shape[1] - 1
    first, last = 1, route_index_by_node[end] - 1
    while first < last:
        plan[ROUTE, first], plan[ROUTE, last] = plan[ROUTE, last], plan[ROUTE, first]
        first += 1
        last -= 1
    for customer in range(1, end):
        launch, rendezvous = plan[LAUNCH, customer], plan[RENDEZVOUS, customer]
        if launch != NOWHERE:
            plan[LAUNCH, customer] = _node_in_reversed_day(rendezvous, end)
            plan[RENDEZVOUS, customer] = _node_in_reversed_day(launch, end)
    store_route_index_by_node(plan, route_index_by_node)


@compiled_inner
def swap_customers(plan, route_index_by_node, first_customer, second_customer):
    """Swap two customers in the plan, with all sorties that use their stops."""
    for customer in range(1, plan.shape[1] - 1):
        for row in (LAUNCH, RENDEZVOUS):
            if plan[row, customer] == first_customer:
                plan[row, customer] = second_customer
            elif plan[row, customer] == second_customer:
                plan[row, customer] = first_customer
    for row in (LAUNCH, RENDEZVOUS, KIND, ORDER):
        plan[row, first_customer], plan[row, second_customer] = (
            plan[row, second_customer],
            plan[row, first_customer],
        )
    route_index_by_node[first_customer], route_index_by_node[second_customer] = (
        route_index_by_node[second_customer],
        route_index_by_node[first_customer],
    )
    if route_index_by_node[first_customer] >= 0:
        plan[ROUTE, route_index_by_node[first_customer]] = first_customer
    if route_index_by_node[second_customer] >= 0:
        plan[ROUTE, route_index_by_node[second_customer]] = second_customer
