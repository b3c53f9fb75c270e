"""A truck tour that skips customers that a drone serves at lower cost, for a price of a flight.

With many drones, the makespan consists of the truck's driving and the driver's work: the detour of
a stop competes with the driver's time for a flight. With few drones a flight costs more. Tours for
several prices therefore resemble those of good plans (profitable tour problem; Dell'Amico, Maffioli
and Varbrand 1995). By simulated annealing.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled, compiled_inner
from ground_station.core.truck_drones.random_stream import (
    RandomStream,
    draw_integer_below,
    draw_uniform,
)
from ground_station.core.truck_drones.tables import NOWHERE, ProblemTables
from ground_station.core.truck_drones.tour import short_tour_over_customers

TRIALS_PER_NODE, LEAST_TRIALS = 600, 20_000
START_TEMPERATURE_FRAC, END_TEMPERATURE_FRAC = 0.7, 0.025
"""Temperatures as shares of the full tour's mean leg."""


def anneal_priced_tour(
    tables: ProblemTables, flight_cost_by_node_s: NDArray[np.float64], stream: RandomStream
) -> NDArray[np.int64]:
    """Return a short tour from the depot to its copy, where a skipped customer costs
    `flight_cost_by_node_s`.

    `flight_cost_by_node_s` by node, in excess of the truck's own delivery; inf: the node must be on
    the tour.
    """
    end = len(tables.travel_s) - 1
    full = short_tour_over_customers(tables, [j for j in range(1, end) if tables.truck_can[j]])
    route = np.zeros(end + 2, dtype=np.int64)
    route[: len(full)] = full
    position = np.full(end + 1, NOWHERE, dtype=np.int64)
    position[full] = np.arange(len(full))
    leg_s = float(tables.travel_s[full[:-1], full[1:]].sum()) / len(full)
    position_count = _anneal_tour_in_place(
        tables.travel_s,
        tables.truck_can,
        tables.near,
        flight_cost_by_node_s,
        route,
        position,
        stream,
        max(LEAST_TRIALS, TRIALS_PER_NODE * (end + 1)),
        max(START_TEMPERATURE_FRAC * leg_s, 1e-9),
        max(END_TEMPERATURE_FRAC * leg_s, 1e-9),
    )
    return route[:position_count]


@compiled_inner
def _set_route_node(route, route_index_by_node, route_index, node):
    route[route_index] = node
    route_index_by_node[node] = route_index


@compiled_inner
def _draw_insertion_route_index(near, route_index_by_node, node, end, stream):
    """Draw an insertion position next to a near node; NOWHERE if that node is not on the tour."""
    drawn = draw_uniform(stream)
    at = route_index_by_node[near[node, int(drawn * drawn * near.shape[1])]]
    if at < 0:
        return NOWHERE
    if at == 0 or (at != route_index_by_node[end] and draw_integer_below(stream, 2) == 0):
        return at + 1
    return at


@compiled_inner
def _detour_s(travel_s, previous_node, node, next_node):
    return (
        travel_s[previous_node, node]
        + travel_s[node, next_node]
        - travel_s[previous_node, next_node]
    )


@compiled_inner
def _remove_node(route, route_index_by_node, at, position_count):
    route_index_by_node[route[at]] = NOWHERE
    for to in range(at, position_count - 1):
        _set_route_node(route, route_index_by_node, to, route[to + 1])


@compiled_inner
def _insert_node(route, route_index_by_node, node, at, position_count):
    for to in range(position_count, at, -1):
        _set_route_node(route, route_index_by_node, to, route[to - 1])
    _set_route_node(route, route_index_by_node, at, node)


@compiled_inner
def _try_random_segment_reversal(
    travel_s, near, route, route_index_by_node, position_count, stream, allowed_increase_s
):
    """Reverse a part of the tour (2-opt) between near stops, if it adds at most
    `allowed_increase_s`.
    """
    one = 1 + draw_integer_below(stream, position_count - 2)
    drawn = draw_uniform(stream)
    other = route_index_by_node[near[route[one], int(drawn * drawn * near.shape[1])]]
    if other <= 0 or other == position_count - 1:
        return
    first, last = min(one, other), max(one, other)
    if draw_integer_below(stream, 2) == 0:
        first += 1
    else:
        last -= 1
    if first >= last:
        return
    before, after = route[first - 1], route[last + 1]
    more_s = travel_s[before, route[last]] + travel_s[route[first], after]
    more_s -= travel_s[before, route[first]] + travel_s[route[last], after]
    for at in range(first, last):
        more_s += travel_s[route[at + 1], route[at]] - travel_s[route[at], route[at + 1]]
    if more_s > allowed_increase_s:
        return
    while first < last:
        low, high = route[first], route[last]
        _set_route_node(route, route_index_by_node, first, high)
        _set_route_node(route, route_index_by_node, last, low)
        first += 1
        last -= 1


@compiled
def _anneal_tour_in_place(
    travel_s,
    truck_can,
    near,
    flight_cost_by_node_s,
    route,
    route_index_by_node,
    stream,
    trials,
    start_temperature_s,
    end_temperature_s,
):
    """Change the tour in place; return its number of positions."""
    end = len(route_index_by_node) - 1
    position_count = route_index_by_node[end] + 1
    cooling = (end_temperature_s / start_temperature_s) ** (1.0 / max(1, trials))
    temperature_s = start_temperature_s
    for _ in range(trials):
        temperature_s *= cooling
        allowed_s = -temperature_s * math.log(1.0 - draw_uniform(stream))
        if position_count > 3 and draw_integer_below(stream, 2) == 0:
            _try_random_segment_reversal(
                travel_s, near, route, route_index_by_node, position_count, stream, allowed_s
            )
            continue
        if end < 2:
            return position_count
        node = 1 + draw_integer_below(stream, end - 1)
        at = route_index_by_node[node]
        if at < 0:
            to = _draw_insertion_route_index(near, route_index_by_node, node, end, stream)
            if to == NOWHERE or not truck_can[node]:
                continue
            if (
                _detour_s(travel_s, route[to - 1], node, route[to]) - flight_cost_by_node_s[node]
                <= allowed_s
            ):
                _insert_node(route, route_index_by_node, node, to, position_count)
                position_count += 1
            continue
        saved_s = _detour_s(travel_s, route[at - 1], node, route[at + 1])
        if draw_integer_below(stream, 2) == 0:
            if flight_cost_by_node_s[node] - saved_s <= allowed_s:
                _remove_node(route, route_index_by_node, at, position_count)
                position_count -= 1
            continue
        to = _draw_insertion_route_index(near, route_index_by_node, node, end, stream)
        if to == NOWHERE or 0 <= to - at <= 1:
            continue
        if _detour_s(travel_s, route[to - 1], node, route[to]) - saved_s <= allowed_s:
            _remove_node(route, route_index_by_node, at, position_count)
            _insert_node(
                route, route_index_by_node, node, to - 1 if to > at else to, position_count - 1
            )
    return position_count
