"""A plan of one truck and one drone as a chain of operations, and random changes of it.

The chain is a sequence of visits from the depot to its copy. Each visit has a role. Truck and drone
are together at a SYNC visit. Between two of them the truck drives through the ALONE visits and the
drone may serve one FLOWN visit, wherever in between it stands. A LOOP visit is flown from the
nearer of the two SYNC visits around it while the truck waits. An OFF visit is not made; spare
nodes stand for a second visit of some other node, and most of them are OFF. The cost of an
operation is the longer of the truck's and the drone's, so a change costs only the operations that
it touches.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.random_stream import below, uniform

SYNC, ALONE, FLOWN, LOOP, OFF = range(5)
REFUSED = np.inf
"""The change of cost of a move that was not made."""


class Chain(NamedTuple):
    """The problem and a plan under search. The last visit is the copy of the depot where the plan
    ends; nodes above it are spare.
    """

    drive: NDArray[np.float64]
    """Cost of the truck from node to node, symmetric."""
    fly: NDArray[np.float64]
    """Cost of the drone from node to node, symmetric."""
    near: NDArray[np.int32]
    """By node, the nearest others, nearest first."""
    visits: NDArray[np.int32]
    """Nodes in their order."""
    place: NDArray[np.int32]
    """Where each node stands among the visits."""
    role: NDArray[np.int8]
    """By node."""
    same_as: NDArray[np.int32]
    """By node, the node whose place it has: another one for spare nodes only."""
    spare: NDArray[np.int32]
    """Room for two stretches of visits."""


@compiled
def _loops_cost(fly, role, visits, first, last):
    """Cost of the LOOP visits between two SYNC visits."""
    cost = 0.0
    one, other = visits[first], visits[last]
    for at in range(first + 1, last):
        node = visits[at]
        if role[node] == LOOP:
            cost += 2.0 * min(fly[one, node], fly[other, node])
    return cost


@compiled
def stretch_cost(drive, fly, role, visits, first, last):
    """Cost of the operations between two SYNC places; inf where one of them flies twice."""
    cost, truck, loops = 0.0, 0.0, False
    start_at, flown = first, -1
    start = stop = visits[first]
    for at in range(first + 1, last + 1):
        node = visits[at]
        what = role[node]
        if what == SYNC:
            truck += drive[stop, node]
            if flown >= 0:
                drone = fly[start, flown] + fly[flown, node]
                cost += max(truck, drone)
            else:
                cost += truck
            if loops:
                cost += _loops_cost(fly, role, visits, start_at, at)
            start_at, flown, truck, loops = at, -1, 0.0, False
            start = stop = node
        elif what == ALONE:
            truck += drive[stop, node]
            stop = node
        elif what == FLOWN:
            if flown >= 0:
                return np.inf
            flown = node
        elif what == LOOP:
            loops = True
    return cost


@compiled
def _sync_before(c, at):
    """The last SYNC place at or before this one."""
    at = max(at, 0)
    while c.role[c.visits[at]] != SYNC:
        at -= 1
    return at


@compiled
def _sync_after(c, at):
    """The first SYNC place at or after this one."""
    at = min(at, len(c.visits) - 1)
    while c.role[c.visits[at]] != SYNC:
        at += 1
    return at


@compiled
def _near_node(c, node, stream):
    """A node near this one; nearer ones are more likely."""
    drawn = uniform(stream)
    return c.near[node, int(drawn * drawn * c.near.shape[1])]


@compiled
def _shift(c, first, last, to, back):
    """Move the places first .. last right behind `to`, outside of them; `back`: reversed."""
    count = last - first + 1
    visits, place, kept = c.visits, c.place, c.spare
    for at in range(count):
        kept[at] = visits[last - at] if back else visits[first + at]
    if to > last:
        for at in range(last + 1, to + 1):
            visits[at - count] = visits[at]
            place[visits[at]] = at - count
        begin = to - count + 1
    else:
        for at in range(first - 1, to, -1):
            visits[at + count] = visits[at]
            place[visits[at]] = at + count
        begin = to + 1
    for at in range(count):
        visits[begin + at] = kept[at]
        place[kept[at]] = begin + at


@compiled
def _copy_moved(c, low, high, first, last, to, back, begin):
    """Write low .. high into the spare room from `begin` as the move leaves it; the end of it."""
    for at in range(low, high + 1):
        if at < first or at > last:
            c.spare[begin] = c.visits[at]
            begin += 1
        if at == to:
            for step in range(last - first + 1):
                c.spare[begin] = c.visits[last - step] if back else c.visits[first + step]
                begin += 1
    return begin


@compiled
def _is_spare(c, node):
    return node > c.visits[len(c.visits) - 1]


@compiled
def _place_spare(c, node, stream):
    """Let a spare node that is OFF stand for a random node."""
    same = c.same_as[c.visits[below(stream, len(c.visits))]]
    c.same_as[node] = same
    for other in range(len(c.drive)):
        c.drive[node, other] = c.drive[other, node] = c.drive[same, other]
        c.fly[node, other] = c.fly[other, node] = c.fly[same, other]
    c.drive[node, node] = c.fly[node, node] = 0.0
    for column in range(c.near.shape[1]):
        c.near[node, column] = c.near[same, column]


@compiled
def _change_role(c, node, stream):
    """Another role for a node; the roles of customers with the truck are drawn more often."""
    drawn = uniform(stream)
    if _is_spare(c, node):
        c.role[node] = SYNC if drawn < 0.5 else OFF
    elif drawn < 0.35:
        c.role[node] = SYNC
    elif drawn < 0.65:
        c.role[node] = ALONE
    elif drawn < 0.97:
        c.role[node] = FLOWN
    else:
        c.role[node] = LOOP


@compiled
def move_visits(c, stream, allowed):
    """Move one to three visits next to a near one, with new roles for those at the seams.

    The change of cost, REFUSED where it is above `allowed`.
    """
    end = len(c.visits) - 1
    count = 1 if below(stream, 3) else min(1 + below(stream, 3), end - 1)
    first = 1 + below(stream, end - count)
    last = first + count - 1
    node = c.visits[first]
    if c.role[node] == OFF and count == 1:
        _place_spare(c, node, stream)
    to = first - 1
    if below(stream, 4):
        to = c.place[_near_node(c, node, stream)] - below(stream, 2)
        to = max(0, min(to, end - 1))
        if first - 1 <= to <= last:
            to = first - 1
    back = count > 1 and below(stream, 2) == 0
    changed = below(stream, 3)
    margin = 1 if changed else 0
    low, high = _sync_before(c, first - 1 - margin), _sync_after(c, last + 1 + margin)
    low_to, high_to, joined = low, high, True
    if to != first - 1:
        low_to, high_to = _sync_before(c, to - margin), _sync_after(c, to + 1 + margin)
        joined = low < high_to and low_to < high
        if joined:
            low, high = min(low, low_to), max(high, high_to)
    cost = stretch_cost(c.drive, c.fly, c.role, c.visits, low, high)
    if not joined:
        cost += stretch_cost(c.drive, c.fly, c.role, c.visits, low_to, high_to)

    role = c.role[node]
    if count == 1 and below(stream, 4):
        _change_role(c, node, stream)
    others = (node, node)
    roles = (role, role)
    for step in range(changed):
        drawn = below(stream, 4)
        at = first - 1 if drawn == 0 else last + 1 if drawn == 1 else to if drawn == 2 else to + 1
        other = c.visits[max(0, min(at, end))]
        if other == 0 or other == c.visits[end]:
            continue
        if step == 0:
            others, roles = (other, others[1]), (c.role[other], roles[1])
        else:
            others, roles = (others[0], other), (roles[0], c.role[other])
        _change_role(c, other, stream)

    if joined:
        stop = _copy_moved(c, low, high, first, last, to, back, 0)
        now = stretch_cost(c.drive, c.fly, c.role, c.spare, 0, stop - 1)
    else:
        stop = _copy_moved(c, low, high, first, last, -1, back, 0)
        now = stretch_cost(c.drive, c.fly, c.role, c.spare, 0, stop - 1)
        if now - cost <= allowed:
            stop = _copy_moved(c, low_to, high_to, first, last, to, back, 0)
            now += stretch_cost(c.drive, c.fly, c.role, c.spare, 0, stop - 1)
    if not now - cost <= allowed:
        c.role[others[1]] = roles[1]
        c.role[others[0]] = roles[0]
        c.role[node] = role
        return REFUSED
    if to != first - 1:
        _shift(c, first, last, to, back)
    elif back:
        _turn(c, first, last)
    return now - cost


@compiled
def _turn(c, first, last):
    """Reverse these places."""
    while first < last:
        one, other = c.visits[first], c.visits[last]
        c.visits[first], c.visits[last] = other, one
        c.place[other], c.place[one] = first, last
        first += 1
        last -= 1


@compiled
def _exchange(c, one, other, with_roles):
    """Exchange the places of two nodes, or places and roles."""
    at, to = c.place[one], c.place[other]
    c.visits[at], c.visits[to] = other, one
    c.place[one], c.place[other] = to, at
    if with_roles:
        c.role[one], c.role[other] = c.role[other], c.role[one]


@compiled
def exchange_visits(c, stream, allowed):
    """Exchange two near visits; see `move_visits`."""
    end = len(c.visits) - 1
    one = c.visits[1 + below(stream, end - 1)]
    other = _near_node(c, one, stream)
    at, to = c.place[one], c.place[other]
    if to == 0 or to == end:
        return REFUSED
    at, to = min(at, to), max(at, to)
    low, high = _sync_before(c, at - 1), _sync_after(c, at + 1)
    low_to, high_to = _sync_before(c, to - 1), _sync_after(c, to + 1)
    joined = low_to < high
    if joined:
        high = max(high, high_to)
    with_roles = below(stream, 3) > 0 and not _is_spare(c, one)
    cost = stretch_cost(c.drive, c.fly, c.role, c.visits, low, high)
    if not joined:
        cost += stretch_cost(c.drive, c.fly, c.role, c.visits, low_to, high_to)
    _exchange(c, one, other, with_roles)
    now = stretch_cost(c.drive, c.fly, c.role, c.visits, low, high)
    if not joined:
        now += stretch_cost(c.drive, c.fly, c.role, c.visits, low_to, high_to)
    if not now - cost <= allowed:
        _exchange(c, one, other, with_roles)
        return REFUSED
    return now - cost


@compiled
def _copy(c, first, last, begin):
    """Write first .. last, also downwards, into the spare room from `begin`; the end of it."""
    step = 1 if last >= first else -1
    for at in range(first, last + step, step):
        c.spare[begin] = c.visits[at]
        begin += 1
    return begin


@compiled
def reverse_visits(c, stream, allowed):
    """Reverse a part of the chain (2-opt), so that two near nodes meet; see `move_visits`."""
    end = len(c.visits) - 1
    at = below(stream, end + 1)
    to = c.place[_near_node(c, c.visits[at], stream)]
    first, last = (at + 1, to) if to > at else (to, at - 1)
    if first < 1 or last > end - 1 or first >= last:
        return REFUSED
    low, high = _sync_before(c, first - 1), _sync_after(c, first)
    low_to, high_to = _sync_before(c, last), _sync_after(c, last + 1)
    joined = high > low_to
    cost = stretch_cost(c.drive, c.fly, c.role, c.visits, low, high_to if joined else high)
    if not joined:
        cost += stretch_cost(c.drive, c.fly, c.role, c.visits, low_to, high_to)
    drawn = below(stream, 8)
    seam = first - 1 if drawn == 0 else first if drawn == 1 else last if drawn == 2 else last + 1
    node = c.visits[seam]
    role = c.role[node]
    if drawn < 4:
        c.role[node] = SYNC
    stop = _copy(c, low, first - 1, 0)
    if joined:
        stop = _copy(c, last, first, stop)
        stop = _copy(c, last + 1, high_to, stop)
        now = stretch_cost(c.drive, c.fly, c.role, c.spare, 0, stop - 1)
    else:
        stop = _copy(c, last, low_to, stop)
        now = stretch_cost(c.drive, c.fly, c.role, c.spare, 0, stop - 1)
        if now - cost <= allowed:
            stop = _copy(c, high, first, 0)
            stop = _copy(c, last + 1, high_to, stop)
            now += stretch_cost(c.drive, c.fly, c.role, c.spare, 0, stop - 1)
    if not now - cost <= allowed:
        c.role[node] = role
        return REFUSED
    _turn(c, first, last)
    return now - cost


@compiled
def _join(c, first, last, keep, role):
    """Roles of one operation: of those flown, keep the `keep`-th; the truck's get this role."""
    flown = 0
    for at in range(first, last + 1):
        node = c.visits[at]
        what = c.role[node]
        if (what == FLOWN and flown != keep) or what in (SYNC, ALONE):
            c.role[node] = role
        flown += what == FLOWN
    return flown


@compiled
def join_visits(c, stream, allowed):
    """Let the truck alone make two to six visits in a row, or both vehicles; see `move_visits`."""
    end = len(c.visits) - 1
    first = 1 + below(stream, end - 1)
    last = min(first + 1 + below(stream, 5), end - 1)
    low, high = _sync_before(c, first - 1), _sync_after(c, last + 1)
    cost = stretch_cost(c.drive, c.fly, c.role, c.visits, low, high)
    for at in range(first, last + 1):
        c.spare[at] = c.role[c.visits[at]]
    flown = _join(c, first, last, below(stream, 2), ALONE if below(stream, 3) else SYNC)
    node = c.visits[first + below(stream, last - first + 1)]
    if flown == 0 and not _is_spare(c, node):
        c.role[node] = FLOWN
    now = stretch_cost(c.drive, c.fly, c.role, c.visits, low, high)
    if not now - cost <= allowed:
        for at in range(first, last + 1):
            c.role[c.visits[at]] = c.spare[at]
        return REFUSED
    return now - cost


@compiled
def any_move(c, stream, allowed):
    """A random move, by fixed shares; see `move_visits`."""
    drawn = uniform(stream)
    if drawn < 0.55:
        return move_visits(c, stream, allowed)
    if drawn < 0.75:
        return exchange_visits(c, stream, allowed)
    if drawn < 0.85:
        return join_visits(c, stream, allowed)
    return reverse_visits(c, stream, allowed)
