"""A large day in regions: each truck with its drones gets orders that lie together, all as much.

A balanced division (additively weighted Voronoi cells, as in Aurenhammer, SIAM J. Computing 16,
1987): an order goes to the truck for which travel from the region's middle, plus the truck's price,
is least; prices are set so that all regions hold the same work. Middles and prices are found by
turns, as in k-means. Nothing is drawn: the same day gives the same regions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.errors import LeewayError

TURNS = 25
"""Middles are moved so often at most; it ends sooner where nothing changes."""

SWEEPS = 60
BALANCED_FRAC = 0.005
"""Prices are right when each region's work is within this share of its due."""

NEXT_STOP = 0.7124
"""A way past many points is this times the root of area times number (Beardwood, Halton and
Hammersley, Proc. Cambridge Phil. Soc. 55, 1959; constant of Johnson and McGeoch)."""


@dataclass(frozen=True, slots=True)
class RegionProblem:
    """What is divided. `trucks`: how many start from each depot. `work_s`: of a driver, by order.

    Places are metres north and east about one point: (depots, 2) and (orders, 2).
    """

    depots_ne_m: Floats
    trucks: tuple[int, ...]
    orders_ne_m: Floats
    work_s: Floats
    metres_per_s: float
    """Of a truck along the straight line: speed over detour."""

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


def order_work_s(
    by_truck_s: float,
    by_drone_s: float,
    flies: Bools,
    orders_ne_m: Floats,
    metres_per_s: float,
    drones_each: float,
) -> Floats:
    """What each order costs a driver, s: at the door, or with a drone where it may fly.

    The drive is in it: from door to door past those that cannot fly, and for the others from stop
    to stop, with `drones_each` orders (a truck's drones) at each.
    """
    work_s = np.where(flies, min(by_truck_s, by_drone_s), by_truck_s)
    for kind, each in ((~flies, 1.0), (np.ones_like(flies), max(drones_each, 1.0))):
        count = int(kind.sum())
        if count > 1:
            span_m = np.ptp(orders_ne_m[kind], axis=0)
            between_m = NEXT_STOP * math.sqrt(float(span_m[0] * span_m[1]) / count * each)
            drive_s = between_m / metres_per_s / each
            work_s = work_s + np.where(kind & (flies | (each == 1.0)), drive_s, 0.0)
    return work_s


def regions_of(
    problem: RegionProblem, share: Floats | None = None, before: Ints | None = None
) -> Ints:
    """(orders,): the truck of each order; trucks are numbered depot by depot.

    `share` (trucks,): of all work, by truck; sums to 1, all the same by default. `before`
    (orders,): a division to begin with, so that a little other share changes little.
    """
    home = np.repeat(np.arange(len(problem.trucks)), problem.trucks)
    share = np.full(len(home), 1.0 / len(home)) if share is None else share
    truck = _sectors(problem, home) if before is None else before
    for _ in range(TURNS):
        cost_s = _cost_s(problem, home, _middles_ne_m(problem, truck, len(home)))
        following = _balanced(cost_s, problem.work_s, share)
        if np.array_equal(following, truck):
            break
        truck = following
    return truck


def meeting(areas_ne_m: Sequence[Floats], within_m: float) -> list[list[int]]:
    """For each area, the others whose flights may come near its own: where the hulls about the
    areas' places (n, 2) come so near to each other. Who may meet whom is the same from both sides.
    """
    hulls = [shapely.MultiPoint(area).convex_hull for area in areas_ne_m]
    return [
        [
            other
            for other, beside in enumerate(hulls)
            if other != number and shapely.dwithin(hull, beside, within_m)
        ]
        for number, hull in enumerate(hulls)
    ]


def _sectors(problem: RegionProblem, home: Ints) -> Ints:
    """To begin with: each depot's orders by angle, cut into sectors of the same work."""
    trucks = np.asarray(problem.trucks, float)
    between_s = _travel_s(problem, problem.depots_ne_m)
    depot = _balanced(between_s, problem.work_s, trucks / trucks.sum())
    truck = np.zeros(len(problem.orders_ne_m), np.int64)
    for number, count in enumerate(problem.trucks):
        mine = np.flatnonzero(depot == number)
        off_m = problem.orders_ne_m[mine] - problem.depots_ne_m[number]
        mine = mine[np.argsort(np.arctan2(off_m[:, 1], off_m[:, 0]), kind="stable")]
        done = np.cumsum(problem.work_s[mine])
        sector = np.minimum(
            (count * done / max(float(done[-1:].sum()), 1e-9)).astype(int), count - 1
        )
        truck[mine] = np.flatnonzero(home == number)[0] + sector
    return truck


def _middles_ne_m(problem: RegionProblem, truck: Ints, count: int) -> Floats:
    return np.array(
        [
            problem.orders_ne_m[truck == k].mean(axis=0)
            if (truck == k).any()
            else problem.orders_ne_m.mean(axis=0)
            for k in range(count)
        ]
    )


def _cost_s(problem: RegionProblem, home: Ints, middles_ne_m: Floats) -> Floats:
    """Travel from the region's middle, and the order's part of the way from the depot and back."""
    each = len(problem.orders_ne_m) / len(home)
    stem_s = _travel_s(problem, problem.depots_ne_m)[:, home]
    return _travel_s(problem, middles_ne_m) + 2.0 * stem_s / max(each, 2.0)


def _travel_s(problem: RegionProblem, from_ne_m: Floats) -> Floats:
    off_m = problem.orders_ne_m[:, None, :] - from_ne_m[None, :, :]
    return np.hypot(off_m[..., 0], off_m[..., 1]) / problem.metres_per_s


def _balanced(cost_s: Floats, work_s: Floats, share: Floats) -> Ints:
    """(orders,): the choice of least cost plus price, with prices by which each has its share.

    Each price in turn is set so that its region holds its share, the others being as they are
    (an auction's dual ascent, Bertsekas 1988).
    """
    price_s = np.zeros(cost_s.shape[1])
    due = share * work_s.sum()
    for _ in range(SWEEPS):
        for k in range(len(price_s)):
            others = np.delete(cost_s + price_s, k, axis=1)
            if others.shape[1] == 0:
                break
            margin_s = others.min(axis=1) - cost_s[:, k]
            best_first = np.argsort(-margin_s, kind="stable")
            held = np.cumsum(work_s[best_first])
            last = min(int(np.searchsorted(held, due[k])), len(held) - 2)
            price_s[k] = 0.5 * (margin_s[best_first[last]] + margin_s[best_first[last + 1]])
        chosen = np.argmin(cost_s + price_s, axis=1)
        work = np.bincount(chosen, weights=work_s, minlength=len(price_s))
        if np.all(np.abs(work - due) <= np.maximum(BALANCED_FRAC * due, work_s.max())):
            break
    return np.argmin(cost_s + price_s, axis=1)
