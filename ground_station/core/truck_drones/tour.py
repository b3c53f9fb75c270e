"""Truck tour: nearest neighbour, then 2-opt and Or-opt on directed travel times.

Deterministic, without a clock, with a directed matrix; fast-tsp's budget is in seconds and its
matrix symmetric. docs/explanation/truck-and-drones.md compares the two.
"""

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled_inner, compiled_with_arrays
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.tables import ROUTE, Plan, ProblemTables, empty_plan

GAIN_S = 1e-6


def short_tour_over_customers(tables: ProblemTables, customers: list[int]) -> NDArray[np.int64]:
    """Return a short tour from the depot over these customers to the depot's copy."""
    end = len(tables.travel_s) - 1
    left = np.array(sorted(customers), dtype=np.int64)
    tour = [0]
    while len(left):
        nearest = int(np.argmin(tables.travel_s[tour[-1], left]))
        tour.append(int(left[nearest]))
        left = np.delete(left, nearest)
    route = np.array([*tour, end], dtype=np.int64)
    improve_tour_in_place(tables.travel_s, tables.near, route)
    return route


def truck_only_plan(problem: TruckAndDrones, tables: ProblemTables) -> Plan:
    """Return a plan with a short truck tour over all customers that the truck can serve."""
    by_truck = [j for j in range(1, problem.end_node) if problem.truck_can_serve[j]]
    plan = empty_plan(problem.nodes)
    route = short_tour_over_customers(tables, by_truck)
    plan[ROUTE, : len(route)] = route
    return plan


@compiled_inner
def _store_cumulative_travel_times(travel_s, route, forth_s, back_s):
    """Sum the travel time along the route from the depot to each position, and back."""
    for at in range(1, len(route)):
        forth_s[at] = forth_s[at - 1] + travel_s[route[at - 1], route[at]]
        back_s[at] = back_s[at - 1] + travel_s[route[at], route[at - 1]]


@compiled_inner
def _reverse_in_place(route, first_index, last_index):
    while first_index < last_index:
        route[first_index], route[last_index] = route[last_index], route[first_index]
        first_index += 1
        last_index -= 1


@compiled_inner
def _time_saved_by_reversal_s(
    travel_s, route, cumulative_forward_s, cumulative_backward_s, first_index, last_index
):
    """Return the time saved by reversing positions first .. last."""
    before, after = route[first_index - 1], route[last_index + 1]
    old_s = cumulative_forward_s[last_index + 1] - cumulative_forward_s[first_index - 1]
    new_s = (
        travel_s[before, route[last_index]]
        + (cumulative_backward_s[last_index] - cumulative_backward_s[first_index])
        + travel_s[route[first_index], after]
    )
    return old_s - new_s


@compiled_inner
def _time_saved_by_shift_s(travel_s, route, first_index, last_index, target_index):
    """Return the time saved by moving positions first .. last to after `target_index`."""
    before, after = route[first_index - 1], route[last_index + 1]
    one, other = route[target_index], route[target_index + 1]
    old_s = (
        travel_s[before, route[first_index]]
        + travel_s[route[last_index], after]
        + travel_s[one, other]
    )
    new_s = (
        travel_s[before, after]
        + travel_s[one, route[first_index]]
        + travel_s[route[last_index], other]
    )
    return old_s - new_s


@compiled_inner
def _move_segment_after(route, first_index, last_index, target_index):
    """Move positions first .. last to directly after `target_index`."""
    if target_index > last_index:
        _reverse_in_place(route, first_index, last_index)
        _reverse_in_place(route, last_index + 1, target_index)
        _reverse_in_place(route, first_index, target_index)
    else:
        _reverse_in_place(route, target_index + 1, first_index - 1)
        _reverse_in_place(route, first_index, last_index)
        _reverse_in_place(route, target_index + 1, last_index)


@compiled_inner
def _apply_first_improvement_at(
    travel_s, near, route, route_index_by_node, forth_s, back_s, route_index
):
    """Apply the first time-saving change around this position; return whether one exists."""
    end_at = len(route) - 1
    for other in near[route[route_index]]:
        to = route_index_by_node[other]
        if to < 0:
            continue
        first, last = min(route_index, to) + 1, max(route_index, to)
        if first < last < end_at:
            gain_s = _time_saved_by_reversal_s(travel_s, route, forth_s, back_s, first, last)
            if gain_s > GAIN_S:
                _reverse_in_place(route, first, last)
                return True
        for length in range(1, 4):
            last = route_index + length - 1
            if route_index < 1 or last >= end_at:
                break
            for offset in range(2):
                gap = to - offset
                fits = 0 <= gap < end_at and (gap < route_index - 1 or gap > last)
                if (
                    fits
                    and _time_saved_by_shift_s(travel_s, route, route_index, last, gap) > GAIN_S
                ):
                    _move_segment_after(route, route_index, last, gap)
                    return True
    return False


@compiled_with_arrays
def improve_tour_in_place(travel_s, near, route):
    """Change the route in place until no 2-opt or Or-opt move among near nodes saves time."""
    position = np.full(len(travel_s), -1, dtype=np.int64)
    forth_s, back_s = np.zeros(len(route)), np.zeros(len(route))
    changed = True
    while changed:
        changed = False
        for at in range(len(route) - 1):
            improved = True
            while improved:
                for where in range(len(route)):
                    position[route[where]] = where
                _store_cumulative_travel_times(travel_s, route, forth_s, back_s)
                improved = _apply_first_improvement_at(
                    travel_s, near, route, position, forth_s, back_s, at
                )
                changed = changed or improved
