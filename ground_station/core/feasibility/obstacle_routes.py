"""Shortest level routes between many positions around the obstacles at one height.

A route is straight, or passes corners: the same as in the companion's planner
(`ObstacleMap.corner_rings_around_obstacles_ne_m`).
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

CORNER_MARGIN_M = 2.0
"""Distance of corners outside the clearance, as in the companion's `waypoint_graph`."""


class Price(NamedTuple):
    """Cost of legs, each (from, to): time, mean energy, standard deviation of the energy."""

    time_s: Floats
    energy_wh: Floats
    std_wh: Floats

    def sum_with_added_std(self, other: "Price") -> "Price":
        """Return the sum of two legs. Deviations add: an upper bound for any correlation."""
        return Price(
            self.time_s + other.time_s, self.energy_wh + other.energy_wh, self.std_wh + other.std_wh
        )

    def select_legs(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> "Price":
        """Return the prices of single legs."""
        return Price(*(table[rows, columns] for table in self))


PriceOf = Callable[[Floats, Floats], Price]
"""Prices of straight legs from (a, 2) to (b, 2) positions, north and east."""


class ObstacleRoutes:
    """Routes at one height between positions (north, east), m."""

    def __init__(self, obstacles: ObstacleMap, ne_m: Floats, height_m: float) -> None:
        self._ne_m, self.height_m = ne_m, height_m
        inflated = obstacles.buffered_outlines_at(height_m)
        corners = [
            c
            for ring in obstacles.corner_rings_around_obstacles_ne_m(height_m, CORNER_MARGIN_M)
            for c in ring
        ]
        self._corners = np.array(corners).reshape(-1, 2)
        self._corners = self._corners[~_are_inside_outlines(self._corners, inflated)]
        self.blocked = _are_straight_lines_blocked(ne_m, ne_m, inflated)
        """(n, n): the straight line is blocked."""
        self.obstructed = _are_inside_outlines(ne_m, inflated)
        """(n,): the position is within the clearance of an obstacle."""
        if self.blocked.any():
            self._store_shortest_corner_routes(inflated)

    def _store_shortest_corner_routes(self, inflated_outlines: list[shapely.Polygon]) -> None:
        seen_m = _distance_matrix_m(self._corners, self._corners)
        seen_m[_are_straight_lines_blocked(self._corners, self._corners, inflated_outlines)] = (
            np.inf
        )
        self._corner_distance_m, self._predecessor = shortest_path(
            np.where(np.isfinite(seen_m), seen_m, 0.0), method="D", return_predecessors=True
        )
        to_m = _distance_matrix_m(self._ne_m, self._corners)
        to_m[_are_straight_lines_blocked(self._ne_m, self._corners, inflated_outlines)] = np.inf
        count = len(self._ne_m)
        corner_distance_m = np.full((count, len(self._corners)), np.inf)
        first = np.zeros((count, len(self._corners)), dtype=np.int64)
        for corner in range(len(self._corners)):
            candidate_m = to_m[:, [corner]] + self._corner_distance_m[corner][None, :]
            nearer = candidate_m < corner_distance_m
            corner_distance_m[nearer] = candidate_m[nearer]
            first[nearer] = corner
        rows, columns = np.nonzero(self.blocked)
        whole_m = corner_distance_m[rows] + to_m[columns]
        last = whole_m.argmin(axis=1) if len(self._corners) else np.zeros(len(rows), np.int64)
        self._rows, self._columns = rows, columns
        self._first, self._last = first[rows, last], last
        self._unreachable = ~np.isfinite(whole_m[np.arange(len(rows)), last])

    def price_routes(self, price_straight_legs: PriceOf) -> Price:
        """Return the price of each route; infinite if no route exists."""
        straight = price_straight_legs(self._ne_m, self._ne_m)
        if not self.blocked.any():
            return straight
        routes = [table.copy() for table in straight]
        if not len(self._corners):
            for table in routes:
                table[self.blocked] = np.inf
            return Price(*routes)
        to = price_straight_legs(self._ne_m, self._corners)
        back = price_straight_legs(self._corners, self._ne_m)
        between_corners = self._shortest_route_price_between_corners(
            price_straight_legs(self._corners, self._corners)
        )
        found = to.select_legs(self._rows, self._first).sum_with_added_std(
            between_corners.select_legs(self._first, self._last)
        )
        found = found.sum_with_added_std(back.select_legs(self._last, self._columns))
        for table, by_corner in zip(routes, found, strict=True):
            table[self._rows, self._columns] = np.where(self._unreachable, np.inf, by_corner)
        return Price(*routes)

    def _shortest_route_price_between_corners(self, corner_leg_prices: Price) -> Price:
        """Return the price of the shortest route between corners; zero from a corner to itself."""
        count = len(self._corners)
        sums = [np.zeros((count, count)) for _ in corner_leg_prices]
        for start in range(count):
            for end in np.argsort(self._corner_distance_m[start]).tolist():
                before = int(self._predecessor[start, end])
                if before < 0:  # the start itself, or no route
                    continue
                for total, leg in zip(sums, corner_leg_prices, strict=True):
                    total[start, end] = total[start, before] + leg[before, end]
        return Price(*sums)

    @property
    def corners_ne_m(self) -> Floats:
        """(corners, 2): all corners, by number."""
        return self._corners

    def corner_indices_by_start_and_end(self) -> NDArray[np.int64]:
        """Return (n, n, most): the indices of the corners on each route in order, then -1; empty
        if all routes are straight or no corner route exists.
        """
        if not self.blocked.any():
            return np.zeros((0, 0, 0), dtype=np.int64)
        routes = [
            [] if none else self._corner_sequence(int(first), int(last))
            for none, first, last in zip(self._unreachable, self._first, self._last, strict=True)
        ]
        most = max(len(route) for route in routes)
        count = len(self._ne_m)
        found = np.full((count, count, most), -1, dtype=np.int64)
        for row, column, route in zip(self._rows, self._columns, routes, strict=True):
            found[row, column, : len(route)] = route
        return found

    def _corner_sequence(self, first_corner: int, last_corner: int) -> list[int]:
        found = [last_corner]
        while found[-1] != first_corner:
            found.append(int(self._predecessor[first_corner, found[-1]]))
        return found[::-1]

    def waypoints_between(self, start_index: int, end_index: int) -> Points:
        """Return the corners on the route between two positions; empty if it is straight."""
        if not self.blocked[start_index, end_index]:
            return ()
        at = int(np.nonzero((self._rows == start_index) & (self._columns == end_index))[0][0])
        route = self._corner_sequence(int(self._first[at]), int(self._last[at]))
        return tuple((float(n), float(e)) for n, e in self._corners[route])


def _distance_matrix_m(a_ne_m: Floats, b_ne_m: Floats) -> Floats:
    away = b_ne_m[None, :, :] - a_ne_m[:, None, :]
    return np.hypot(away[..., 0], away[..., 1])


def _are_inside_outlines(ne_m: Floats, inflated_outlines: list[shapely.Polygon]) -> Bools:
    found = np.zeros(len(ne_m), dtype=np.bool_)
    for outline in inflated_outlines:
        found |= shapely.intersects_xy(outline, ne_m[:, 0], ne_m[:, 1])
    return found


def _are_straight_lines_blocked(
    a_ne_m: Floats, b_ne_m: Floats, inflated_outlines: list[shapely.Polygon]
) -> Bools:
    found = np.zeros((len(a_ne_m), len(b_ne_m)), dtype=np.bool_)
    if not inflated_outlines or not found.size:
        return found
    same = a_ne_m is b_ne_m
    rows, columns = np.triu_indices(len(a_ne_m)) if same else np.indices(found.shape).reshape(2, -1)
    lines = shapely.linestrings(np.stack([a_ne_m[rows], b_ne_m[columns]], axis=1))
    hits = np.zeros(len(rows), dtype=np.bool_)
    for outline in inflated_outlines:
        shapely.prepare(outline)
        hits |= shapely.intersects(outline, lines)
    found[rows, columns] = hits
    if same:
        found[columns, rows] = hits
    return found
