"""Set-points and mission items of a path, against its own kinematics and flat geometry."""

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely

from companion.core.base.errors import LeewayError
from sim_bridge.research.dubins.airplane import join_poses
from sim_bridge.research.dubins.limits import FlightLimits
from sim_bridge.research.dubins.sampling import mission_points, set_points

LIMITS = FlightLimits(15.0, 60.0)
WIND = np.array([3.0, -5.0])
POSES = np.array(
    [[0.0, 0.0, -40.0, 0.5], [300.0, 200.0, -60.0, 2.0], [100.0, 500.0, -50.0, 4.0]]
)  # fmt: skip


@pytest.fixture
def legs():
    return join_poses(POSES[:-1], POSES[1:], LIMITS, WIND)


def test_set_points_come_at_a_steady_rate_through_every_pose(legs):
    points = set_points(legs, 0.1)
    assert np.diff(points.t_s)[:-1] == pytest.approx(0.1, abs=1e-9)
    assert points.t_s[-1] == pytest.approx(legs.time_s.sum())
    assert points.pos_ned_m[0] == pytest.approx(POSES[0, :3])
    assert points.pos_ned_m[-1] == pytest.approx(POSES[-1, :3], abs=1e-6)


def test_the_velocity_of_set_points_is_how_their_places_change(legs):
    points = set_points(legs, 0.05)
    moved = np.diff(points.pos_ned_m, axis=0)[:-1] / 0.05
    middle = 0.5 * (points.vel_ned_mps[:-2] + points.vel_ned_mps[1:-1])
    # A climb rate or turn that changes between two set-points is off by a step at most.
    off = np.linalg.norm(moved - middle, axis=1)
    assert np.quantile(off, 0.97) < 0.02
    air = points.vel_ned_mps[:, :2] - WIND
    level = np.hypot(air[:, 0], air[:, 1])
    assert np.hypot(level, points.vel_ned_mps[:, 2]) == pytest.approx(15.0, abs=1e-6)


@pytest.mark.parametrize("accept_m", [2.0, 10.0])
def test_items_stand_apart_end_at_the_goal_and_keep_to_the_path(legs, accept_m):
    items = mission_points(legs, accept_m)
    assert items[-1] == pytest.approx(tuple(POSES[-1, :3]), abs=1e-6)
    assert min(math.dist(a[:2], b[:2]) for a, b in pairwise(items)) >= 2.0 * accept_m
    flown = shapely.LineString(set_points(legs, 0.05).pos_ned_m[:, :2])
    line = shapely.LineString([(0.0, 0.0), *[p[:2] for p in items]])
    # A chord leaves an arc by L^2 / 8 r: at most one turn's step and what stood too near to count,
    # carried by the wind, on the tightest curve over the ground (flying straight into the wind).
    wind_mps, rate = float(np.hypot(*WIND)), 15.0 / 60.0
    chord_m = 2.0 * accept_m + 60.0 * math.radians(15.0) * (1.0 + wind_mps / 15.0)
    tightest_m = (15.0 - wind_mps) ** 2 / (rate * 15.0)
    assert line.hausdorff_distance(flown) < chord_m**2 / (8.0 * tightest_m)


def test_a_rate_or_radius_of_nothing_is_refused(legs):
    with pytest.raises(LeewayError, match="period_s"):
        set_points(legs, 0.0)
    with pytest.raises(LeewayError, match="accept_radius_m"):
        mission_points(legs, math.nan)
