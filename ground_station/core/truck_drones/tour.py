"""The truck's tour alone: nearest neighbour, then 2-opt and Or-opt on directed travel times.

It is deterministic, needs no clock, and takes a directed matrix; fast-tsp's budget is in seconds
and its matrix is symmetric. The two are compared in docs/explanation/truck-and-drones.md.
"""

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled, compiled_with_arrays
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.tables import ROUTE, Plan, Tables, empty_plan

GAIN_S = 1e-6


def first_tour(tables: Tables, customers: list[int]) -> NDArray[np.int32]:
    """A short tour from the depot over these customers to the depot's copy."""
    end = len(tables.travel_s) - 1
    left = np.array(sorted(customers), dtype=np.int64)
    tour = [0]
    while len(left):
        nearest = int(np.argmin(tables.travel_s[tour[-1], left]))
        tour.append(int(left[nearest]))
        left = np.delete(left, nearest)
    route = np.array([*tour, end], dtype=np.int32)
    improve_tour(tables.travel_s, tables.near, route)
    return route


def truck_alone(problem: TruckAndDrones, tables: Tables) -> Plan:
    """The truck serves every customer that it can on a short tour; the others are not served."""
    by_truck = [j for j in range(1, problem.end) if problem.truck_can_serve[j]]
    plan = empty_plan(problem.nodes)
    route = first_tour(tables, by_truck)
    plan[ROUTE, : len(route)] = route
    return plan


@compiled
def _sums(travel_s, route, forth_s, back_s):
    """Time from the depot along the route to each place, and from each place back along it."""
    for at in range(1, len(route)):
        forth_s[at] = forth_s[at - 1] + travel_s[route[at - 1], route[at]]
        back_s[at] = back_s[at - 1] + travel_s[route[at], route[at - 1]]


@compiled
def _turn(route, first, last):
    while first < last:
        route[first], route[last] = route[last], route[first]
        first += 1
        last -= 1


@compiled
def _turn_gain_s(travel_s, route, forth_s, back_s, first, last):
    """Time saved by reversing the places first .. last."""
    before, after = route[first - 1], route[last + 1]
    old_s = forth_s[last + 1] - forth_s[first - 1]
    new_s = (
        travel_s[before, route[last]]
        + (back_s[last] - back_s[first])
        + travel_s[route[first], after]
    )
    return old_s - new_s


@compiled
def _shift_gain_s(travel_s, route, first, last, to):
    """Time saved by moving the places first .. last between `to` and its next place."""
    before, after = route[first - 1], route[last + 1]
    one, other = route[to], route[to + 1]
    old_s = travel_s[before, route[first]] + travel_s[route[last], after] + travel_s[one, other]
    new_s = travel_s[before, after] + travel_s[one, route[first]] + travel_s[route[last], other]
    return old_s - new_s


@compiled
def _shift(route, first, last, to):
    """Move the places first .. last right behind `to`."""
    if to > last:
        _turn(route, first, last)
        _turn(route, last + 1, to)
        _turn(route, first, to)
    else:
        _turn(route, to + 1, first - 1)
        _turn(route, first, last)
        _turn(route, to + 1, last)


@compiled
def _improve_from(travel_s, near, route, place, forth_s, back_s, at):
    """Apply the first change around this place that saves time; whether there was one."""
    end_at = len(route) - 1
    for other in near[route[at]]:
        to = place[other]
        if to < 0:
            continue
        first, last = min(at, to) + 1, max(at, to)
        if first < last < end_at:
            gain_s = _turn_gain_s(travel_s, route, forth_s, back_s, first, last)
            if gain_s > GAIN_S:
                _turn(route, first, last)
                return True
        for length in range(1, 4):
            last = at + length - 1
            if at < 1 or last >= end_at:
                break
            for ahead in range(2):
                gap = to - ahead
                fits = 0 <= gap < end_at and (gap < at - 1 or gap > last)
                if fits and _shift_gain_s(travel_s, route, at, last, gap) > GAIN_S:
                    _shift(route, at, last, gap)
                    return True
    return False


@compiled_with_arrays
def improve_tour(travel_s, near, route):
    """Change the route in place until no 2-opt or Or-opt move among near nodes saves time."""
    place = np.full(len(travel_s), -1, dtype=np.int32)
    forth_s, back_s = np.zeros(len(route)), np.zeros(len(route))
    changed = True
    while changed:
        changed = False
        for at in range(len(route) - 1):
            better = True
            while better:
                for where in range(len(route)):
                    place[route[where]] = where
                _sums(travel_s, route, forth_s, back_s)
                better = _improve_from(travel_s, near, route, place, forth_s, back_s, at)
                changed = changed or better
