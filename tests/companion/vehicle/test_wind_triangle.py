"""The wind triangle against its closed forms."""

import numpy as np
import pytest

from companion.core.vehicle.wind_triangle import (
    airspeeds_for_ground_speed_mps,
    ground_speeds_mps,
)


@pytest.mark.parametrize(
    ("tailwind_mps", "crosswind_mps", "ground_mps"),
    [(0.0, 0.0, 10.0), (4.0, 0.0, 14.0), (-4.0, 0.0, 6.0), (0.0, 6.0, 8.0)],
)
def test_ground_speed_at_10_mps_is_the_textbooks(tailwind_mps, crosswind_mps, ground_mps) -> None:
    # Head- and tailwind add; 6 m/s across leaves sqrt(100 - 36) = 8.
    found = ground_speeds_mps(10.0, np.array([tailwind_mps]), np.array([crosswind_mps]))
    assert found == pytest.approx([ground_mps])


@pytest.mark.parametrize("wind", [(3.0, 10.5), (-10.0, 0.0), (-12.0, 0.0)])
def test_a_cross_wind_over_the_airspeed_or_no_ground_speed_is_infeasible(wind) -> None:
    along, across = (np.array([one]) for one in wind)
    assert np.isnan(ground_speeds_mps(10.0, along, across))


def test_air_velocity_is_ground_velocity_less_wind_in_three_dimensions() -> None:
    rng = np.random.default_rng(3)
    directions, winds = rng.normal(size=(200, 3)), rng.normal(0.0, 4.0, (200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    along = (winds * directions).sum(axis=1)
    across = np.linalg.norm(np.cross(winds, directions), axis=1)
    ground = ground_speeds_mps(12.0, along, across)
    is_feasible = np.isfinite(ground)
    assert is_feasible.sum() > 100
    air = ground[:, None] * directions - winds
    np.testing.assert_allclose(np.linalg.norm(air, axis=1)[is_feasible], 12.0)


def test_the_airspeed_needed_undoes_the_ground_speed() -> None:
    along, across = np.array([-5.0, 0.0, 6.0]), np.array([3.0, -8.0, 1.0])
    ground = ground_speeds_mps(11.0, along, across)
    np.testing.assert_allclose(airspeeds_for_ground_speed_mps(ground, along, across), 11.0)
