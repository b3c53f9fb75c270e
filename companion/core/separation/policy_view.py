"""Observation of the learned actor in flight, and its action as a velocity (paper, IV-B).

The view (docs/explanation/avoidance.md) has 155 x 155 cells of 2 m around the vehicle, with the
direction to the goal up. Channels: obstacles, neighbours, neighbours' goals. It must equal the view
of the training; a test compares it with the training environment's.
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
class Surroundings:
    """Surroundings in the local frame; `truck` only for a return to it; `goals`: neighbours'."""

    here: Ne
    goal: Ne
    truck: Ne | None
    neighbours: Sequence[Ne]
    goals: Sequence[Ne]
    obstacles: Sequence[shapely.Geometry]

    @property
    def bearing_to_goal_rad(self) -> float:
        """Bearing of the view's up direction."""
        return math.atan2(self.goal[1] - self.here[1], self.goal[0] - self.here[0])


def render_view_and_goal_vectors(surroundings: Surroundings) -> tuple[Bytes, Singles]:
    """Return the actor's view (1, 3, 155, 155) and its two vectors (1, 4)."""
    view = np.zeros((1, 3, VIEW_CELLS, VIEW_CELLS), dtype=np.uint8)
    if surroundings.obstacles:
        view[0, 0] = _rasterize_obstacles(surroundings)
    _mark_points_in_channel_in_place(view[0, 1], surroundings, surroundings.neighbours)
    _mark_points_in_channel_in_place(view[0, 2], surroundings, surroundings.goals)
    truck = (
        _to_forward_right_m(surroundings, surroundings.truck)
        if surroundings.truck is not None
        else (0.0, 0.0)
    )
    vectors = np.array(
        [[*_to_forward_right_m(surroundings, surroundings.goal), *truck]], dtype=np.float32
    )
    return view, vectors


def desired_ground_velocity_ne_mps(policy: AvoidancePolicy, surroundings: Surroundings) -> Floats:
    """Return the actor's desired ground velocity (north, east) for the next two seconds."""
    heading, speed = (
        float(x)
        for x in policy.heading_and_speed_actions(*render_view_and_goal_vectors(surroundings))[0]
    )
    course = surroundings.bearing_to_goal_rad + math.pi * min(max(heading, -1.0), 1.0)
    flown = 0.5 * (min(max(speed, -1.0), 1.0) + 1.0) * MAX_SPEED_MPS
    return np.array([flown * math.cos(course), flown * math.sin(course)])


def _to_forward_right_m(surroundings: Surroundings, point: Ne) -> Ne:
    """Return a point in view coordinates: up and right of the vehicle, metres."""
    north, east = point[0] - surroundings.here[0], point[1] - surroundings.here[1]
    c, s = math.cos(surroundings.bearing_to_goal_rad), math.sin(surroundings.bearing_to_goal_rad)
    return c * north + s * east, -s * north + c * east


def _mark_points_in_channel_in_place(
    channel: Bytes, surroundings: Surroundings, points: Iterable[Ne]
) -> None:
    for point in points:
        forward, right = _to_forward_right_m(surroundings, point)
        row, column = round(MIDDLE - forward / CELL_M), round(MIDDLE + right / CELL_M)
        if not (-MARK_CELLS <= row < VIEW_CELLS + MARK_CELLS):
            continue
        if not (-MARK_CELLS <= column < VIEW_CELLS + MARK_CELLS):
            continue
        rows = slice(max(row - MARK_CELLS, 0), row + MARK_CELLS + 1)
        columns = slice(max(column - MARK_CELLS, 0), column + MARK_CELLS + 1)
        channel[rows, columns] = 1


def _rasterize_obstacles(surroundings: Surroundings) -> Bools:
    span = (np.arange(VIEW_CELLS) - MIDDLE) * CELL_M
    up, right = np.meshgrid(-span, span, indexing="ij")
    c, s = math.cos(surroundings.bearing_to_goal_rad), math.sin(surroundings.bearing_to_goal_rad)
    north = surroundings.here[0] + c * up - s * right
    east = surroundings.here[1] + s * up + c * right
    found = np.zeros((VIEW_CELLS, VIEW_CELLS), dtype=bool)
    for obstacle in surroundings.obstacles:
        near = _rows_and_columns_covering_obstacle(surroundings, obstacle)
        found[near] |= shapely.contains_xy(obstacle, north[near], east[near])
    return found


def _rows_and_columns_covering_obstacle(
    surroundings: Surroundings, obstacle: shapely.Geometry
) -> tuple[slice, slice]:
    """Return rows and columns that cover an obstacle: a few of the view's 24,025 cells."""
    points = shapely.get_coordinates(obstacle) - surroundings.here
    if not len(points):
        return slice(0), slice(0)
    c, s = math.cos(surroundings.bearing_to_goal_rad), math.sin(surroundings.bearing_to_goal_rad)
    rows = MIDDLE - (points @ [c, s]) / CELL_M
    columns = MIDDLE + (points @ [-s, c]) / CELL_M
    return _slice_covering_indices(rows), _slice_covering_indices(columns)


def _slice_covering_indices(cell_indices: Floats) -> slice:
    return slice(max(math.floor(cell_indices.min()), 0), max(math.ceil(cell_indices.max()) + 1, 0))
