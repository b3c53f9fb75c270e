"""Shortest level routes between many places around obstacles of that height.

A route is straight, or goes by corners: those that the companion's own planner flies around
(`ObstacleMap.outlines_ne_m`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse.csgraph import shortest_path

from companion.core.base.arrays import Bools, Floats
from companion.core.base.geo import ObstacleMap

Points = tuple[tuple[float, float], ...]

BEYOND_M = 2.0
"""Distance of corners beyond the clearance, as in companion's `waypoint_graph`."""


class Price(NamedTuple):
    """Cost of legs, each (from, to): time, mean energy, and its standard deviation."""

    s: Floats
    wh: Floats
    std_wh: Floats

    def plus(self, other: "Price") -> "Price":
        """One leg after the other. Deviations add up: an upper bound whatever their correlation."""
        return Price(self.s + other.s, self.wh + other.wh, self.std_wh + other.std_wh)

    def at(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> "Price":
        """The prices of single legs."""
        return Price(*(table[rows, columns] for table in self))


PriceOf = Callable[[Floats, Floats], Price]
"""Prices of straight legs from (a, 2) to (b, 2) places, north and east."""


class ObstacleRoutes:
    """The routes at one height between places (north, east), m."""

    def __init__(self, obstacles: ObstacleMap, ne_m: Floats, height_m: float) -> None:
        self._ne_m, self.height_m = ne_m, height_m
        grown = obstacles.grown_at(height_m)
        corners = [c for ring in obstacles.outlines_ne_m(height_m, BEYOND_M) for c in ring]
        self._corners = np.array(corners).reshape(-1, 2)
        self._corners = self._corners[~_inside(self._corners, grown)]
        self.blocked = _blocked(ne_m, ne_m, grown)
        """(n, n): the straight line is blocked."""
        self.buried = _inside(ne_m, grown)
        """(n,): the place itself is within the clearance of an obstacle."""
        if self.blocked.any():
            self._route(grown)

    def _route(self, grown: list[shapely.Polygon]) -> None:
        seen_m = _lengths(self._corners, self._corners)
        seen_m[_blocked(self._corners, self._corners, grown)] = np.inf
        self._between_m, self._before = shortest_path(
            np.where(np.isfinite(seen_m), seen_m, 0.0), method="D", return_predecessors=True
        )
        to_m = _lengths(self._ne_m, self._corners)
        to_m[_blocked(self._ne_m, self._corners, grown)] = np.inf
        count = len(self._ne_m)
        reach_m = np.full((count, len(self._corners)), np.inf)
        first = np.zeros((count, len(self._corners)), dtype=np.int64)
        for corner in range(len(self._corners)):
            ahead_m = to_m[:, [corner]] + self._between_m[corner][None, :]
            nearer = ahead_m < reach_m
            reach_m[nearer] = ahead_m[nearer]
            first[nearer] = corner
        rows, columns = np.nonzero(self.blocked)
        whole_m = reach_m[rows] + to_m[columns]
        last = whole_m.argmin(axis=1) if len(self._corners) else np.zeros(len(rows), np.int64)
        self._rows, self._columns = rows, columns
        self._first, self._last = first[rows, last], last
        self._none = ~np.isfinite(whole_m[np.arange(len(rows)), last])

    def priced(self, price_of: PriceOf) -> Price:
        """The price of every route; infinite where there is none."""
        straight = price_of(self._ne_m, self._ne_m)
        if not self.blocked.any():
            return straight
        ways = [table.copy() for table in straight]
        if not len(self._corners):
            for table in ways:
                table[self.blocked] = np.inf
            return Price(*ways)
        to = price_of(self._ne_m, self._corners)
        back = price_of(self._corners, self._ne_m)
        around = self._around(price_of(self._corners, self._corners))
        found = to.at(self._rows, self._first).plus(around.at(self._first, self._last))
        found = found.plus(back.at(self._last, self._columns))
        for table, by_corner in zip(ways, found, strict=True):
            table[self._rows, self._columns] = np.where(self._none, np.inf, by_corner)
        return Price(*ways)

    def _around(self, legs: Price) -> Price:
        """From corner to corner along the shortest route; zero from a corner to itself."""
        count = len(self._corners)
        sums = [np.zeros((count, count)) for _ in legs]
        for start in range(count):
            for end in np.argsort(self._between_m[start]).tolist():
                before = int(self._before[start, end])
                if before < 0:  # the start itself, or no route
                    continue
                for total, leg in zip(sums, legs, strict=True):
                    total[start, end] = total[start, before] + leg[before, end]
        return Price(*sums)

    @property
    def corners_ne_m(self) -> Floats:
        """(corners, 2): all corners, by number."""
        return self._corners

    def bends(self) -> NDArray[np.int32]:
        """(n, n, most): the numbers of the corners on each way in their order, -1 after the last;
        of no size where all ways are straight or blocked for good.
        """
        if not self.blocked.any():
            return np.zeros((0, 0, 0), dtype=np.int32)
        ways = [
            [] if none else self._corners_between(int(first), int(last))
            for none, first, last in zip(self._none, self._first, self._last, strict=True)
        ]
        most = max(len(way) for way in ways)
        count = len(self._ne_m)
        found = np.full((count, count, most), -1, dtype=np.int32)
        for row, column, way in zip(self._rows, self._columns, ways, strict=True):
            found[row, column, : len(way)] = way
        return found

    def _corners_between(self, first: int, last: int) -> list[int]:
        found = [last]
        while found[-1] != first:
            found.append(int(self._before[first, found[-1]]))
        return found[::-1]

    def via(self, start: int, end: int) -> Points:
        """The corners on the route between two places; none where it is straight."""
        if not self.blocked[start, end]:
            return ()
        at = int(np.nonzero((self._rows == start) & (self._columns == end))[0][0])
        way = self._corners_between(int(self._first[at]), int(self._last[at]))
        return tuple((float(n), float(e)) for n, e in self._corners[way])


def _lengths(a_ne_m: Floats, b_ne_m: Floats) -> Floats:
    away = b_ne_m[None, :, :] - a_ne_m[:, None, :]
    return np.hypot(away[..., 0], away[..., 1])


def _inside(ne_m: Floats, grown: list[shapely.Polygon]) -> Bools:
    found = np.zeros(len(ne_m), dtype=np.bool_)
    for outline in grown:
        found |= shapely.intersects_xy(outline, ne_m[:, 0], ne_m[:, 1])
    return found


def _blocked(a_ne_m: Floats, b_ne_m: Floats, grown: list[shapely.Polygon]) -> Bools:
    found = np.zeros((len(a_ne_m), len(b_ne_m)), dtype=np.bool_)
    if not grown or not found.size:
        return found
    same = a_ne_m is b_ne_m
    rows, columns = np.triu_indices(len(a_ne_m)) if same else np.indices(found.shape).reshape(2, -1)
    lines = shapely.linestrings(np.stack([a_ne_m[rows], b_ne_m[columns]], axis=1))
    hits = np.zeros(len(rows), dtype=np.bool_)
    for outline in grown:
        shapely.prepare(outline)
        hits |= shapely.intersects(outline, lines)
    found[rows, columns] = hits
    if same:
        found[columns, rows] = hits
    return found
