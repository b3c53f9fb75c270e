"""A plan of one truck and one drone as a chain of operations, and random changes of it.

The chain is a sequence of visits from the depot to its copy. Each visit has a role. Truck and drone
are together at a SYNC visit. Between two SYNC visits the truck makes the ALONE visits and the drone
may make one FLOWN visit, at any position between them. A LOOP visit is flown from the nearer of the
two adjacent SYNC visits while the truck waits. An OFF visit is skipped; spare nodes represent a
second visit of some other node, and most of them are OFF. The cost of an operation is the greater
of truck cost and drone cost, so a change is evaluated over the affected operations only.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled, compiled_inner
from ground_station.core.truck_drones.random_stream import draw_integer_below, draw_uniform
from ground_station.core.truck_drones.tuple_reference import passed_by_reference

SYNC, TRUCK_ONLY, FLOWN, LOOP, OFF = range(5)
REJECTED = np.inf
"""Cost change of a rejected move."""


@passed_by_reference
class OperationChain(NamedTuple):
    """The problem and the current plan. The last visit is the copy of the depot at the end of the
    plan; nodes above it are spare.
    """

    drive: NDArray[np.float64]
    """Cost of the truck from node to node, symmetric."""
    fly: NDArray[np.float64]
    """Cost of the drone from node to node, symmetric."""
    near: NDArray[np.int64]
    """By node, the nearest others, nearest first."""
    visits: NDArray[np.int64]
    """Nodes in order of visit."""
    position: NDArray[np.int64]
    """Position of each node among the visits."""
    role: NDArray[np.int8]
    """By node."""
    same_as: NDArray[np.int64]
    """By node, the node at the same location: a different one for spare nodes only."""
    spare: NDArray[np.int64]
    """Buffer for two stretches of visits."""


@compiled_inner
def _loop_visits_cost(fly, role, visits, first, last):
    """Return the cost of the LOOP visits between two SYNC visits."""
    cost = 0.0
    one, other = visits[first], visits[last]
    for at in range(first + 1, last):
        node = visits[at]
        if role[node] == LOOP:
            cost += 2.0 * min(fly[one, node], fly[other, node])
    return cost


@compiled
def operations_cost_between_syncs(chain, visits, first_index, last_index):
    """Return the cost of the operations between two SYNC positions; inf if one flies twice."""
    drive, fly, role = chain.drive, chain.fly, chain.role
    cost, truck, loops = 0.0, 0.0, False
    start_at, flown = first_index, -1
    start = stop = visits[first_index]
    for at in range(first_index + 1, last_index + 1):
        node = visits[at]
        node_role = role[node]
        if node_role == SYNC:
            truck += drive[stop, node]
            if flown >= 0:
                drone = fly[start, flown] + fly[flown, node]
                cost += max(truck, drone)
            else:
                cost += truck
            if loops:
                cost += _loop_visits_cost(fly, role, visits, start_at, at)
            start_at, flown, truck, loops = at, -1, 0.0, False
            start = stop = node
        elif node_role == TRUCK_ONLY:
            truck += drive[stop, node]
            stop = node
        elif node_role == FLOWN:
            if flown >= 0:
                return np.inf
            flown = node
        elif node_role == LOOP:
            loops = True
    return cost


@compiled_inner
def _last_sync_index_until(chain, at):
    """Return the last SYNC position at or before this one."""
    at = max(at, 0)
    while chain.role[chain.visits[at]] != SYNC:
        at -= 1
    return at


@compiled_inner
def _first_sync_index_from(chain, at):
    """Return the first SYNC position at or after this one."""
    at = min(at, len(chain.visits) - 1)
    while chain.role[chain.visits[at]] != SYNC:
        at += 1
    return at


@compiled_inner
def _draw_near_node(chain, node, stream):
    """Draw a node near this one; nearer nodes are more likely."""
    drawn = draw_uniform(stream)
    return chain.near[node, int(drawn * drawn * chain.near.shape[1])]


@compiled_inner
def _move_positions(chain, first, last, to, is_reversed):
    """Move positions first .. last to directly after `to`, outside them, or `is_reversed`."""
    count = last - first + 1
    visits, position, kept = chain.visits, chain.position, chain.spare
    for at in range(count):
        kept[at] = visits[last - at] if is_reversed else visits[first + at]
    if to > last:
        for at in range(last + 1, to + 1):
            visits[at - count] = visits[at]
            position[visits[at]] = at - count
        begin = to - count + 1
    else:
        for at in range(first - 1, to, -1):
            visits[at + count] = visits[at]
            position[visits[at]] = at + count
        begin = to + 1
    for at in range(count):
        visits[begin + at] = kept[at]
        position[kept[at]] = begin + at


@compiled_inner
def _write_moved_range_to_spare(chain, low, high, first, last, to, is_reversed, begin):
    """Write low .. high as after the move to the spare buffer from `begin`; return its end."""
    for at in range(low, high + 1):
        if at < first or at > last:
            chain.spare[begin] = chain.visits[at]
            begin += 1
        if at == to:
            for step in range(last - first + 1):
                chain.spare[begin] = (
                    chain.visits[last - step] if is_reversed else chain.visits[first + step]
                )
                begin += 1
    return begin


@compiled_inner
def _is_spare(chain, node):
    return node > chain.visits[len(chain.visits) - 1]


@compiled_inner
def _represent_random_node_by_spare(chain, node, stream):
    """Let a spare node that is OFF represent a random node."""
    same = chain.same_as[chain.visits[draw_integer_below(stream, len(chain.visits))]]
    chain.same_as[node] = same
    for other in range(len(chain.drive)):
        chain.drive[node, other] = chain.drive[other, node] = chain.drive[same, other]
        chain.fly[node, other] = chain.fly[other, node] = chain.fly[same, other]
    chain.drive[node, node] = chain.fly[node, node] = 0.0
    for column in range(chain.near.shape[1]):
        chain.near[node, column] = chain.near[same, column]


@compiled_inner
def _set_random_role(chain, node, stream):
    """Draw a role for a node; roles with the truck are more likely."""
    drawn = draw_uniform(stream)
    if _is_spare(chain, node):
        chain.role[node] = SYNC if drawn < 0.5 else OFF
    elif drawn < 0.35:
        chain.role[node] = SYNC
    elif drawn < 0.65:
        chain.role[node] = TRUCK_ONLY
    elif drawn < 0.97:
        chain.role[node] = FLOWN
    else:
        chain.role[node] = LOOP


@compiled_inner
def try_random_move_of_visits(chain, stream, allowed_cost_increase):
    """Move one to three visits next to a near visit, with new roles at the seams.

    Returns the cost change; REFUSED if it exceeds `allowed_cost_increase`.
    """
    end = len(chain.visits) - 1
    count = 1 if draw_integer_below(stream, 3) else min(1 + draw_integer_below(stream, 3), end - 1)
    first = 1 + draw_integer_below(stream, end - count)
    last = first + count - 1
    node = chain.visits[first]
    if chain.role[node] == OFF and count == 1:
        _represent_random_node_by_spare(chain, node, stream)
    to = first - 1
    if draw_integer_below(stream, 4):
        to = chain.position[_draw_near_node(chain, node, stream)] - draw_integer_below(stream, 2)
        to = max(0, min(to, end - 1))
        if first - 1 <= to <= last:
            to = first - 1
    back = count > 1 and draw_integer_below(stream, 2) == 0
    changed = draw_integer_below(stream, 3)
    margin = 1 if changed else 0
    low, high = (
        _last_sync_index_until(chain, first - 1 - margin),
        _first_sync_index_from(chain, last + 1 + margin),
    )
    low_to, high_to, joined = low, high, True
    if to != first - 1:
        low_to, high_to = (
            _last_sync_index_until(chain, to - margin),
            _first_sync_index_from(chain, to + 1 + margin),
        )
        joined = low < high_to and low_to < high
        if joined:
            low, high = min(low, low_to), max(high, high_to)
    cost = operations_cost_between_syncs(chain, chain.visits, low, high)
    if not joined:
        cost += operations_cost_between_syncs(chain, chain.visits, low_to, high_to)

    role = chain.role[node]
    if count == 1 and draw_integer_below(stream, 4):
        _set_random_role(chain, node, stream)
    others = (node, node)
    roles = (role, role)
    for step in range(changed):
        drawn = draw_integer_below(stream, 4)
        at = first - 1 if drawn == 0 else last + 1 if drawn == 1 else to if drawn == 2 else to + 1
        other = chain.visits[max(0, min(at, end))]
        if other == 0 or other == chain.visits[end]:
            continue
        if step == 0:
            others, roles = (other, others[1]), (chain.role[other], roles[1])
        else:
            others, roles = (others[0], other), (roles[0], chain.role[other])
        _set_random_role(chain, other, stream)

    if joined:
        stop = _write_moved_range_to_spare(chain, low, high, first, last, to, back, 0)
        now = operations_cost_between_syncs(chain, chain.spare, 0, stop - 1)
    else:
        stop = _write_moved_range_to_spare(chain, low, high, first, last, -1, back, 0)
        now = operations_cost_between_syncs(chain, chain.spare, 0, stop - 1)
        if now - cost <= allowed_cost_increase:
            stop = _write_moved_range_to_spare(chain, low_to, high_to, first, last, to, back, 0)
            now += operations_cost_between_syncs(chain, chain.spare, 0, stop - 1)
    if not now - cost <= allowed_cost_increase:
        chain.role[others[1]] = roles[1]
        chain.role[others[0]] = roles[0]
        chain.role[node] = role
        return REJECTED
    if to != first - 1:
        _move_positions(chain, first, last, to, back)
    elif back:
        _reverse_positions(chain, first, last)
    return now - cost


@compiled_inner
def _reverse_positions(chain, first, last):
    """Reverse these positions."""
    while first < last:
        one, other = chain.visits[first], chain.visits[last]
        chain.visits[first], chain.visits[last] = other, one
        chain.position[other], chain.position[one] = first, last
        first += 1
        last -= 1


@compiled_inner
def _swap_nodes(chain, first_node, second_node, with_roles):
    """Swap the positions of two nodes, and optionally their roles."""
    at, to = chain.position[first_node], chain.position[second_node]
    chain.visits[at], chain.visits[to] = second_node, first_node
    chain.position[first_node], chain.position[second_node] = to, at
    if with_roles:
        chain.role[first_node], chain.role[second_node] = (
            chain.role[second_node],
            chain.role[first_node],
        )


@compiled_inner
def try_random_swap_of_visits(chain, stream, allowed_cost_increase):
    """Swap two near visits; see `try_random_move_of_visits`."""
    end = len(chain.visits) - 1
    one = chain.visits[1 + draw_integer_below(stream, end - 1)]
    other = _draw_near_node(chain, one, stream)
    at, to = chain.position[one], chain.position[other]
    if to == 0 or to == end:
        return REJECTED
    at, to = min(at, to), max(at, to)
    low, high = _last_sync_index_until(chain, at - 1), _first_sync_index_from(chain, at + 1)
    low_to, high_to = _last_sync_index_until(chain, to - 1), _first_sync_index_from(chain, to + 1)
    joined = low_to < high
    if joined:
        high = max(high, high_to)
    with_roles = draw_integer_below(stream, 3) > 0 and not _is_spare(chain, one)
    cost = operations_cost_between_syncs(chain, chain.visits, low, high)
    if not joined:
        cost += operations_cost_between_syncs(chain, chain.visits, low_to, high_to)
    _swap_nodes(chain, one, other, with_roles)
    now = operations_cost_between_syncs(chain, chain.visits, low, high)
    if not joined:
        now += operations_cost_between_syncs(chain, chain.visits, low_to, high_to)
    if not now - cost <= allowed_cost_increase:
        _swap_nodes(chain, one, other, with_roles)
        return REJECTED
    return now - cost


@compiled_inner
def _write_range_to_spare(chain, first, last, begin):
    """Write first .. last (either direction) to the spare buffer from `begin`; return its end."""
    step = 1 if last >= first else -1
    for at in range(first, last + step, step):
        chain.spare[begin] = chain.visits[at]
        begin += 1
    return begin


@compiled_inner
def try_random_reversal_of_visits(chain, stream, allowed_cost_increase):
    """Reverse part of the chain (2-opt), joining near nodes; see `try_random_move_of_visits`."""
    end = len(chain.visits) - 1
    at = draw_integer_below(stream, end + 1)
    to = chain.position[_draw_near_node(chain, chain.visits[at], stream)]
    first, last = (at + 1, to) if to > at else (to, at - 1)
    if first < 1 or last > end - 1 or first >= last:
        return REJECTED
    low, high = _last_sync_index_until(chain, first - 1), _first_sync_index_from(chain, first)
    low_to, high_to = _last_sync_index_until(chain, last), _first_sync_index_from(chain, last + 1)
    joined = high > low_to
    cost = operations_cost_between_syncs(chain, chain.visits, low, high_to if joined else high)
    if not joined:
        cost += operations_cost_between_syncs(chain, chain.visits, low_to, high_to)
    drawn = draw_integer_below(stream, 8)
    seam = first - 1 if drawn == 0 else first if drawn == 1 else last if drawn == 2 else last + 1
    node = chain.visits[seam]
    role = chain.role[node]
    if drawn < 4:
        chain.role[node] = SYNC
    stop = _write_range_to_spare(chain, low, first - 1, 0)
    if joined:
        stop = _write_range_to_spare(chain, last, first, stop)
        stop = _write_range_to_spare(chain, last + 1, high_to, stop)
        now = operations_cost_between_syncs(chain, chain.spare, 0, stop - 1)
    else:
        stop = _write_range_to_spare(chain, last, low_to, stop)
        now = operations_cost_between_syncs(chain, chain.spare, 0, stop - 1)
        if now - cost <= allowed_cost_increase:
            stop = _write_range_to_spare(chain, high, first, 0)
            stop = _write_range_to_spare(chain, last + 1, high_to, stop)
            now += operations_cost_between_syncs(chain, chain.spare, 0, stop - 1)
    if not now - cost <= allowed_cost_increase:
        chain.role[node] = role
        return REJECTED
    _reverse_positions(chain, first, last)
    return now - cost


@compiled_inner
def _merge_roles_and_count_flown(chain, first, last, kept_flown_number, merged_role):
    """Keep FLOWN visit `kept_flown_number`, set others to `merged_role`; return the FLOWN count."""
    flown = 0
    for at in range(first, last + 1):
        node = chain.visits[at]
        node_role = chain.role[node]
        if (node_role == FLOWN and flown != kept_flown_number) or node_role in (SYNC, TRUCK_ONLY):
            chain.role[node] = merged_role
        flown += node_role == FLOWN
    return flown


@compiled_inner
def try_random_merge_of_visits(chain, stream, allowed_cost_increase):
    """Assign two to six consecutive visits to the truck alone or to both; see
    `try_random_move_of_visits`.
    """
    end = len(chain.visits) - 1
    first = 1 + draw_integer_below(stream, end - 1)
    last = min(first + 1 + draw_integer_below(stream, 5), end - 1)
    low, high = _last_sync_index_until(chain, first - 1), _first_sync_index_from(chain, last + 1)
    cost = operations_cost_between_syncs(chain, chain.visits, low, high)
    for at in range(first, last + 1):
        chain.spare[at] = chain.role[chain.visits[at]]
    flown = _merge_roles_and_count_flown(
        chain,
        first,
        last,
        draw_integer_below(stream, 2),
        TRUCK_ONLY if draw_integer_below(stream, 3) else SYNC,
    )
    node = chain.visits[first + draw_integer_below(stream, last - first + 1)]
    if flown == 0 and not _is_spare(chain, node):
        chain.role[node] = FLOWN
    now = operations_cost_between_syncs(chain, chain.visits, low, high)
    if not now - cost <= allowed_cost_increase:
        for at in range(first, last + 1):
            chain.role[chain.visits[at]] = chain.spare[at]
        return REJECTED
    return now - cost


@compiled_inner
def try_random_move(chain, stream, allowed_cost_increase):
    """Apply a random move, by fixed probabilities; see `try_random_move_of_visits`."""
    drawn = draw_uniform(stream)
    if drawn < 0.55:
        return try_random_move_of_visits(chain, stream, allowed_cost_increase)
    if drawn < 0.75:
        return try_random_swap_of_visits(chain, stream, allowed_cost_increase)
    if drawn < 0.85:
        return try_random_merge_of_visits(chain, stream, allowed_cost_increase)
    return try_random_reversal_of_visits(chain, stream, allowed_cost_increase)
