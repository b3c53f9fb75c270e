"""Towns for the episodes: street grids of boxes as rasters, and the drones' starts and goals.

Buildings higher than the flight are obstacles. Rasters are north by east, one cell of `CELL_M`,
with a margin as wide as the field of view, so that every view is a slice.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from companion.core.base.arrays import Floats

CELL_M = 2.0  # the paper has 155 x 155 cells without a size; 2 m shows 155 m to each side
VIEW_CELLS = 155
MARGIN_CELLS = 112  # half a view's diagonal
HALF_SIDE_M = 400.0
FLIGHT_HEIGHT_M = 45.0
BLOCK_M = 110.0
OCCUPIED_SHARE = 0.75
HEIGHTS_M = (12.0, 70.0)  # as sim_bridge.research.tables.urban_scene
START_SPACING_M = 35.0  # airborne slots: the filter needs a start without conflict
GOAL_FREE_M = 25.0  # distance from starts and goals to the nearest building
TRUCK_SLOTS_M = (40.0, 120.0)  # where the policy takes over a drone launched from the truck
CUSTOMERS_M = (150.0, 380.0)
MAX_TRIES = 4000


@dataclass(frozen=True)
class Scene:
    """Obstacle raster, metres to the next obstacle at each cell, the boxes, and the truck."""

    obstacle: NDArray[np.uint8]
    clearance_m: NDArray[np.float32]
    boxes_m: Floats  # (B, 4): south, west, north, east
    truck_ne_m: Floats


@dataclass(frozen=True)
class DroneLayout:
    """Start and goal of each agent, (N, 2), and which agents return to the truck."""

    start_ne_m: Floats
    goal_ne_m: Floats
    returning: NDArray[np.bool_]


def raster_cell_indices(points_m: Floats) -> NDArray[np.int64]:
    """Return the raster indices of points (north, east), clipped to the raster."""
    side = int(2 * HALF_SIDE_M / CELL_M) + 2 * MARGIN_CELLS
    cells = np.floor((points_m + HALF_SIDE_M) / CELL_M).astype(np.int64) + MARGIN_CELLS
    return np.clip(cells, 0, side - 1)


def draw_random_scene(random: np.random.Generator) -> Scene:
    """Draw a jittered grid of buildings around a free area for the truck."""
    truck = random.uniform(-60.0, 60.0, 2)
    boxes = []
    blocks = int(2 * HALF_SIDE_M / BLOCK_M)
    for i in range(blocks):
        for j in range(blocks):
            low, high = HEIGHTS_M
            height = low + (high - low) * random.beta(1.2, 2.0)
            centre = (np.array([i, j]) + 0.5 + random.uniform(-0.1, 0.1, 2)) * BLOCK_M - HALF_SIDE_M
            half = random.uniform(0.15, 0.33, 2) * BLOCK_M
            box = np.array([*(centre - half), *(centre + half)])
            occupied = random.random() < OCCUPIED_SHARE and height + 5.0 > FLIGHT_HEIGHT_M
            away = np.maximum(np.maximum(box[:2] - truck, truck - box[2:]), 0.0)
            if occupied and float(np.linalg.norm(away)) > TRUCK_SLOTS_M[0]:
                boxes.append(box)
    side = int(2 * HALF_SIDE_M / CELL_M) + 2 * MARGIN_CELLS
    obstacle = np.zeros((side, side), dtype=np.uint8)
    for box in boxes:
        (south, west), (north, east) = raster_cell_indices(box[:2]), raster_cell_indices(box[2:])
        obstacle[south : north + 1, west : east + 1] = 1
    # A cell's centre is within 0.71 cells of its points, and an obstacle cell's of its walls.
    clearance = np.asarray(distance_transform_edt(1 - obstacle)) * CELL_M - 1.42 * CELL_M
    return Scene(obstacle, clearance.astype(np.float32), np.array(boxes).reshape(-1, 4), truck)


def draw_drone_starts_and_goals(
    scene: Scene, drone_count: int, random: np.random.Generator
) -> DroneLayout:
    """Draw separated starts: half of the drones leave the truck, the other half return to it."""
    returning = np.arange(drone_count) % 2 == 1
    start_points, goals = np.empty((drone_count, 2)), np.empty((drone_count, 2))
    for i in range(drone_count):
        ring = CUSTOMERS_M if returning[i] else TRUCK_SLOTS_M
        start_points[i] = _draw_position(scene, ring, start_points[:i], random)
        goals[i] = (
            scene.truck_ne_m
            if returning[i]
            else _draw_position(scene, CUSTOMERS_M, goals[:0], random)
        )
    return DroneLayout(start_points, goals, returning)


def _draw_position(
    scene: Scene,
    ring_m: tuple[float, float],
    existing_points_m: Floats,
    random: np.random.Generator,
) -> Floats:
    for _ in range(MAX_TRIES):
        angle, away = random.uniform(0.0, 2.0 * np.pi), random.uniform(*ring_m)
        point = scene.truck_ne_m + away * np.array([np.cos(angle), np.sin(angle)])
        row, column = raster_cell_indices(point)
        inside = np.abs(point).max() < HALF_SIDE_M - 20.0
        free = scene.clearance_m[row, column] > GOAL_FREE_M
        if (
            inside
            and free
            and (np.linalg.norm(existing_points_m - point, axis=1) > START_SPACING_M).all()
        ):
            return point
    raise ValueError(
        f"no free position {ring_m} m from the truck after {len(existing_points_m)} drones"
    )
