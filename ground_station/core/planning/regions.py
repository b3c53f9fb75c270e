"""Divides a large day into regions: each truck with its drones gets adjacent orders of equal work.

A balanced partition (additively weighted Voronoi cells, as in Aurenhammer, SIAM J. Computing 16,
1987): an order is assigned to the truck with the least travel time from the region's centre plus
the truck's price; prices are set so that all regions hold the same work. Centres and prices are
updated alternately, as in k-means. Deterministic.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.errors import LeewayError

MAX_ITERATIONS = 25
"""Maximum number of centre updates; fewer if the assignment converges."""

MAX_SWEEPS = 60
BALANCED_FRAC = 0.005
"""Balance tolerance: deviation of a region's work from its target, as a share."""

TOUR_LENGTH_CONSTANT = 0.7124
"""Tour length through many points over the root of area times number (Beardwood, Halton and
Hammersley, Proc. Cambridge Phil. Soc. 55, 1959; constant of Johnson and McGeoch)."""


@dataclass(frozen=True, slots=True)
class RegionProblem:
    """The partition problem. `trucks`: number per depot. `work_s`: driver work by order.

    Positions are metres north and east about one point: (depots, 2) and (orders, 2).
    """

    depots_ne_m: Floats
    trucks: tuple[int, ...]
    orders_ne_m: Floats
    work_s: Floats
    metres_per_s: float
    """Truck speed along the straight line: speed over detour factor."""

    def __post_init__(self) -> None:
        if len(self.trucks) != len(self.depots_ne_m) or min(self.trucks, default=0) < 1:
            raise LeewayError(
                f"trucks {self.trucks}: expected one or more for each of"
                f" {len(self.depots_ne_m)} depots"
            )
        if len(self.orders_ne_m) < sum(self.trucks):
            raise LeewayError(
                f"{len(self.orders_ne_m)} orders: expected one or more for each of"
                f" {sum(self.trucks)} trucks"
            )


def driver_work_by_order_s(
    truck_delivery_s: float,
    drone_delivery_s: float,
    can_fly_by_order: Bools,
    orders_ne_m: Floats,
    metres_per_s: float,
    drones_per_truck: float,
) -> Floats:
    """Compute the driver's work per order, s: at the door, or with a drone if it may fly.

    Includes driving: between doors for orders that cannot fly, and for the others between stops,
    with `drones_per_truck` orders (a truck's drones) per stop.
    """
    work_s = np.where(can_fly_by_order, min(truck_delivery_s, drone_delivery_s), truck_delivery_s)
    for kind, each in (
        (~can_fly_by_order, 1.0),
        (np.ones_like(can_fly_by_order), max(drones_per_truck, 1.0)),
    ):
        count = int(kind.sum())
        if count > 1:
            span_m = np.ptp(orders_ne_m[kind], axis=0)
            between_m = TOUR_LENGTH_CONSTANT * math.sqrt(
                float(span_m[0] * span_m[1]) / count * each
            )
            drive_s = between_m / metres_per_s / each
            work_s = work_s + np.where(kind & (can_fly_by_order | (each == 1.0)), drive_s, 0.0)
    return work_s


def truck_by_order_with_equal_work(problem: RegionProblem) -> Ints:
    """Return (orders,): the truck of each order; trucks are numbered by depot."""
    home = np.repeat(np.arange(len(problem.trucks)), problem.trucks)
    share = np.full(len(home), 1.0 / len(home))
    truck = _initial_truck_by_order(problem, home)
    for _ in range(MAX_ITERATIONS):
        cost_s = _cost_by_order_and_truck_s(
            problem, home, _order_centre_by_truck_ne_m(problem, truck, len(home))
        )
        updated = _region_by_order_with_equal_work(cost_s, problem.work_s, share)
        if np.array_equal(updated, truck):
            break
        truck = updated
    return truck


def adjacent_area_indices_by_area(areas_ne_m: Sequence[Floats], within_m: float) -> list[list[int]]:
    """Return, for each area, the other areas whose flights may come near: the convex hulls of the
    areas' positions (n, 2) are within `within_m`. The relation is symmetric.
    """
    hulls = [shapely.MultiPoint(area).convex_hull for area in areas_ne_m]
    return [
        [
            other
            for other, other_hull in enumerate(hulls)
            if other != number and shapely.dwithin(hull, other_hull, within_m)
        ]
        for number, hull in enumerate(hulls)
    ]


def _initial_truck_by_order(problem: RegionProblem, depot_by_truck: Ints) -> Ints:
    """Initial assignment: each depot's orders by angle, in sectors of equal work."""
    trucks = np.asarray(problem.trucks, float)
    between_s = _travel_matrix_s(problem, problem.depots_ne_m)
    depot = _region_by_order_with_equal_work(between_s, problem.work_s, trucks / trucks.sum())
    truck = np.zeros(len(problem.orders_ne_m), np.int64)
    for number, count in enumerate(problem.trucks):
        depot_orders = np.flatnonzero(depot == number)
        off_m = problem.orders_ne_m[depot_orders] - problem.depots_ne_m[number]
        depot_orders = depot_orders[np.argsort(np.arctan2(off_m[:, 1], off_m[:, 0]), kind="stable")]
        done = np.cumsum(problem.work_s[depot_orders])
        sector = np.minimum(
            (count * done / max(float(done[-1:].sum()), 1e-9)).astype(int), count - 1
        )
        truck[depot_orders] = np.flatnonzero(depot_by_truck == number)[0] + sector
    return truck


def _order_centre_by_truck_ne_m(
    problem: RegionProblem, truck_by_order: Ints, truck_count: int
) -> Floats:
    return np.array(
        [
            problem.orders_ne_m[truck_by_order == k].mean(axis=0)
            if (truck_by_order == k).any()
            else problem.orders_ne_m.mean(axis=0)
            for k in range(truck_count)
        ]
    )


def _cost_by_order_and_truck_s(
    problem: RegionProblem, depot_by_truck: Ints, centres_ne_m: Floats
) -> Floats:
    """Travel time from the region's centre, plus the order's share of the depot round trip."""
    each = len(problem.orders_ne_m) / len(depot_by_truck)
    stem_s = _travel_matrix_s(problem, problem.depots_ne_m)[:, depot_by_truck]
    return _travel_matrix_s(problem, centres_ne_m) + 2.0 * stem_s / max(each, 2.0)


def _travel_matrix_s(problem: RegionProblem, from_ne_m: Floats) -> Floats:
    off_m = problem.orders_ne_m[:, None, :] - from_ne_m[None, :, :]
    return np.hypot(off_m[..., 0], off_m[..., 1]) / problem.metres_per_s


def _region_by_order_with_equal_work(
    cost_s: Floats, work_s: Floats, work_share_by_region: Floats
) -> Ints:
    """Return (orders,): the region of least cost plus price, with prices that balance the work.

    Each price in turn is set so that its region holds its share, with the other prices fixed
    (an auction's dual ascent, Bertsekas 1988).
    """
    price_s = np.zeros(cost_s.shape[1])
    target_s = work_share_by_region * work_s.sum()
    for _ in range(MAX_SWEEPS):
        for k in range(len(price_s)):
            others = np.delete(cost_s + price_s, k, axis=1)
            if others.shape[1] == 0:
                break
            margin_s = others.min(axis=1) - cost_s[:, k]
            best_first = np.argsort(-margin_s, kind="stable")
            cumulative_work_s = np.cumsum(work_s[best_first])
            last = min(
                int(np.searchsorted(cumulative_work_s, target_s[k])), len(cumulative_work_s) - 2
            )
            price_s[k] = 0.5 * (margin_s[best_first[last]] + margin_s[best_first[last + 1]])
        selected = np.argmin(cost_s + price_s, axis=1)
        work = np.bincount(selected, weights=work_s, minlength=len(price_s))
        if np.all(np.abs(work - target_s) <= np.maximum(BALANCED_FRAC * target_s, work_s.max())):
            break
    return np.argmin(cost_s + price_s, axis=1)
