"""The learned actor's observation in flight, and its action as a velocity (paper, IV-B).

The view (docs/explanation/avoidance.md): 155 x 155 cells of 2 m about the vehicle, with the
direction to the goal up. Channels: obstacles, neighbours, neighbours' goals. It must be what the
actor was trained on: a test holds it against the training environment's own.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from companion.core.base.arrays import Bools, Bytes, Floats, Singles
from companion.core.separation.learned_policy import VIEW_CELLS, AvoidancePolicy

Ne = tuple[float, float]

CELL_M = 2.0
MARK_CELLS = 1  # a neighbour or a goal is a square of 3 x 3 cells
MIDDLE = VIEW_CELLS // 2
MAX_SPEED_MPS = 15.0
DECISION_S = 2.0


@dataclass(frozen=True, slots=True)
class Around:
    """What is near, north and east about the frame's origin; `truck`: who returns to it."""

    here: Ne
    goal: Ne
    truck: Ne | None
    neighbours: Sequence[Ne]
    goals: Sequence[Ne]
    obstacles: Sequence[shapely.Geometry]

    @property
    def up_rad(self) -> float:
        """The bearing that is up."""
        return math.atan2(self.goal[1] - self.here[1], self.goal[0] - self.here[0])


def view_of(around: Around) -> tuple[Bytes, Singles]:
    """The actor's view (1, 3, 155, 155) and its two vectors (1, 4)."""
    view = np.zeros((1, 3, VIEW_CELLS, VIEW_CELLS), dtype=np.uint8)
    if around.obstacles:
        view[0, 0] = _obstacles(around)
    _mark(view[0, 1], around, around.neighbours)
    _mark(view[0, 2], around, around.goals)
    truck = _turned(around, around.truck) if around.truck is not None else (0.0, 0.0)
    vectors = np.array([[*_turned(around, around.goal), *truck]], dtype=np.float32)
    return view, vectors


def wish_of(policy: AvoidancePolicy, around: Around) -> Floats:
    """The velocity over ground (north, east) that the actor wishes for the next two seconds."""
    heading, speed = (float(x) for x in policy.act(*view_of(around))[0])
    course = around.up_rad + math.pi * min(max(heading, -1.0), 1.0)
    flown = 0.5 * (min(max(speed, -1.0), 1.0) + 1.0) * MAX_SPEED_MPS
    return np.array([flown * math.cos(course), flown * math.sin(course)])


def _turned(around: Around, point: Ne) -> Ne:
    """A point as seen from here: up and right, metres."""
    north, east = point[0] - around.here[0], point[1] - around.here[1]
    c, s = math.cos(around.up_rad), math.sin(around.up_rad)
    return c * north + s * east, -s * north + c * east


def _mark(channel: Bytes, around: Around, points: Iterable[Ne]) -> None:
    for point in points:
        ahead, right = _turned(around, point)
        row, column = round(MIDDLE - ahead / CELL_M), round(MIDDLE + right / CELL_M)
        if not (-MARK_CELLS <= row < VIEW_CELLS + MARK_CELLS):
            continue
        if not (-MARK_CELLS <= column < VIEW_CELLS + MARK_CELLS):
            continue
        rows = slice(max(row - MARK_CELLS, 0), row + MARK_CELLS + 1)
        columns = slice(max(column - MARK_CELLS, 0), column + MARK_CELLS + 1)
        channel[rows, columns] = 1


def _obstacles(around: Around) -> Bools:
    span = (np.arange(VIEW_CELLS) - MIDDLE) * CELL_M
    up, right = np.meshgrid(-span, span, indexing="ij")
    c, s = math.cos(around.up_rad), math.sin(around.up_rad)
    north = around.here[0] + c * up - s * right
    east = around.here[1] + s * up + c * right
    found = np.zeros((VIEW_CELLS, VIEW_CELLS), dtype=bool)
    for obstacle in around.obstacles:
        near = _window(around, obstacle)
        found[near] |= shapely.contains_xy(obstacle, north[near], east[near])
    return found


def _window(around: Around, obstacle: shapely.Geometry) -> tuple[slice, slice]:
    """The rows and columns that hold all of an obstacle: a few of the view's 24,025 cells."""
    points = shapely.get_coordinates(obstacle) - around.here
    if not len(points):
        return slice(0), slice(0)
    c, s = math.cos(around.up_rad), math.sin(around.up_rad)
    rows = MIDDLE - (points @ [c, s]) / CELL_M
    columns = MIDDLE + (points @ [-s, c]) / CELL_M
    return _span(rows), _span(columns)


def _span(cells: Floats) -> slice:
    return slice(max(math.floor(cells.min()), 0), max(math.ceil(cells.max()) + 1, 0))
