"""Separation of simultaneous sorties in the compiled search (safety rule 7).

`deconfliction.separation` defines the rule, and each plan is checked by it before use. This is the
same rule on geometry that a search can evaluate a million times a second: the ground shape of a
sortie is the hull of its pads, its customer and the first bends around obstacles, its columns are
the first three, and its pads are the free pads of the first ring nearest to its route.
"""

import math

from ground_station.core.truck_drones.compiled import compiled_inner
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
    NORTH,
    PAD,
    PAD_E,
    PAD_N,
    PENDING,
    RENDEZVOUS,
)

COLUMNS = 3
"""The first corners of a sortie's ground shape, where it climbs and descends."""
LINE_M2 = 1e-6
"""A triangle of smaller area is a line."""
NEXT_RING = 30
"""Number of all pads outside the first ring."""
LOG_DEPTH_FLEETS = 6
"""Number of earlier launches checked for airborne sorties, in fleets."""


@compiled_inner
def _assign_pad(air, int_rows, times_s, customer, node, free_pad_bits, north_row, pad_row):
    """Assign a sortie the free pad of a stop nearest to its route; one of the next ring if no pad
    is free.
    """
    north, east = air.at[NORTH, node], air.at[EAST, node]
    turn = math.atan2(air.at[EAST, customer] - east, air.at[NORTH, customer] - north)
    step = 2.0 * math.pi / air.pads
    nearest = math.floor(turn / step + 0.5)
    side = 1 if turn > nearest * step else -1
    at, away_m, pad = turn, air.pads_m + air.rings_m, NEXT_RING
    for by in range(air.pads):
        off = side * ((by + 1) // 2) if by % 2 == 1 else -side * ((by + 1) // 2)
        if (free_pad_bits >> ((nearest + off) % air.pads)) & 1:
            at, away_m, pad = (nearest + off) * step, air.pads_m, (nearest + off) % air.pads
            break
    times_s[north_row, customer] = north + away_m * math.cos(at)
    times_s[north_row + 1, customer] = east + away_m * math.sin(at)
    int_rows[pad_row, customer] = pad


@compiled_inner
def store_ground_shape(air, plan, int_rows, times_s, customer, drones_available, launch_count):
    """Set the positions of the pads and the customer of a sortie, launched now by one of the drones
    on the truck. A drone keeps its pad at a stop; no other drone gets it.
    """
    launch, rendezvous = plan[LAUNCH, customer], plan[RENDEZVOUS, customer]
    occupied, home_occupied, reusable = 0, 0, 0
    for back in range(
        launch_count - 1, max(-1, launch_count - 1 - LOG_DEPTH_FLEETS * air.fleet), -1
    ):
        other = int_rows[LOG, back]
        pad, home = 1 << int_rows[PAD, other], 1 << int_rows[HOME, other]
        if plan[RENDEZVOUS, other] == launch:
            if int_rows[PENDING, other] == 0 and not occupied & home:
                reusable |= home
            occupied |= home
        if plan[LAUNCH, other] == launch:
            occupied |= pad
        if plan[LAUNCH, other] == rendezvous:
            home_occupied |= pad
        if plan[RENDEZVOUS, other] == rendezvous:
            home_occupied |= home
    all_pads = (1 << air.pads) - 1
    reusable &= all_pads
    waiting = 0
    for pad in range(air.pads):
        waiting += (reusable >> pad) & 1
    free = reusable if waiting >= drones_available else reusable | (all_pads & ~occupied)
    times_s[CUSTOMER_N, customer] = air.at[NORTH, customer]
    times_s[CUSTOMER_E, customer] = air.at[EAST, customer]
    _assign_pad(air, int_rows, times_s, customer, launch, free, PAD_N, PAD)
    if launch == rendezvous:
        times_s[HOME_N, customer] = times_s[PAD_N, customer]
        times_s[HOME_E, customer] = times_s[PAD_E, customer]
        int_rows[HOME, customer] = int_rows[PAD, customer]
    else:
        _assign_pad(
            air, int_rows, times_s, customer, rendezvous, all_pads & ~home_occupied, HOME_N, HOME
        )
    int_rows[CORNERS, customer] = COLUMNS
    if air.bends.shape[0] > 0:
        _append_route_corners(air, int_rows, times_s, customer, launch, customer)
        _append_route_corners(air, int_rows, times_s, customer, customer, rendezvous)


@compiled_inner
def _append_route_corners(air, int_rows, times_s, customer, start, end):
    """Add the corners of the route between two nodes to the ground shape of a sortie."""
    for number in range(air.bends.shape[2]):
        corner = air.bends[start, end, number]
        if corner < 0:
            return
        row = PAD_N + 2 * int_rows[CORNERS, customer]
        times_s[row, customer] = air.corners_ne_m[corner, 0]
        times_s[row + 1, customer] = air.corners_ne_m[corner, 1]
        int_rows[CORNERS, customer] += 1


@compiled_inner
def _corner_ne_m(geometry_rows, customer, number):
    row = PAD_N + 2 * number
    return geometry_rows[row, customer], geometry_rows[row + 1, customer]


@compiled_inner
def _squared_point_segment_distance_m2(pn, pe, an, ae, bn, be):
    """Return the squared distance of a point from a segment."""
    dn, de = bn - an, be - ae
    length2 = dn * dn + de * de
    fraction = 0.0
    if length2 > 0.0:
        fraction = min(1.0, max(0.0, ((pn - an) * dn + (pe - ae) * de) / length2))
    n, e = an + fraction * dn - pn, ae + fraction * de - pe
    return n * n + e * e


@compiled_inner
def _triangle_orientation_m2(an, ae, bn, be, pn, pe):
    return (bn - an) * (pe - ae) - (be - ae) * (pn - an)


@compiled_inner
def is_near_ground_shape(geometry_rows, customer, corner_count, pn, pe, separation_m2):
    """Return whether a point is within the separation of the hull of a sortie's corners.

    Each edge of the hull joins two corners; each inner point is within a triangle of three.
    """
    for first in range(1, corner_count):
        an, ae = _corner_ne_m(geometry_rows, customer, first)
        for second in range(first):
            bn, be = _corner_ne_m(geometry_rows, customer, second)
            if _squared_point_segment_distance_m2(pn, pe, an, ae, bn, be) < separation_m2:
                return True
    for first in range(2, corner_count):
        an, ae = _corner_ne_m(geometry_rows, customer, first)
        for second in range(1, first):
            bn, be = _corner_ne_m(geometry_rows, customer, second)
            for third in range(second):
                cn, ce = _corner_ne_m(geometry_rows, customer, third)
                if _triangle_contains(an, ae, bn, be, cn, ce, pn, pe):
                    return True
    return False


@compiled_inner
def _triangle_contains(an, ae, bn, be, cn, ce, pn, pe):
    """Return whether a non-degenerate triangle contains this point."""
    first = _triangle_orientation_m2(an, ae, bn, be, pn, pe)
    second = _triangle_orientation_m2(bn, be, cn, ce, pn, pe)
    third = _triangle_orientation_m2(cn, ce, an, ae, pn, pe)
    if abs(first + second + third) < LINE_M2:
        return False
    return (first > 0.0) == (second > 0.0) and (second > 0.0) == (third > 0.0)


@compiled_inner
def _do_segments_cross(an, ae, bn, be, cn, ce, dn, de):
    """Return whether two segments cross."""
    if (_triangle_orientation_m2(an, ae, bn, be, cn, ce) > 0.0) == (
        _triangle_orientation_m2(an, ae, bn, be, dn, de) > 0.0
    ):
        return False
    return (_triangle_orientation_m2(cn, ce, dn, de, an, ae) > 0.0) != (
        _triangle_orientation_m2(cn, ce, dn, de, bn, be) > 0.0
    )


@compiled_inner
def _do_corner_lines_cross(
    geometry_rows, customer, corner_count, other_customer, other_corner_count
):
    """Return whether any lines between corners of the two sorties cross."""
    for first in range(1, corner_count):
        an, ae = _corner_ne_m(geometry_rows, customer, first)
        for second in range(first):
            bn, be = _corner_ne_m(geometry_rows, customer, second)
            for third in range(1, other_corner_count):
                cn, ce = _corner_ne_m(geometry_rows, other_customer, third)
                for last_corner in range(third):
                    dn, de = _corner_ne_m(geometry_rows, other_customer, last_corner)
                    if _do_segments_cross(an, ae, bn, be, cn, ce, dn, de):
                        return True
    return False


@compiled_inner
def _are_boxes_separated(
    geometry_rows, customer, corner_count, other_customer, other_corner_count, separation_m
):
    """Return whether the bounding boxes are separated (a quick test for distant pairs)."""
    for axis in range(PAD_N, PAD_N + 2):
        low, high = geometry_rows[axis, customer], geometry_rows[axis, customer]
        for corner in range(1, corner_count):
            low = min(low, geometry_rows[axis + 2 * corner, customer])
            high = max(high, geometry_rows[axis + 2 * corner, customer])
        least, most = geometry_rows[axis, other_customer], geometry_rows[axis, other_customer]
        for corner in range(1, other_corner_count):
            least = min(least, geometry_rows[axis + 2 * corner, other_customer])
            most = max(most, geometry_rows[axis + 2 * corner, other_customer])
        if high + separation_m < least or low - separation_m > most:
            return True
    return False


@compiled_inner
def _is_any_corner_near_ground_shape(
    separation_m2, geometry_rows, customer, corner_count, other_customer, other_corner_count
):
    """Return whether any of the other's first corners is near the hull of this sortie."""
    for corner in range(other_corner_count):
        north, east = _corner_ne_m(geometry_rows, other_customer, corner)
        if is_near_ground_shape(geometry_rows, customer, corner_count, north, east, separation_m2):
            return True
    return False


@compiled_inner
def _are_columns_near(separation_m, geometry_rows, customer, other_customer):
    """Return whether the climb and descent columns of the two are too close."""
    separation_m2 = separation_m * separation_m
    for own_row in range(PAD_N, HOME_E, 2):
        for other_row in range(PAD_N, HOME_E, 2):
            north = geometry_rows[own_row, customer] - geometry_rows[other_row, other_customer]
            east = (
                geometry_rows[own_row + 1, customer] - geometry_rows[other_row + 1, other_customer]
            )
            if north * north + east * east < separation_m2:
                return True
    return False


@compiled_inner
def closed_layer_bits(separation_m, int_rows, geometry_rows, customer, other_customer, other_layer):
    """Return bits of the layers closed to `customer`, `other_customer` in `other_layer`."""
    corners, others = int_rows[CORNERS, customer], int_rows[CORNERS, other_customer]
    if _are_boxes_separated(geometry_rows, customer, corners, other_customer, others, separation_m):
        return 0
    separation_m2 = separation_m * separation_m
    under_one = _is_any_corner_near_ground_shape(
        separation_m2, geometry_rows, customer, corners, other_customer, COLUMNS
    )
    under_other = _is_any_corner_near_ground_shape(
        separation_m2, geometry_rows, other_customer, others, customer, COLUMNS
    )
    if not (
        under_one
        or under_other
        or _do_corner_lines_cross(geometry_rows, customer, corners, other_customer, others)
        or (
            others > COLUMNS
            and _is_any_corner_near_ground_shape(
                separation_m2, geometry_rows, customer, corners, other_customer, others
            )
        )
        or (
            corners > COLUMNS
            and _is_any_corner_near_ground_shape(
                separation_m2, geometry_rows, other_customer, others, customer, corners
            )
        )
    ):
        return 0
    if _are_columns_near(separation_m, geometry_rows, customer, other_customer):
        return ~0
    here = 1 << other_layer
    closed = here
    if under_one:
        closed |= here - 1
    if under_other:
        closed |= ~(here - 1)
    return closed


@compiled_inner
def find_free_layer_and_store_geometry(
    air, plan, int_rows, times_s, customer, launched_s, drones_available, launch_count
):
    """Find the lowest free layer for a launch that ends at `launched_s`. Returns (layer or -1, time
    of the next attempt: landing of the first blocking drone).
    """
    takeoff_s = launched_s + air.ready_s
    launch, rendezvous, kind = (
        plan[LAUNCH, customer],
        plan[RENDEZVOUS, customer],
        plan[KIND, customer],
    )
    store_ground_shape(air, plan, int_rows, times_s, customer, drones_available, launch_count)
    low = int(max(air.at[LOWEST, launch], air.at[LOWEST, customer], air.at[LOWEST, rendezvous]))
    top = int(min(air.at[LAYERS, launch], air.at[LAYERS, customer], air.at[LAYERS, rendezvous]))
    closed, in_air, free_s = 0, 0, math.inf
    for back in range(
        launch_count - 1, max(-1, launch_count - 1 - LOG_DEPTH_FLEETS * air.fleet), -1
    ):
        other = int_rows[LOG, back]
        clear_s = times_s[LAUNCHED, other] + times_s[FLY, other] + air.slack_s
        if clear_s <= takeoff_s:
            continue
        bits = closed_layer_bits(
            air.separation_m, int_rows, times_s, customer, other, int_rows[LAYER, other]
        )
        if bits != 0:
            closed |= bits
            free_s = min(free_s, clear_s)
        in_air += 1
        if in_air == air.fleet:
            break
    for layer in range(low, top):
        if not (closed >> layer) & 1:
            above = layer - air.priced_layer
            if above * air.layer_costs[LAYER_HOVER_S, kind] > times_s[HOVER_LEFT, customer]:
                break
            times_s[FLY, customer] = (
                times_s[LEVEL, customer] + above * air.layer_costs[LAYER_S, kind]
            )
            return layer, 0.0
    return -1, free_s - air.ready_s
