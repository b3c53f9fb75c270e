"""Towns to fly in: street grids of boxes as rasters, and the starts and goals of the drones.

What stands higher than the flight is an obstacle. Rasters are north by east, one cell of `CELL_M`,
with a margin as wide as the field of view, so that every view is a slice.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from companion.core.base.arrays import Floats

CELL_M = 2.0  # the paper gives 155 x 155 cells and no size; at 2 m it sees 155 m each way
VIEW_CELLS = 155
MARGIN_CELLS = 112  # half a view's diagonal
HALF_SIDE_M = 400.0
FLIGHT_HEIGHT_M = 45.0
BLOCK_M = 110.0
BUILT_SHARE = 0.75
HEIGHTS_M = (12.0, 70.0)  # as sim_bridge.research.tables.urban_scene
START_SPACING_M = 35.0  # air-borne slots: the filter starts from what is certain
GOAL_FREE_M = 25.0  # about starts and goals no building stands
TRUCK_SLOTS_M = (40.0, 120.0)  # where who leaves the truck takes over from its launch slot
CUSTOMERS_M = (150.0, 380.0)
TOO_MANY_TRIES = 4000


@dataclass(frozen=True)
class Scene:
    """Obstacle raster, metres to the next obstacle at each cell, the boxes, and the truck."""

    obstacle: NDArray[np.uint8]
    clearance_m: NDArray[np.float32]
    boxes_m: Floats  # (B, 4): south, west, north, east
    truck_ne_m: Floats


@dataclass(frozen=True)
class Start:
    """Where each agent begins and ends; (N, 2), and who returns to the truck."""

    start_ne_m: Floats
    goal_ne_m: Floats
    returning: NDArray[np.bool_]


def cells_of(points_m: Floats) -> NDArray[np.int64]:
    """Raster indices of points north-east, kept inside the raster."""
    side = int(2 * HALF_SIDE_M / CELL_M) + 2 * MARGIN_CELLS
    cells = np.floor((points_m + HALF_SIDE_M) / CELL_M).astype(np.int64) + MARGIN_CELLS
    return np.clip(cells, 0, side - 1)


def make_scene(random: np.random.Generator) -> Scene:
    """A jittered grid of buildings about a free place where the truck stands."""
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
            built = random.random() < BUILT_SHARE and height + 5.0 > FLIGHT_HEIGHT_M
            if built and _away(box, truck) > TRUCK_SLOTS_M[0]:
                boxes.append(box)
    side = int(2 * HALF_SIDE_M / CELL_M) + 2 * MARGIN_CELLS
    obstacle = np.zeros((side, side), dtype=np.uint8)
    for box in boxes:
        (south, west), (north, east) = cells_of(box[:2]), cells_of(box[2:])
        obstacle[south : north + 1, west : east + 1] = 1
    # A cell's centre is within 0.71 cells of its points, and an obstacle cell's of its walls.
    clearance = np.asarray(distance_transform_edt(1 - obstacle)) * CELL_M - 1.42 * CELL_M
    return Scene(obstacle, clearance.astype(np.float32), np.array(boxes).reshape(-1, 4), truck)


def _away(box: Floats, point: Floats) -> float:
    return float(np.linalg.norm(np.maximum(np.maximum(box[:2] - point, point - box[2:]), 0.0)))


def draw_start(scene: Scene, agents: int, random: np.random.Generator) -> Start:
    """Half leave the truck for customers, half come back, from places apart from each other."""
    returning = np.arange(agents) % 2 == 1
    starts, goals = np.empty((agents, 2)), np.empty((agents, 2))
    for i in range(agents):
        ring = CUSTOMERS_M if returning[i] else TRUCK_SLOTS_M
        starts[i] = _place(scene, ring, starts[:i], random)
        goals[i] = (
            scene.truck_ne_m if returning[i] else _place(scene, CUSTOMERS_M, goals[:0], random)
        )
    return Start(starts, goals, returning)


def _place(
    scene: Scene, ring_m: tuple[float, float], taken: Floats, random: np.random.Generator
) -> Floats:
    for _ in range(TOO_MANY_TRIES):
        angle, away = random.uniform(0.0, 2.0 * np.pi), random.uniform(*ring_m)
        point = scene.truck_ne_m + away * np.array([np.cos(angle), np.sin(angle)])
        row, column = cells_of(point)
        inside = np.abs(point).max() < HALF_SIDE_M - 20.0
        free = scene.clearance_m[row, column] > GOAL_FREE_M
        if inside and free and (np.linalg.norm(taken - point, axis=1) > START_SPACING_M).all():
            return point
    raise ValueError(f"no free place {ring_m} m from the truck for one more of {len(taken)} drones")
