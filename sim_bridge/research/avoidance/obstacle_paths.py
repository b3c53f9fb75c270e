"""The shortest path to each goal around the buildings; for training, unknown to the policy.

Buildings are boxes along north and east, so the shortest path bends at their corners only. The
visibility graph (Lozano-Perez and Wesley, CACM 22, 1979) of boxes grown by the clearance is exact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from companion.core.base.arrays import Bools, Floats
from sim_bridge.research.avoidance.scenes import Scene

CLEARANCE_M = 8.0  # the filter's 3 m, 3 m of the raster's cells, and a margin for steering
CORNER_OFFSET_M = 0.5  # distance of corners outside the grown boxes
NO_PATH_M = 1e5  # length without a path, and position of padding boxes
DRONES_PER_BATCH = 64  # drones per batch, so that the working set stays in cache


@dataclass(frozen=True)
class ObstaclePaths:
    """Boxes (S, B, 4), corners (S, C, 2) and path lengths between corners (S, C, C) of S towns."""

    boxes_m: Floats
    corners_m: Floats
    corner_to_corner_m: Floats

    def shortest_corner_to_goal_lengths_m(
        self, scene_index_by_drone: NDArray[np.int64], goal_ne_m: Floats
    ) -> Floats:
        """Return lengths (A, C) from each corner to the goals (A, 2) of drones in towns (A,)."""
        paths = np.empty((len(goal_ne_m), self.corners_m.shape[1]))
        for first in range(0, len(paths), DRONES_PER_BATCH):
            batch = slice(first, first + DRONES_PER_BATCH)
            scene, goal = scene_index_by_drone[batch], goal_ne_m[batch]
            last = _unobstructed_segment_lengths_m(goal, self.corners_m[scene], self.boxes_m[scene])
            paths[batch] = (self.corner_to_corner_m[scene] + last[:, None, :]).min(axis=-1)
        return paths

    def initial_bearing_and_path_length(
        self,
        scene_index_by_drone: NDArray[np.int64],
        pos_ne_m: Floats,
        goal_ne_m: Floats,
        corner_to_goal_m: Floats,
    ) -> tuple[Floats, Floats]:
        """Return the initial bearing of the shortest path (A,) and its length (A,)."""
        bearing, length = np.empty(len(pos_ne_m)), np.empty(len(pos_ne_m))
        for first in range(0, len(pos_ne_m), DRONES_PER_BATCH):
            batch = slice(first, first + DRONES_PER_BATCH)
            boxes, pos = self.boxes_m[scene_index_by_drone[batch]], pos_ne_m[batch]
            outside_pos, pushed = _nearest_points_outside_boxes(pos, boxes)
            points = np.concatenate(
                [goal_ne_m[batch, None], self.corners_m[scene_index_by_drone[batch]]], axis=1
            )
            path_lengths = _unobstructed_segment_lengths_m(outside_pos, points, boxes)
            path_lengths[:, 1:] += corner_to_goal_m[batch]
            path_lengths[:, 0] = np.where(
                path_lengths.min(axis=1) < NO_PATH_M,
                path_lengths[:, 0],
                _norms(points[:, 0] - outside_pos),
            )
            best = path_lengths.argmin(axis=1)
            rows = np.arange(len(pos))
            direction = np.where((pushed > 1.0)[:, None], outside_pos, points[rows, best]) - pos
            bearing[batch] = np.arctan2(direction[:, 1], direction[:, 0])
            length[batch] = path_lengths[rows, best] + 2.0 * pushed
        return bearing, length


def build_obstacle_paths(scenes: list[Scene]) -> ObstaclePaths:
    """Compute the part that is independent of the goals, once for each town."""
    expanded = [s.boxes_m + CLEARANCE_M * np.array([-1.0, -1.0, 1.0, 1.0]) for s in scenes]
    most = max(1, *(len(g) for g in expanded))
    nowhere = np.array([NO_PATH_M, NO_PATH_M, NO_PATH_M + 1.0, NO_PATH_M + 1.0])
    boxes = np.stack([np.concatenate([g, np.tile(nowhere, (most - len(g), 1))]) for g in expanded])
    corners = _offset_box_corners(boxes)
    between = np.empty((len(scenes), corners.shape[1], corners.shape[1]))
    for k, (points, town_boxes) in enumerate(zip(corners, boxes, strict=True)):
        segments_m = _unobstructed_segment_lengths_m(points, points[None], town_boxes[None])
        between[k] = dijkstra(np.where(segments_m < NO_PATH_M, segments_m, 0.0), directed=False)
    return ObstaclePaths(boxes, corners, np.minimum(between, NO_PATH_M))


def _offset_box_corners(boxes: Floats) -> Floats:
    """Return corners just outside the boxes, (S, 4 B, 2). Covered corners are moved far away."""
    south, west, north, east = np.moveaxis(boxes, -1, 0)
    low, high = (
        (south - CORNER_OFFSET_M, west - CORNER_OFFSET_M),
        (north + CORNER_OFFSET_M, east + CORNER_OFFSET_M),
    )
    corners = np.concatenate(
        [np.stack([n, e], axis=-1) for n in (low[0], high[0]) for e in (low[1], high[1])], axis=1
    )
    within = (corners[:, :, None] > boxes[:, None, :, :2]) & (
        corners[:, :, None] < boxes[:, None, :, 2:]
    )
    covered: Bools = np.asarray(np.any(np.all(within, axis=-1), axis=-1))
    return np.where(covered[..., None], 2.0 * NO_PATH_M, corners)


def _norms(vectors: Floats) -> Floats:
    return np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2)


def _unobstructed_segment_lengths_m(start: Floats, ends: Floats, boxes: Floats) -> Floats:
    """Return lengths (A, C) of straight legs from start (A, 2) to ends (A or 1, C, 2).

    A leg is cut if its parts between a box's two pairs of sides overlap (slab method).
    """
    paths = ends - start[:, None]
    step = np.where(np.abs(paths) < 1e-9, 1e-9, paths).astype(np.float32)
    low = (boxes[..., :2] - start[:, None]).astype(np.float32)  # (A, B, 2)
    high = (boxes[..., 2:] - start[:, None]).astype(np.float32)
    enter = np.zeros((*paths.shape[:2], boxes.shape[1]), np.float32)
    leave = np.ones_like(enter)
    for k in range(2):
        share = np.float32(1.0) / step[..., k, None]
        one, other = low[:, None, :, k] * share, high[:, None, :, k] * share
        np.maximum(enter, np.minimum(one, other), out=enter)
        np.minimum(leave, np.maximum(one, other), out=leave)
    cut: Bools = np.asarray(np.any(enter < leave, axis=-1))
    length = _norms(paths)
    return np.where(cut | (length >= 0.5 * NO_PATH_M), NO_PATH_M, length)


def _nearest_points_outside_boxes(pos: Floats, boxes: Floats) -> tuple[Floats, Floats]:
    """Return the nearest position outside the grown box around a drone, and its distance."""
    inside_depth = np.minimum(pos[:, None] - boxes[..., :2], boxes[..., 2:] - pos[:, None])
    inside: Bools = np.asarray(inside_depth.min(axis=-1) > 0.0)
    which = inside.argmax(axis=1)
    rows = np.arange(len(pos))
    box = boxes[rows, which]
    side_depths = np.concatenate([pos - box[:, :2], box[:, 2:] - pos], axis=1)
    side = side_depths.argmin(axis=1)
    least = np.where(inside[rows, which], side_depths[rows, side] + CORNER_OFFSET_M, 0.0)
    outside_pos = pos.copy()
    outside_pos[rows, side % 2] += np.where(side < 2, -least, least)
    return outside_pos, least
