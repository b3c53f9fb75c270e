"""The actor's observation in flight is that of training: two programs, one raster."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

from companion.core.separation.policy_view import Surroundings, render_view_and_goal_vectors
from sim_bridge.research.avoidance.environment import observe_all_agents
from sim_bridge.research.avoidance.scenes import CELL_M, raster_cell_indices


def trained_on(seed, obstacle_ne_m) -> Any:
    """Six drones about a town of one building, as the training environment sees them."""
    rng = np.random.default_rng(seed)
    pos = np.concatenate([rng.uniform(-120, 120, (1, 6, 2)), np.zeros((1, 6, 1))], axis=-1)
    goal = rng.uniform(-150, 150, (1, 6, 2))
    away = goal - pos[..., :2]
    raster = np.zeros((1, 420, 420), dtype=np.uint8)
    if obstacle_ne_m is not None:
        low, high = (raster_cell_indices(np.array(corner)) for corner in obstacle_ne_m)
        raster[0, low[0] : high[0], low[1] : high[1]] = 1
    return SimpleNamespace(
        active=np.ones((1, 6), dtype=bool),
        agents=6,
        pos_m=pos,
        goal_ne_m=goal,
        truck_ne_m=np.array([[10.0, -20.0]]),
        returning=np.array([[True, False] * 3]),
        scene_of=np.zeros(1, dtype=np.int64),
        obstacle_rasters=raster,
        delayed_reported_pos_and_vel=lambda: (pos, np.zeros_like(pos)),
        goal_bearing_rad_and_distance_m=lambda: (
            np.arctan2(away[..., 1], away[..., 0]),
            np.linalg.norm(away, axis=-1),
        ),
    )


@pytest.mark.parametrize("seed", [1, 2])
def test_view_and_vectors_are_the_training_environments(seed):
    corners = ((20.0, -60.0), (60.0, -10.0))
    world = trained_on(seed, corners)
    seen = observe_all_agents(world)
    for i in range(6):
        others = [j for j in range(6) if j != i]
        around = Surroundings(
            tuple(world.pos_m[0, i, :2]),
            tuple(world.goal_ne_m[0, i]),
            tuple(world.truck_ne_m[0]) if world.returning[0, i] else None,
            [tuple(world.pos_m[0, j, :2]) for j in others],
            [tuple(world.goal_ne_m[0, j]) for j in others],
            [shapely.box(corners[0][0], corners[0][1], corners[1][0], corners[1][1])],
        )
        view, vectors = render_view_and_goal_vectors(around)
        assert np.array_equal(view[0, 1:], seen.view[0, i, 1:])
        assert vectors[0] == pytest.approx(seen.vectors_m[0, i], abs=1e-3)
        # Buildings are rasters there and outlines here: cells on the outline may differ.
        differ = int((view[0, 0] != seen.view[0, i, 0]).sum())
        outline_cells = 2 * (40.0 + 50.0) / CELL_M
        assert differ <= 2 * outline_cells
        assert view[0, 0].any() == seen.view[0, i, 0].any()
