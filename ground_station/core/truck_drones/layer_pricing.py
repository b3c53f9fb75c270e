"""Which sorties may be in the air at once, inside the compiled search (safety rule 7).

The rule itself is `deconfliction.separation`, and every plan passes it before it counts. This is
the same rule on what a search can work out a million times a second: the level ground of a sortie
is the triangle of its pads and its customer, its columns are these three, and its pads are those of
the first ring that lie best on its way, of those that nobody in the air has. Routes around obstacles
are left out.
"""

import math

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.tables import (
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
def near_ground(g, one, pn, pe, apart_m2):
    """Whether this point is nearer than that to the triangle of a sortie."""
    an, ae = g[PAD_N, one], g[PAD_E, one]
    bn, be = g[CUSTOMER_N, one], g[CUSTOMER_E, one]
    cn, ce = g[HOME_N, one], g[HOME_E, one]
    if _to_segment_m2(pn, pe, an, ae, bn, be) < apart_m2:
        return True
    if an == cn and ae == ce:
        return False
    if _to_segment_m2(pn, pe, bn, be, cn, ce) < apart_m2:
        return True
    if _to_segment_m2(pn, pe, cn, ce, an, ae) < apart_m2:
        return True
    first = _side(an, ae, bn, be, pn, pe)
    second = _side(bn, be, cn, ce, pn, pe)
    third = _side(cn, ce, an, ae, pn, pe)
    return (first > 0.0) == (second > 0.0) and (second > 0.0) == (third > 0.0)


@compiled
def _cross(an, ae, bn, be, cn, ce, dn, de):
    """Do two segments cross?"""
    if (_side(an, ae, bn, be, cn, ce) > 0.0) == (_side(an, ae, bn, be, dn, de) > 0.0):
        return False
    return (_side(cn, ce, dn, de, an, ae) > 0.0) != (_side(cn, ce, dn, de, bn, be) > 0.0)


@compiled
def _edges_cross(g, one, other):
    """Whether any edges of two triangles cross."""
    for first in range(3):
        an, ae = g[PAD_N + 2 * first, one], g[PAD_E + 2 * first, one]
        to = PAD_N + 2 * ((first + 1) % 3)
        bn, be = g[to, one], g[to + 1, one]
        for second in range(3):
            cn, ce = g[PAD_N + 2 * second, other], g[PAD_E + 2 * second, other]
            end = PAD_N + 2 * ((second + 1) % 3)
            if _cross(an, ae, bn, be, cn, ce, g[end, other], g[end + 1, other]):
                return True
    return False


@compiled
def _boxes_apart(g, one, other, apart_m):
    """A quick test that most distant pairs pass."""
    for axis in range(2):
        p, q, r = PAD_N + axis, CUSTOMER_N + axis, HOME_N + axis
        low = min(g[p, one], g[q, one], g[r, one]) - apart_m
        high = max(g[p, one], g[q, one], g[r, one]) + apart_m
        if high < min(g[p, other], g[q, other], g[r, other]):
            return True
        if low > max(g[p, other], g[q, other], g[r, other]):
            return True
    return False


@compiled
def _corner_near(apart_m, g, one, other):
    """Whether a corner of the other's triangle is near the triangle of this one."""
    apart_m2 = apart_m * apart_m
    for corner in range(PAD_N, HOME_E, 2):
        if near_ground(g, one, g[corner, other], g[corner + 1, other], apart_m2):
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
def closed_layers(apart_m, g, one, other, layer):
    """Bits of the layers that `one` cannot have while `other` is in this one."""
    if _boxes_apart(g, one, other, apart_m):
        return 0
    under_one = _corner_near(apart_m, g, one, other)
    under_other = _corner_near(apart_m, g, other, one)
    if not (under_one or under_other or _edges_cross(g, one, other)):
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
        bits = closed_layers(air.apart_m, times_s, customer, other, whole[LAYER, other])
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
