"""Which sorties may be in the air at once, inside the compiled search (safety rule 7).

The rule itself is `deconfliction.separation`, and every plan passes it before it counts. This is
the same rule on what a search can work out a million times a second: the level ground of a sortie
is the hull of its pads, its customer and the first bends around obstacles, its columns are the
first three, and its pads are those of the first ring that lie best on its way, of those that are
free.
"""

import math

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.tables import (
    CORNERS,
    CUSTOMER_E,
    CUSTOMER_N,
    EAST,
    FLY,
    HOME,
    HOME_E,
    HOME_N,
    HOVER_LEFT,
    KIND,
    LAUNCH,
    LAUNCHED,
    LAYER,
    LAYER_HOVER_S,
    LAYER_S,
    LAYERS,
    LEVEL,
    LOG,
    LOWEST,
    MEET,
    NORTH,
    PAD,
    PAD_E,
    PAD_N,
    PENDING,
)

COLUMNS = 3
"""The first corners of a sortie's ground: it climbs and descends there."""
LINE_M2 = 1e-6
"""A triangle of less is a line."""
NEXT_RING = 30
"""The number of any pad beyond the first ring."""
FLEETS_BACK = 6
"""How far back launches are checked for who is still in the air, in fleets."""


@compiled
def _lay_pad(air, whole, times_s, customer, node, free, row, number_row):
    """Give a sortie the pad of a stop that lies best on its way, of those that are free; where none
    is, one of the next ring.
    """
    north, east = air.at[NORTH, node], air.at[EAST, node]
    turn = math.atan2(air.at[EAST, customer] - east, air.at[NORTH, customer] - north)
    step = 2.0 * math.pi / air.pads
    nearest = math.floor(turn / step + 0.5)
    side = 1 if turn > nearest * step else -1
    at, away_m, pad = turn, air.pads_m + air.rings_m, NEXT_RING
    for by in range(air.pads):
        off = side * ((by + 1) // 2) if by % 2 == 1 else -side * ((by + 1) // 2)
        if (free >> ((nearest + off) % air.pads)) & 1:
            at, away_m, pad = (nearest + off) * step, air.pads_m, (nearest + off) % air.pads
            break
    times_s[row, customer] = north + away_m * math.cos(at)
    times_s[row + 1, customer] = east + away_m * math.sin(at)
    whole[number_row, customer] = pad


@compiled
def lay_ground(air, plan, whole, times_s, customer, aboard, logged):
    """Note the positions of a sortie's pads and its customer, launched now by one of the drones
    aboard. A drone keeps its pad at a stop, and no other gets it.
    """
    launch, meet = plan[LAUNCH, customer], plan[MEET, customer]
    taken, home_taken, again = 0, 0, 0
    for back in range(logged - 1, max(-1, logged - 1 - FLEETS_BACK * air.fleet), -1):
        other = whole[LOG, back]
        pad, home = 1 << whole[PAD, other], 1 << whole[HOME, other]
        if plan[MEET, other] == launch:
            if whole[PENDING, other] == 0 and not taken & home:
                again |= home
            taken |= home
        if plan[LAUNCH, other] == launch:
            taken |= pad
        if plan[LAUNCH, other] == meet:
            home_taken |= pad
        if plan[MEET, other] == meet:
            home_taken |= home
    every = (1 << air.pads) - 1
    again &= every
    waiting = 0
    for pad in range(air.pads):
        waiting += (again >> pad) & 1
    free = again if waiting >= aboard else again | (every & ~taken)
    times_s[CUSTOMER_N, customer] = air.at[NORTH, customer]
    times_s[CUSTOMER_E, customer] = air.at[EAST, customer]
    _lay_pad(air, whole, times_s, customer, launch, free, PAD_N, PAD)
    if launch == meet:
        times_s[HOME_N, customer] = times_s[PAD_N, customer]
        times_s[HOME_E, customer] = times_s[PAD_E, customer]
        whole[HOME, customer] = whole[PAD, customer]
    else:
        _lay_pad(air, whole, times_s, customer, meet, every & ~home_taken, HOME_N, HOME)
    whole[CORNERS, customer] = COLUMNS
    if air.bends.shape[0] > 0:
        _lay_bends(air, whole, times_s, customer, launch, customer)
        _lay_bends(air, whole, times_s, customer, customer, meet)


@compiled
def _lay_bends(air, whole, times_s, customer, start, end):
    """Add the corners of the way from node to node to the ground of a sortie."""
    for number in range(air.bends.shape[2]):
        corner = air.bends[start, end, number]
        if corner < 0:
            return
        row = PAD_N + 2 * whole[CORNERS, customer]
        times_s[row, customer] = air.corners_ne_m[corner, 0]
        times_s[row + 1, customer] = air.corners_ne_m[corner, 1]
        whole[CORNERS, customer] += 1


@compiled
def _to_segment_m2(pn, pe, an, ae, bn, be):
    """Squared distance of a point from a segment."""
    dn, de = bn - an, be - ae
    length2 = dn * dn + de * de
    along = 0.0
    if length2 > 0.0:
        along = min(1.0, max(0.0, ((pn - an) * dn + (pe - ae) * de) / length2))
    n, e = an + along * dn - pn, ae + along * de - pe
    return n * n + e * e


@compiled
def _side(an, ae, bn, be, pn, pe):
    return (bn - an) * (pe - ae) - (be - ae) * (pn - an)


@compiled
def near_ground(g, one, corners, pn, pe, apart_m2):
    """Whether this point is nearer than that to the hull of a sortie's corners.

    Every edge of the hull joins two corners, and what is within it is within a triangle of three.
    """
    for first in range(1, corners):
        an, ae = g[PAD_N + 2 * first, one], g[PAD_E + 2 * first, one]
        for second in range(first):
            bn, be = g[PAD_N + 2 * second, one], g[PAD_E + 2 * second, one]
            if _to_segment_m2(pn, pe, an, ae, bn, be) < apart_m2:
                return True
    for first in range(2, corners):
        an, ae = g[PAD_N + 2 * first, one], g[PAD_E + 2 * first, one]
        for second in range(1, first):
            bn, be = g[PAD_N + 2 * second, one], g[PAD_E + 2 * second, one]
            for third in range(second):
                cn, ce = g[PAD_N + 2 * third, one], g[PAD_E + 2 * third, one]
                if _within(an, ae, bn, be, cn, ce, pn, pe):
                    return True
    return False


@compiled
def _within(an, ae, bn, be, cn, ce, pn, pe):
    """Whether a triangle that is no line has this point within."""
    first = _side(an, ae, bn, be, pn, pe)
    second = _side(bn, be, cn, ce, pn, pe)
    third = _side(cn, ce, an, ae, pn, pe)
    if abs(first + second + third) < LINE_M2:
        return False
    return (first > 0.0) == (second > 0.0) and (second > 0.0) == (third > 0.0)


@compiled
def _cross(an, ae, bn, be, cn, ce, dn, de):
    """Do two segments cross?"""
    if (_side(an, ae, bn, be, cn, ce) > 0.0) == (_side(an, ae, bn, be, dn, de) > 0.0):
        return False
    return (_side(cn, ce, dn, de, an, ae) > 0.0) != (_side(cn, ce, dn, de, bn, be) > 0.0)


@compiled
def _edges_cross(g, one, corners, other, others):
    """Whether any lines between corners of the two cross."""
    for first in range(1, corners):
        an, ae = g[PAD_N + 2 * first, one], g[PAD_E + 2 * first, one]
        for second in range(first):
            bn, be = g[PAD_N + 2 * second, one], g[PAD_E + 2 * second, one]
            for third in range(1, others):
                cn, ce = g[PAD_N + 2 * third, other], g[PAD_E + 2 * third, other]
                for fourth in range(third):
                    dn, de = g[PAD_N + 2 * fourth, other], g[PAD_E + 2 * fourth, other]
                    if _cross(an, ae, bn, be, cn, ce, dn, de):
                        return True
    return False


@compiled
def _boxes_apart(g, one, corners, other, others, apart_m):
    """A quick test that most distant pairs pass."""
    for axis in range(PAD_N, PAD_N + 2):
        low, high = g[axis, one], g[axis, one]
        for corner in range(1, corners):
            low = min(low, g[axis + 2 * corner, one])
            high = max(high, g[axis + 2 * corner, one])
        least, most = g[axis, other], g[axis, other]
        for corner in range(1, others):
            least = min(least, g[axis + 2 * corner, other])
            most = max(most, g[axis + 2 * corner, other])
        if high + apart_m < least or low - apart_m > most:
            return True
    return False


@compiled
def _any_near(apart_m2, g, one, corners, other, others):
    """Whether any of the other's first corners is near the hull of this one."""
    for corner in range(others):
        north, east = g[PAD_N + 2 * corner, other], g[PAD_E + 2 * corner, other]
        if near_ground(g, one, corners, north, east, apart_m2):
            return True
    return False


@compiled
def _columns_near(apart_m, g, one, other):
    """Whether the two climb or descend too close to each other."""
    apart_m2 = apart_m * apart_m
    for mine in range(PAD_N, HOME_E, 2):
        for theirs in range(PAD_N, HOME_E, 2):
            north = g[mine, one] - g[theirs, other]
            east = g[mine + 1, one] - g[theirs + 1, other]
            if north * north + east * east < apart_m2:
                return True
    return False


@compiled
def closed_layers(apart_m, whole, g, one, other, layer):
    """Bits of the layers that `one` cannot have while `other` is in this one."""
    corners, others = whole[CORNERS, one], whole[CORNERS, other]
    if _boxes_apart(g, one, corners, other, others, apart_m):
        return 0
    apart_m2 = apart_m * apart_m
    under_one = _any_near(apart_m2, g, one, corners, other, COLUMNS)
    under_other = _any_near(apart_m2, g, other, others, one, COLUMNS)
    if not (
        under_one
        or under_other
        or _edges_cross(g, one, corners, other, others)
        or (others > COLUMNS and _any_near(apart_m2, g, one, corners, other, others))
        or (corners > COLUMNS and _any_near(apart_m2, g, other, others, one, corners))
    ):
        return 0
    if _columns_near(apart_m, g, one, other):
        return ~0
    here = 1 << layer
    closed = here
    if under_one:
        closed |= here - 1
    if under_other:
        closed |= ~(here - 1)
    return closed


@compiled
def layer_for(air, plan, whole, times_s, customer, launched_s, aboard, logged):
    """The lowest free layer for a launch that ends then, and when to ask again if there is none:
    (layer or -1, time at which the first drone that blocks it has landed).
    """
    off_s = launched_s + air.ready_s
    launch, meet, kind = plan[LAUNCH, customer], plan[MEET, customer], plan[KIND, customer]
    lay_ground(air, plan, whole, times_s, customer, aboard, logged)
    low = int(max(air.at[LOWEST, launch], air.at[LOWEST, customer], air.at[LOWEST, meet]))
    top = int(min(air.at[LAYERS, launch], air.at[LAYERS, customer], air.at[LAYERS, meet]))
    closed, in_air, free_s = 0, 0, math.inf
    for back in range(logged - 1, max(-1, logged - 1 - FLEETS_BACK * air.fleet), -1):
        other = whole[LOG, back]
        clear_s = times_s[LAUNCHED, other] + times_s[FLY, other] + air.slack_s
        if clear_s <= off_s:
            continue
        bits = closed_layers(air.apart_m, whole, times_s, customer, other, whole[LAYER, other])
        if bits != 0:
            closed |= bits
            free_s = min(free_s, clear_s)
        in_air += 1
        if in_air == air.fleet:
            break
    for layer in range(low, top):
        if not (closed >> layer) & 1:
            above = layer - air.of_priced
            if above * air.of_layer[LAYER_HOVER_S, kind] > times_s[HOVER_LEFT, customer]:
                break
            times_s[FLY, customer] = times_s[LEVEL, customer] + above * air.of_layer[LAYER_S, kind]
            return layer, 0.0
    return -1, free_s - air.ready_s
