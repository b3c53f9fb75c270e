"""Safety rules 4 and 6: legs priced over ground, with the autopilots' actual speeds."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.core.routing.leg_energy import (
    LEAST_GROUND_SPEED_MPS,
    TOUCHDOWN_S,
    Leg,
    LegKind,
    RouteEnergy,
)
from companion.core.vehicle.power import level_airspeed_at_max_tilt_mps, multirotor_power_w

M100 = read_airframe("m100")
ROUTE = RouteEnergy(M100)
CALM = np.zeros((1, 2))
EAST = (0.0, 900.0, -40.0)
HERE = (0.0, 0.0, -40.0)


def cruise(a: tuple, b: tuple, payload: float = 0.0, ground: float | None = None) -> Leg:
    return Leg(LegKind.CRUISE, a, b, payload, ground_speed_mps=ground)


def one(leg: Leg, north: float, east: float) -> tuple[float, float, bool]:
    costs = ROUTE.leg_costs_wind_major((leg,), np.array([[north, east]]))
    return float(costs.energy_wh[0, 0]), float(costs.time_s[0, 0]), bool(costs.feasible[0, 0])


def level_w(airspeed: float, payload: float = 0.0) -> float:
    return float(multirotor_power_w(M100, M100.flying_mass_kg(payload), airspeed))


def test_a_fixed_ground_speed_in_headwind_is_flown_at_the_airspeed_it_takes() -> None:
    # 10 m/s over ground against 5 m/s: 90 s at the power of 15 m/s (power * time, by hand).
    energy, time, feasible = one(cruise(HERE, EAST, ground=10.0), 0.0, -5.0)
    assert time == pytest.approx(90.0, rel=1e-3)
    assert energy == pytest.approx(level_w(15.0) * 90.0 / 3600.0, rel=2e-3)
    assert feasible


def test_a_fixed_ground_speed_in_cross_wind_takes_the_hypotenuse() -> None:
    energy, time, _ = one(cruise(HERE, EAST, ground=8.0), 6.0, 0.0)
    assert time == pytest.approx(900.0 / 8.0, rel=1e-3)
    assert energy == pytest.approx(level_w(10.0) * time / 3600.0, rel=2e-3)


def test_safety_rule_6_tilt_saturates_and_ground_speed_falls() -> None:
    # As measured on both autopilots: commanded 10 m/s, made what the tilt limit leaves.
    top = level_airspeed_at_max_tilt_mps(M100, M100.flying_mass_kg(0.0))
    _, time, _ = one(cruise(HERE, EAST, ground=10.0), 0.0, -(top - 3.0))
    assert 900.0 / time == pytest.approx(3.0, abs=0.06)


def test_no_way_made_is_infeasible_and_dear_but_finite() -> None:
    top = level_airspeed_at_max_tilt_mps(M100, M100.flying_mass_kg(0.0))
    energy, time, feasible = one(cruise(HERE, EAST, ground=10.0), 0.0, -(top + 1.0))
    assert not feasible
    assert time == pytest.approx(900.0 / LEAST_GROUND_SPEED_MPS)
    assert math.isfinite(energy)
    _, _, across = one(cruise(HERE, EAST, ground=10.0), top + 1.0, 0.0)
    assert not across


def test_the_speed_to_fly_is_the_brute_force_best() -> None:
    top = 0.97 * level_airspeed_at_max_tilt_mps(M100, M100.flying_mass_kg(0.0))
    airspeed = np.linspace(7.0, top, 4000)
    power = multirotor_power_w(M100, M100.flying_mass_kg(0.0), airspeed)
    for north, east in ((0.0, 0.0), (3.0, -8.0), (-6.0, -12.0), (5.0, 2.0), (0.0, 6.0)):
        ground = np.sqrt(airspeed**2 - north**2) + east
        best = float((power / ground)[ground > 0.0].min()) * 900.0 / 3600.0
        energy, _, _ = one(cruise(HERE, EAST), north, east)
        assert energy == pytest.approx(best, rel=5e-3)


def test_the_cruise_rule_never_flies_slower_than_cruise_and_least_energy_does() -> None:
    at_cruise = RouteEnergy(M100, speed_rule="cruise")
    tailwind = np.array([0.0, 6.0])
    cruise_mps = M100.speeds.cruise_airspeed_mps
    leg = cruise(HERE, EAST)
    assert at_cruise.ground_speed_to_command_mps(leg, tailwind) == pytest.approx(
        cruise_mps + 6.0, abs=0.02
    )
    assert ROUTE.ground_speed_to_command_mps(leg, tailwind) < cruise_mps + 6.0 - 0.5
    cheapest = ROUTE.leg_costs_wind_major((leg,), tailwind[None, :]).energy_wh
    assert float(cheapest[0, 0]) < float(
        at_cruise.leg_costs_wind_major((leg,), tailwind[None, :]).energy_wh[0, 0]
    )
    faster = Leg(LegKind.CRUISE, HERE, EAST, 0.0, airspeed_mps=17.0)
    hurried = ROUTE.ground_speed_to_command_mps(faster, np.zeros(2))
    assert hurried == pytest.approx(17.0, abs=0.02)


def test_what_is_commanded_is_the_wind_triangles_ground_speed() -> None:
    airspeed = M100.speeds.cruise_airspeed_mps
    leg = Leg(LegKind.CRUISE, HERE, EAST, 0.0, airspeed_mps=airspeed)
    expected = math.sqrt(airspeed**2 - 9.0) + 4.0
    assert ROUTE.ground_speed_to_command_mps(leg, np.array([3.0, 4.0])) == pytest.approx(
        expected, abs=0.02
    )
    assert (
        ROUTE.ground_speed_to_command_mps(leg, np.array([0.0, 30.0])) == M100.speeds.max_ground_mps
    )
    assert (
        ROUTE.ground_speed_to_command_mps(cruise(HERE, EAST, ground=7.0), np.array([0.0, 3.0]))
        == 7.0
    )


def test_a_sloping_leg_is_flown_no_faster_than_its_height_is_and_a_level_one_as_ever() -> None:
    """PX4 1.18 does not slow for a slope: it would reach the waypoint out of height."""
    tailwind = np.array([0.0, 8.0])
    level = Leg(LegKind.CRUISE, HERE, (0.0, 145.0, HERE[2]), 0.0)
    wanted_mps = ROUTE.ground_speed_to_command_mps(level, tailwind)
    speeds = M100.speeds
    for sinks_m, rate_mps in ((30.0, speeds.descent_mps), (-40.0, speeds.climb_mps)):
        leg = replace(level, to_ned_m=(0.0, 145.0, HERE[2] + sinks_m))
        commanded_mps = ROUTE.ground_speed_to_command_mps(leg, tailwind)
        flown_s = 145.0 / commanded_mps
        assert commanded_mps < wanted_mps
        assert abs(sinks_m) / rate_mps + 1.0 < flown_s < 1.3 * abs(sinks_m) / rate_mps
        assert ROUTE.leg_costs_wind_major((leg,), tailwind[None, :]).time_s[0, 0] == pytest.approx(
            flown_s
        )
    drift = replace(level, to_ned_m=(0.0, 145.0, HERE[2] + 2.9))
    assert ROUTE.ground_speed_to_command_mps(drift, tailwind) == wanted_mps


def test_a_headwind_is_flown_faster_than_calm_air() -> None:
    made = ROUTE.ground_speed_to_command_mps(cruise(HERE, EAST), np.array([0.0, -13.0]))
    assert made > M100.speeds.cruise_airspeed_mps - 13.0 + 2.0


def test_without_a_command_a_headwind_costs_more_than_with_one() -> None:
    wind = 0.0, -12.0
    commanded, _, _ = one(cruise(HERE, EAST), *wind)
    for ground in (2.0, 4.0):  # what a stronger wind had called for before
        assert one(cruise(HERE, EAST, ground=ground), *wind)[0] > 1.1 * commanded


def test_safety_rule_4_landing_is_priced_down_to_motors_off() -> None:
    landing = Leg(LegKind.LAND, HERE, (0.0, 0.0, 0.0), 0.0)
    speeds = M100.speeds
    slow = speeds.land_slow_height_m
    expected = (40.0 - slow) / speeds.descent_mps + slow / speeds.landing_mps + TOUCHDOWN_S
    energy, time, _ = one(landing, 0.0, 0.0)
    assert time == pytest.approx(expected)
    assert energy == pytest.approx(level_w(0.0) * expected / 3600.0, rel=1e-3)


def test_safety_rule_4_climb_hover_and_descent_are_priced() -> None:
    climb = Leg(LegKind.CLIMB, (0.0, 0.0, 0.0), HERE, 0.5)
    hover = Leg(LegKind.HOVER, HERE, HERE, 0.5, 20.0)
    sink = Leg(LegKind.DESCEND, HERE, (0.0, 0.0, -6.0), 0.5)
    assert one(climb, 0.0, 0.0)[1] == pytest.approx(40.0 / M100.speeds.climb_mps)
    rising = float(multirotor_power_w(M100, M100.flying_mass_kg(0.5), 0.0, M100.speeds.climb_mps))
    assert one(climb, 0.0, 0.0)[0] == pytest.approx(rising * one(climb, 0.0, 0.0)[1] / 3600.0)
    assert one(hover, 0.0, 6.0)[0] == pytest.approx(level_w(6.0, 0.5) * 20.0 / 3600.0, rel=2e-3)
    assert one(sink, 0.0, 0.0)[1] == pytest.approx(34.0 / M100.speeds.descent_mps)


def test_uphill_cruise_pays_the_potential_energy() -> None:
    flat, _, _ = one(cruise(HERE, EAST), 0.0, 0.0)
    uphill, _, _ = one(cruise(HERE, (0.0, 900.0, -70.0)), 0.0, 0.0)
    downhill, _, _ = one(cruise(HERE, (0.0, 900.0, -10.0)), 0.0, 0.0)
    gained = M100.flying_mass_kg(0.0) * 9.80665 * 30.0 / M100.power_rotor.drive_efficiency / 3600.0
    assert uphill - flat == pytest.approx(gained, rel=1e-6)
    assert downhill == pytest.approx(flat)


def test_turning_back_costs_the_speed_that_is_lost_and_gained() -> None:
    middle = (0.0, 450.0, -40.0)
    straight = (cruise(HERE, middle), cruise(middle, EAST))
    about = (cruise(HERE, middle), cruise(middle, HERE))
    times = [
        float(ROUTE.leg_costs_wind_major(legs, CALM).time_s.sum()) for legs in (straight, about)
    ]
    # In calm air the speed to fly is the mission's, or a little faster where that is cheaper.
    speed = 900.0 / times[0]
    cruise_mps = M100.speeds.cruise_airspeed_mps
    assert cruise_mps - 0.01 <= speed <= cruise_mps + 1.5
    assert times[1] - times[0] == pytest.approx(speed / M100.speeds.accel_mps2, rel=0.02)


def test_the_gradient_is_the_slope_of_the_cost() -> None:
    legs = (cruise(HERE, EAST), cruise(EAST, HERE), Leg(LegKind.HOVER, HERE, HERE, 0.0, 30.0))
    wind = np.array([1.3, -6.2])
    gradient = ROUTE.leg_energy_gradients_wh_per_mps(legs, wind)
    assert gradient.shape == (3, 2)
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = 0.5
        high, low = (
            ROUTE.leg_costs_wind_major(legs, (wind + s)[None, :]).energy_wh[0]
            for s in (step, -step)
        )
        np.testing.assert_allclose(gradient[:, axis], high - low, rtol=0.1, atol=0.03)


def test_one_wind_error_moves_every_leg_so_gradients_add_and_variances_do_not() -> None:
    cov = np.diag([0.8, 0.8])
    wind = np.array([0.0, -6.0])

    def independent(legs: tuple[Leg, ...]) -> float:
        gradient = ROUTE.leg_energy_gradients_wh_per_mps(legs, wind)
        return math.sqrt(float(np.einsum("ei,ij,ej->", gradient, cov, gradient)))

    points = [(0.0, 150.0 * i, -40.0) for i in range(10)]
    straight = tuple(cruise(a, b) for a, b in pairwise(points))
    # Nine equal legs one way: correlated errors add up 9-fold, independent ones only sqrt(9)-fold.
    ratio = ROUTE.route_energy_std_wh(straight, wind, cov) / independent(straight)
    assert ratio == pytest.approx(3.0, rel=0.02)
    # Out and back they cancel in part: adding variances would then say too much.
    both = (cruise(HERE, EAST), cruise(EAST, HERE))
    assert ROUTE.route_energy_std_wh(both, wind, cov) < 0.9 * independent(both)


def test_the_route_std_is_what_monte_carlo_finds() -> None:
    legs = (cruise(HERE, EAST), cruise(EAST, (700.0, 700.0, -40.0)))
    wind, cov = np.array([2.0, -5.0]), np.array([[0.3, 0.1], [0.1, 0.2]])
    winds = np.random.default_rng(1).multivariate_normal(wind, cov, 20_000)
    sampled = ROUTE.leg_costs_wind_major(legs, winds).energy_wh.sum(axis=1).std()
    assert ROUTE.route_energy_std_wh(legs, wind, cov) == pytest.approx(sampled, rel=0.06)


def test_many_winds_price_as_one_at_a_time() -> None:
    legs = (cruise(HERE, EAST, 0.4), Leg(LegKind.LAND, EAST, (0.0, 900.0, 0.0), 0.4))
    winds = np.random.default_rng(2).normal(0.0, 5.0, (7, 2, 2))
    together = ROUTE.leg_costs_wind_major(legs, winds)
    for k in range(7):
        for i in range(2):
            alone = ROUTE.leg_costs_wind_major(legs, winds[k, i][None, :])
            assert together.energy_wh[k, i] == pytest.approx(alone.energy_wh[0, i])
            assert together.time_s[k, i] == pytest.approx(alone.time_s[0, i])


def test_payload_is_felt() -> None:
    empty, loaded = (one(cruise(HERE, EAST, kg), 0.0, 0.0)[0] for kg in (0.0, 1.0))
    assert loaded > 1.1 * empty
    assert ROUTE.hover_power_w(1.0) == pytest.approx(level_w(0.0, 1.0), rel=1e-6)
    assert ROUTE.steady_flight_power_w(0.0, 10.0) == pytest.approx(level_w(10.0), rel=1e-3)
