"""The shortest way to each goal round the buildings; the teacher knows it, the policy never.

Buildings are boxes along north and east, so the shortest way bends at their corners only: the
visibility graph (Lozano-Perez and Wesley, CACM 22, 1979) of boxes grown by `CLEAR_M` is exact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from companion.core.base.arrays import Bools, Floats
from sim_bridge.research.avoidance.scenes import Scene

CLEAR_M = 8.0  # the filter's 3 m, 3 m of the raster's cells, and room to steer in
BEYOND_M = 0.5  # corners stand so far outside the grown boxes
FAR_M = 1e5  # of corners that nobody can reach, and of places in the list that are empty
AT_ONCE = 64  # drones looked at at once, so that the working set stays in cache


@dataclass(frozen=True)
class WaysAround:
    """Boxes (S, B, 4), corners (S, C, 2) and ways between corners (S, C, C) of S towns."""

    boxes_m: Floats
    corners_m: Floats
    between_m: Floats

    def from_corners_m(self, scene_of: NDArray[np.int64], goal_ne_m: Floats) -> Floats:
        """Lengths (A, C) from each corner to the goals (A, 2) of drones in these towns (A,)."""
        way = np.empty((len(goal_ne_m), self.corners_m.shape[1]))
        for first in range(0, len(way), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            scene, goal = scene_of[some], goal_ne_m[some]
            last = _legs_m(goal, self.corners_m[scene], self.boxes_m[scene])
            way[some] = (self.between_m[scene] + last[:, None, :]).min(axis=-1)
        return way

    def next_leg(
        self,
        scene_of: NDArray[np.int64],
        pos_ne_m: Floats,
        goal_ne_m: Floats,
        from_corners_m: Floats,
    ) -> tuple[Floats, Floats]:
        """Bearing of the shortest way (A,) and its length (A,)."""
        bearing, length = np.empty(len(pos_ne_m)), np.empty(len(pos_ne_m))
        for first in range(0, len(pos_ne_m), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            boxes, pos = self.boxes_m[scene_of[some]], pos_ne_m[some]
            free, pushed = _pushed_out(pos, boxes)
            points = np.concatenate([goal_ne_m[some, None], self.corners_m[scene_of[some]]], axis=1)
            ways = _legs_m(free, points, boxes)
            ways[:, 1:] += from_corners_m[some]
            ways[:, 0] = np.where(
                ways.min(axis=1) < FAR_M, ways[:, 0], _lengths(points[:, 0] - free)
            )
            best = ways.argmin(axis=1)
            rows = np.arange(len(pos))
            towards = np.where((pushed > 1.0)[:, None], free, points[rows, best]) - pos
            bearing[some] = np.arctan2(towards[:, 1], towards[:, 0])
            length[some] = ways[rows, best] + 2.0 * pushed
        return bearing, length


def ways_around(scenes: list[Scene]) -> WaysAround:
    """What is the same for all goals, worked out once for each town."""
    grown = [s.boxes_m + CLEAR_M * np.array([-1.0, -1.0, 1.0, 1.0]) for s in scenes]
    most = max(1, *(len(g) for g in grown))
    nowhere = np.array([FAR_M, FAR_M, FAR_M + 1.0, FAR_M + 1.0])
    boxes = np.stack([np.concatenate([g, np.tile(nowhere, (most - len(g), 1))]) for g in grown])
    corners = _corners(boxes)
    between = np.empty((len(scenes), corners.shape[1], corners.shape[1]))
    for k, (points, around) in enumerate(zip(corners, boxes, strict=True)):
        legs = _legs_m(points, points[None], around[None])
        between[k] = dijkstra(np.where(legs < FAR_M, legs, 0.0), directed=False)
    return WaysAround(boxes, corners, np.minimum(between, FAR_M))


def _corners(boxes: Floats) -> Floats:
    """Corners just outside the boxes, (S, 4 B, 2); those inside another box far away."""
    south, west, north, east = np.moveaxis(boxes, -1, 0)
    low, high = (south - BEYOND_M, west - BEYOND_M), (north + BEYOND_M, east + BEYOND_M)
    corners = np.concatenate(
        [np.stack([n, e], axis=-1) for n in (low[0], high[0]) for e in (low[1], high[1])], axis=1
    )
    within = (corners[:, :, None] > boxes[:, None, :, :2]) & (
        corners[:, :, None] < boxes[:, None, :, 2:]
    )
    covered: Bools = np.asarray(np.any(np.all(within, axis=-1), axis=-1))
    return np.where(covered[..., None], 2.0 * FAR_M, corners)


def _lengths(vectors: Floats) -> Floats:
    return np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2)


def _legs_m(start: Floats, ends: Floats, boxes: Floats) -> Floats:
    """Lengths (A, C) of the straight legs from start (A, 2) to ends (A or 1, C, 2); `FAR_M` if cut.

    A leg meets a box if its parts between the box's two pairs of sides overlap (slab method).
    """
    way = ends - start[:, None]
    step = np.where(np.abs(way) < 1e-9, 1e-9, way).astype(np.float32)
    low = (boxes[..., :2] - start[:, None]).astype(np.float32)  # (A, B, 2)
    high = (boxes[..., 2:] - start[:, None]).astype(np.float32)
    enter = np.zeros((*way.shape[:2], boxes.shape[1]), np.float32)
    leave = np.ones_like(enter)
    for k in range(2):
        share = np.float32(1.0) / step[..., k, None]
        one, other = low[:, None, :, k] * share, high[:, None, :, k] * share
        np.maximum(enter, np.minimum(one, other), out=enter)
        np.minimum(leave, np.maximum(one, other), out=leave)
    cut: Bools = np.asarray(np.any(enter < leave, axis=-1))
    length = _lengths(way)
    return np.where(cut | (length >= 0.5 * FAR_M), FAR_M, length)


def _pushed_out(pos: Floats, boxes: Floats) -> tuple[Floats, Floats]:
    """The nearest place outside the grown box that a drone is in, and how far that is."""
    apart = np.minimum(pos[:, None] - boxes[..., :2], boxes[..., 2:] - pos[:, None])
    inside: Bools = np.asarray(apart.min(axis=-1) > 0.0)
    which = inside.argmax(axis=1)
    rows = np.arange(len(pos))
    box = boxes[rows, which]
    sides = np.concatenate([pos - box[:, :2], box[:, 2:] - pos], axis=1)
    side = sides.argmin(axis=1)
    least = np.where(inside[rows, which], sides[rows, side] + BEYOND_M, 0.0)
    free = pos.copy()
    free[rows, side % 2] += np.where(side < 2, -least, least)
    return free, least
