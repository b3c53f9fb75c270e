"""A tour of the truck that leaves out whom a drone serves more cheaply, at a price for a flight.

Where drones are plenty, the end of the day is the truck's driving and the driver's work: whether a
customer is worth a stop is a matter of the detour against the driver's time for a flight. Where
they are scarce, a flight costs more. So tours for several prices have the shapes of good days
(profitable tour problem; Dell'Amico, Maffioli and Varbrand 1995). By simulated annealing.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.random_stream import RandomStream, below, uniform
from ground_station.core.truck_drones.tables import NOWHERE, Tables
from ground_station.core.truck_drones.tour import first_tour

TRIALS_PER_NODE, LEAST_TRIALS = 600, 20_000
HOT_LEGS, COLD_LEGS = 0.7, 0.025
"""Temperatures as shares of the full tour's mean leg."""


def priced_tour(
    tables: Tables, flight_s: NDArray[np.float64], stream: RandomStream
) -> NDArray[np.int32]:
    """Stops from the depot to its copy: short, where each customer left out costs `flight_s`.

    `flight_s` by node, above the truck's own delivery; inf: it must be on the tour.
    """
    end = len(tables.travel_s) - 1
    full = first_tour(tables, [j for j in range(1, end) if tables.truck_can[j]])
    route = np.zeros(end + 2, dtype=np.int32)
    route[: len(full)] = full
    place = np.full(end + 1, NOWHERE, dtype=np.int32)
    place[full] = np.arange(len(full))
    leg_s = float(tables.travel_s[full[:-1], full[1:]].sum()) / len(full)
    places = _anneal(
        tables.travel_s,
        tables.truck_can,
        tables.near,
        flight_s,
        route,
        place,
        stream,
        max(LEAST_TRIALS, TRIALS_PER_NODE * (end + 1)),
        max(HOT_LEGS * leg_s, 1e-9),
        max(COLD_LEGS * leg_s, 1e-9),
    )
    return route[:places]


@compiled
def _set(route, place, at, node):
    route[at] = node
    place[node] = at


@compiled
def _gap_near(near, place, node, end, stream):
    """The place before which this node may go, next to a near stop; NOWHERE: that is no stop."""
    drawn = uniform(stream)
    at = place[near[node, int(drawn * drawn * near.shape[1])]]
    if at < 0:
        return NOWHERE
    if at == 0 or (at != place[end] and below(stream, 2) == 0):
        return at + 1
    return at


@compiled
def _detour_s(travel_s, before, node, after):
    return travel_s[before, node] + travel_s[node, after] - travel_s[before, after]


@compiled
def _leave_out(route, place, at, places):
    place[route[at]] = NOWHERE
    for to in range(at, places - 1):
        _set(route, place, to, route[to + 1])


@compiled
def _put_in(route, place, node, at, places):
    for to in range(places, at, -1):
        _set(route, place, to, route[to - 1])
    _set(route, place, at, node)


@compiled
def _turned(travel_s, near, route, place, places, stream, worse_s):
    """Reverse a part of the tour (2-opt) between near stops, if it costs at most this more."""
    one = 1 + below(stream, places - 2)
    drawn = uniform(stream)
    other = place[near[route[one], int(drawn * drawn * near.shape[1])]]
    if other <= 0 or other == places - 1:
        return
    first, last = min(one, other), max(one, other)
    if below(stream, 2) == 0:
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
    if more_s > worse_s:
        return
    while first < last:
        low, high = route[first], route[last]
        _set(route, place, first, high)
        _set(route, place, last, low)
        first += 1
        last -= 1


@compiled
def _anneal(travel_s, truck_can, near, flight_s, route, place, stream, trials, hot_s, cold_s):
    """Change the tour in place; the number of its places."""
    end = len(place) - 1
    places = place[end] + 1
    cooling = (cold_s / hot_s) ** (1.0 / max(1, trials))
    temperature_s = hot_s
    for _ in range(trials):
        temperature_s *= cooling
        worse_s = -temperature_s * math.log(1.0 - uniform(stream))
        if places > 3 and below(stream, 2) == 0:
            _turned(travel_s, near, route, place, places, stream, worse_s)
            continue
        if end < 2:
            return places
        node = 1 + below(stream, end - 1)
        at = place[node]
        if at < 0:
            to = _gap_near(near, place, node, end, stream)
            if to == NOWHERE or not truck_can[node]:
                continue
            if _detour_s(travel_s, route[to - 1], node, route[to]) - flight_s[node] <= worse_s:
                _put_in(route, place, node, to, places)
                places += 1
            continue
        saved_s = _detour_s(travel_s, route[at - 1], node, route[at + 1])
        if below(stream, 2) == 0:
            if flight_s[node] - saved_s <= worse_s:
                _leave_out(route, place, at, places)
                places -= 1
            continue
        to = _gap_near(near, place, node, end, stream)
        if to == NOWHERE or 0 <= to - at <= 1:
            continue
        if _detour_s(travel_s, route[to - 1], node, route[to]) - saved_s <= worse_s:
            _leave_out(route, place, at, places)
            _put_in(route, place, node, to - 1 if to > at else to, places - 1)
    return places
