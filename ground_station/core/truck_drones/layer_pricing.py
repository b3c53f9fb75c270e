"""Which sorties may be in the air at once, inside the compiled search (safety rule 7).

The rule itself is `deconfliction.separation`, and every plan passes it before it counts. This is an
approximation that a search can evaluate a million times a second: the level ground of a sortie is
the triangle of its pads and its customer, each pad lies where its drone leaves for its customer,
and routes around obstacles are left out.
"""

import math

from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.tables import (
    CUSTOMER_E,
    CUSTOMER_N,
    EAST,
    FLY,
    HOME_E,
    HOME_N,
    LAUNCH,
    LAUNCHED,
    LAYER,
    LAYERS,
    LOG,
    LOWEST,
    MEET,
    NORTH,
    PAD_E,
    PAD_N,
)

FLEETS_BACK = 6
"""How far back launches are checked for who is still in the air, in fleets."""


@compiled
def lay_ground(air, plan, times_s, customer):
    """Note the positions of a sortie's pads and its customer."""
    north, east = air.at[NORTH, customer], air.at[EAST, customer]
    times_s[CUSTOMER_N, customer], times_s[CUSTOMER_E, customer] = north, east
    for row, node in ((PAD_N, plan[LAUNCH, customer]), (HOME_N, plan[MEET, customer])):
        at_n, at_e = air.at[NORTH, node], air.at[EAST, node]
        away_m = math.hypot(north - at_n, east - at_e)
        share = air.pads_m / away_m if away_m > air.pads_m else 0.0
        times_s[row, customer] = at_n + share * (north - at_n)
        times_s[row + 1, customer] = at_e + share * (east - at_e)


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
def _stands_under(apart_m, plan, g, above, below):
    """Whether a column of `below` lies under the ways of `above`. Pads of one stop are apart
    anyway.
    """
    apart_m2 = apart_m * apart_m
    if near_ground(g, above, g[CUSTOMER_N, below], g[CUSTOMER_E, below], apart_m2):
        return True
    launch, meet = plan[LAUNCH, above], plan[MEET, above]
    for row, node in ((PAD_N, plan[LAUNCH, below]), (HOME_N, plan[MEET, below])):
        elsewhere = node != launch and node != meet
        if elsewhere and near_ground(g, above, g[row, below], g[row + 1, below], apart_m2):
            return True
    return False


@compiled
def _near_one_another(apart_m, g, one, other):
    """Whether the triangles come close (corners near the other triangle, or crossing edges)."""
    apart_m2 = apart_m * apart_m
    for corner in range(PAD_N, HOME_E, 2):
        if near_ground(g, one, g[corner, other], g[corner + 1, other], apart_m2):
            return True
        if near_ground(g, other, g[corner, one], g[corner + 1, one], apart_m2):
            return True
    return _edges_cross(g, one, other)


@compiled
def closed_layers(apart_m, plan, g, one, other, layer):
    """Bits of the layers that `one` cannot have while `other` is in this one."""
    if _boxes_apart(g, one, other, apart_m):
        return 0
    if not _near_one_another(apart_m, g, one, other):
        return 0
    here = 1 << layer
    closed = here
    if _stands_under(apart_m, plan, g, one, other):
        closed |= here - 1
    if _stands_under(apart_m, plan, g, other, one):
        closed |= ~(here - 1)
    return closed


@compiled
def layer_for(air, plan, whole, times_s, customer, launched_s, logged):
    """The lowest free layer for a launch that ends then, and when to ask again if there is none:
    (layer or -1, time at which the first drone that blocks it has landed).
    """
    off_s = launched_s + air.ready_s
    launch, meet = plan[LAUNCH, customer], plan[MEET, customer]
    low = int(max(air.at[LOWEST, launch], air.at[LOWEST, customer], air.at[LOWEST, meet]))
    top = int(min(air.at[LAYERS, launch], air.at[LAYERS, customer], air.at[LAYERS, meet]))
    closed, in_air, free_s = 0, 0, math.inf
    for back in range(logged - 1, max(-1, logged - 1 - FLEETS_BACK * air.fleet), -1):
        other = whole[LOG, back]
        clear_s = times_s[LAUNCHED, other] + times_s[FLY, other] + air.slack_s
        if clear_s <= off_s:
            continue
        bits = closed_layers(air.apart_m, plan, times_s, customer, other, whole[LAYER, other])
        if bits != 0:
            closed |= bits
            free_s = min(free_s, clear_s)
        in_air += 1
        if in_air == air.fleet:
            break
    for layer in range(low, top):
        if not (closed >> layer) & 1:
            return layer, 0.0
    return -1, free_s - air.ready_s
