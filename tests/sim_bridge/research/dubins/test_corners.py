"""Rounded corners: in the graph's missions (trochoids) and in waypoint routes."""

import math

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Obstacle, ObstacleMap, horizontal_distance_m
from companion.core.routing.smooth_route import (
    arc_at_corner,
    max_route_turn_rad,
    round_clear_corners,
)
from sim_bridge.research.dubins.corners import (
    round_corners,
    stop_and_yaw_time_loss_s,
    unrounded_corner_time_loss_s,
)
from sim_bridge.research.dubins.level_paths import FlightLimits

LIMITS = FlightLimits(15.0, 60.0)
ROOM = np.array([400.0])


def corner(turn_rad, wind=(0.0, 0.0), room=ROOM):
    course = np.zeros(1)
    return round_corners(course, course + turn_rad, room, room, LIMITS, np.array([wind], float))


@pytest.mark.parametrize("degrees", [10.0, 45.0, 90.0, -120.0])
def test_a_corner_in_calm_air_is_the_circle_that_touches_both_legs(degrees):
    turn = math.radians(degrees)
    cut = corner(turn)
    tangent = 60.0 * math.tan(abs(turn) / 2)
    assert cut.before_m[0] == pytest.approx(tangent, rel=1e-9)
    assert cut.after_m[0] == pytest.approx(tangent, rel=1e-9)
    assert cut.extra_s[0] == pytest.approx((60.0 * abs(turn) - 2 * tangent) / 15.0, abs=1e-9)
    assert cut.off_m[0] == pytest.approx(60.0 / math.cos(turn / 2) - 60.0, rel=1e-6)
    assert cut.turn_rad[0] == pytest.approx(min(abs(turn), 2.0 * 15.0 / 60.0))


def test_a_corner_in_wind_leaves_one_leg_and_meets_the_other():
    wind = np.array([4.0, -6.0])
    turn = math.radians(80.0)
    cut = corner(turn, wind)
    # Independent integration: from the first leg, hold its crab, turn at V / R to the second's.
    crab = [math.asin(float(w) / 15.0) for w in (wind[1], wind[1] * 0 + _across(wind, turn))]
    heading, end = -crab[0], turn - crab[1]
    place, dt = np.array([-cut.before_m[0], 0.0]), 1e-4
    steps = round((end - heading) / (15.0 / 60.0 * dt))
    for step in range(steps):
        now = heading + (step + 0.5) * 15.0 / 60.0 * dt
        place += (15.0 * np.array([math.cos(now), math.sin(now)]) + wind) * dt
    goal = cut.after_m[0] * np.array([math.cos(turn), math.sin(turn)])
    assert place == pytest.approx(goal, abs=0.02)


def _across(wind, course):
    return wind[1] * math.cos(course) - wind[0] * math.sin(course)


def test_a_corner_without_room_takes_longer_and_still_turns_no_faster():
    tight = corner(math.radians(150.0), room=np.array([80.0]))
    assert not tight.cut[0]
    assert tight.extra_s[0] > 5.0
    assert tight.turn_rad[0] <= 2.0 * 15.0 / 60.0 + 1e-9


def test_stopping_to_turn_costs_what_it_costs_a_leg():
    # A reversal loses and regains all speed: V / a. A hover there also turns at V / R.
    assert unrounded_corner_time_loss_s(np.array([math.pi]), 15.0, 2.5) == pytest.approx(6.0)
    assert stop_and_yaw_time_loss_s(np.array([math.pi]), LIMITS, 2.5) == pytest.approx(
        6.0 + 4 * math.pi
    )


def test_a_rounded_waypoint_stays_within_its_tolerance():
    arc = arc_at_corner((-200.0, 0.0, -40.0), (0.0, 0.0, -40.0), (0.0, 300.0, -40.0), 15.0)
    assert arc is not None
    assert arc.offset_m <= 15.0 + 1e-9
    assert min(horizontal_distance_m(p, (0.0, 0.0, 0.0)) for p in arc.points) >= arc.offset_m - 1e-9
    apart = [horizontal_distance_m(a, b) for a, b in zip(arc.points, arc.points[1:], strict=False)]
    assert min(apart) > 18.0  # PX4's acceptance radius is 10 m: closer waypoints coincide


def test_a_smooth_route_turns_less_at_once_and_keeps_its_ends():
    route = [(0.0, 0.0, -40.0), (300.0, 0.0, -40.0), (300.0, 300.0, -40.0), (0.0, 500.0, -40.0)]
    smooth = round_clear_corners(route, 15.0, ObstacleMap((), 15.0, 8.0))
    assert (smooth[0], smooth[-1]) == (route[0], route[-1])
    assert max_route_turn_rad(smooth) < 0.6 * max_route_turn_rad(route)


def test_a_corner_whose_arc_would_come_near_a_building_stays():
    route = [(0.0, 0.0, -40.0), (300.0, 0.0, -40.0), (300.0, 300.0, -40.0)]
    corner_m = 300.0 - 25.0
    shop = Obstacle("shop", tuple((corner_m + n, 25.0 + e) for n, e in
                                  ((0, 0), (-5, 0), (-5, 5), (0, 5))), 60.0)  # fmt: skip
    blocked = ObstacleMap((shop,), 15.0, 8.0)
    assert blocked.first_blocking_obstacle(route[0], route[1]) is None
    assert round_clear_corners(route, 30.0, blocked) == route
    with pytest.raises(LeewayError, match="corner tolerance"):
        round_clear_corners(route, 0.0, blocked)
