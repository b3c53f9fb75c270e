"""The wind triangle against its closed forms."""

import math

import numpy as np
import pytest

from companion.core.vehicle.wind_triangle import (
    Infeasible,
    WindTriangle,
    airspeeds_for_ground_speed_mps,
    ground_speeds_mps,
    solve_level_wind_triangle,
    solve_wind_triangle_3d,
)


@pytest.mark.parametrize(
    ("wind_to_ne", "ground"),
    [((0.0, 0.0), 10.0), ((4.0, 0.0), 14.0), ((-4.0, 0.0), 6.0), ((0.0, 6.0), 8.0)],
)
def test_ground_speed_north_at_10_mps_is_the_textbooks(wind_to_ne: tuple, ground: float) -> None:
    # Head- and tailwind add; 6 m/s across leaves sqrt(100 - 36) = 8.
    track = solve_level_wind_triangle(0.0, 10.0, wind_to_ne)
    assert isinstance(track, WindTriangle)
    assert track.ground_speed_mps == pytest.approx(ground)


def test_the_nose_points_into_a_cross_wind() -> None:
    # Wind from the west pushes east: flying north it heads asin(6/10) west of north.
    track = solve_level_wind_triangle(0.0, 10.0, (0.0, 6.0))
    assert isinstance(track, WindTriangle)
    assert track.air_heading_rad == pytest.approx(2.0 * math.pi - math.asin(0.6))


def test_a_cross_wind_over_the_airspeed_is_infeasible_and_says_so() -> None:
    track = solve_level_wind_triangle(0.0, 10.0, (3.0, 10.5))
    assert isinstance(track, Infeasible)
    assert "cross-wind 10.5" in track.reason


@pytest.mark.parametrize("headwind", [10.0, 12.0])
def test_no_ground_speed_is_infeasible_and_says_so(headwind: float) -> None:
    track = solve_level_wind_triangle(math.pi, 10.0, (headwind, 0.0))
    assert isinstance(track, Infeasible)
    assert "headwind" in track.reason


def test_air_velocity_is_ground_velocity_less_wind_in_three_dimensions() -> None:
    direction = np.array([3.0, 1.0, -0.8])
    wind = np.array([-2.0, 3.0, 0.5])
    track = solve_wind_triangle_3d(direction, 12.0, wind)
    assert isinstance(track, WindTriangle)
    air = track.ground_speed_mps * direction / np.linalg.norm(direction) - wind
    assert np.linalg.norm(air) == pytest.approx(12.0)
    assert track.air_path_angle_rad == pytest.approx(math.asin(-air[2] / 12.0))
    assert track.air_heading_rad == pytest.approx(math.atan2(air[1], air[0]) % (2 * math.pi))


def test_flight_path_limits_hold_in_the_air_frame_not_over_the_ground() -> None:
    # 10 degrees over ground with 8 m/s of tailwind: the air sees less distance, so it is steeper.
    direction = np.array([math.cos(0.1745), 0.0, -math.sin(0.1745)])
    limit = math.radians(12.0)
    calm = solve_wind_triangle_3d(direction, 12.0, np.zeros(3), -limit, limit)
    tail = solve_wind_triangle_3d(direction, 12.0, np.array([8.0, 0.0, 0.0]), -limit, limit)
    assert isinstance(calm, WindTriangle)
    assert calm.air_path_angle_rad == pytest.approx(0.1745)
    assert isinstance(tail, Infeasible)
    assert "in the air" in tail.reason


def test_the_array_form_agrees_with_the_scalar_one() -> None:
    rng = np.random.default_rng(3)
    along, across = rng.normal(0.0, 7.0, (2, 200))
    ground = ground_speeds_mps(10.0, along, across)
    for one, w_par, w_perp in zip(ground, along, across, strict=True):
        track = solve_level_wind_triangle(0.0, 10.0, (w_par, w_perp))
        if isinstance(track, Infeasible):
            assert np.isnan(one)
        else:
            assert one == pytest.approx(track.ground_speed_mps)


def test_the_airspeed_needed_undoes_the_ground_speed() -> None:
    along, across = np.array([-5.0, 0.0, 6.0]), np.array([3.0, -8.0, 1.0])
    ground = ground_speeds_mps(11.0, along, across)
    np.testing.assert_allclose(airspeeds_for_ground_speed_mps(ground, along, across), 11.0)
