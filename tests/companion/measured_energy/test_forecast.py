"""Tracks, times and phases of synthetic flights with a known truth."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.analysis.calibration.drag import EstimatedWind
from companion.analysis.calibration.records import Blocks
from companion.analysis.measured_energy.flown_track import (
    STEP_S,
    FlownTrack,
    detect_leg_sequence,
    slowest_indices_between_legs,
)
from companion.analysis.measured_energy.forecast import TrainingFlight, fit_energy_forecast
from companion.analysis.measured_energy.remaining_energy import (
    predict_remaining_energy_wh,
    takeoff_corner_and_midpoint,
)
from companion.analysis.measured_energy.route_times import (
    RoutePlan,
    RouteTimes,
    build_flown_route,
    fit_route_times,
)
from companion.analysis.measured_energy.track_power import (
    energy_by_phase,
    measured_to_modelled_power_by_phase,
    wind_on_track_grid,
    with_flown_power_ratios,
)
from companion.core.base.errors import LeewayError
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.airframe import FlownPower
from companion.core.vehicle.power import multirotor_power_w

M100 = read_airframe("m100")
CORNERS = ((0.0, 0.0), (65.0, 120.0), (-105.0, 35.0), (0.0, 0.0))  # north, east


def power(payload_kg, climb):
    """Return test power: 440 W and 200 W/kg in level flight, up 100 W more, down 30 W less."""
    return 440.0 + 200.0 * payload_kg + np.where(climb > 0.5, 100.0, 0.0) - 30.0 * (climb < -0.5)


def fly(speed, height, payload_kg, factor=1.0, name="f", cut_short=False):
    """Up at 3 m/s, to each corner at a constant speed, 4 s at each, down at 2 m/s."""
    points, climbs = [(0.0, 0.0)] * round(height / 3 / STEP_S), []
    climbs = [3.0] * len(points)
    for (n0, e0), (n1, e1) in pairwise(CORNERS):
        steps = round(math.hypot(n1 - n0, e1 - e0) / speed / STEP_S)
        for i in range(1, steps + 1):
            points.append((n0 + (n1 - n0) * i / steps, e0 + (e1 - e0) * i / steps))
        points += [(n1, e1)] * round(4.0 / STEP_S)
        climbs += [0.0] * (steps + round(4.0 / STEP_S))
    down = round(height / 2 / STEP_S)
    points += [CORNERS[-1]] * down
    climbs += [-2.0] * down
    north, east = np.array(points).T
    climb = np.array(climbs)
    return FlownTrack(
        name=name,
        payload_kg=payload_kg,
        t_s=STEP_S * np.arange(len(north)),
        north_m=north,
        east_m=east,
        height_m=np.cumsum(climb) * STEP_S,
        vel_n_mps=np.gradient(north, STEP_S),
        vel_e_mps=np.gradient(east, STEP_S),
        climb_mps=climb,
        power_w=factor * power(payload_kg, climb),
        alt_amsl_m=0.0,
        ends_in_flight=cut_short,
    )


def test_legs_and_corners_are_where_they_were_flown():
    track = fly(8.0, 30.0, 0.0)
    legs = detect_leg_sequence(track, 8.0)
    assert len(legs) == 3
    for corner, place in zip(slowest_indices_between_legs(track, legs), CORNERS[1:-1], strict=True):
        assert track.position_ne_m(corner) == pytest.approx(place, abs=4.0)


def test_a_hover_has_no_legs():
    assert detect_leg_sequence(fly(8.0, 30.0, 0.0), 0.0) == ()


def test_times_of_climb_legs_and_descent_are_found_again():
    routes = [
        build_flown_route(fly(speed, height, 0.0), height, speed)
        for speed in (4.0, 8.0, 12.0)
        for height in (25.0, 50.0, 100.0)
    ]
    times = fit_route_times(routes)
    assert times.climb[1] == pytest.approx(1 / 3, rel=0.02)
    assert times.descent[1] == pytest.approx(1 / 2, rel=0.02)
    # 4 s hover at each of two corners; the last hover belongs to the descent.
    assert 3 * times.leg_time_beyond_constant_speed_s(8.0) + times.descent[0] == pytest.approx(
        12.0, abs=1.0
    )


def test_a_pause_does_not_change_the_times():
    routes = [
        build_flown_route(fly(speed, 30.0, 0.0), 30.0, speed)
        for speed in (4.0, 6.0, 8.0, 10.0, 12.0)
    ]
    paused = replace(routes[2], leg_s=(routes[2].leg_s[0] + 30.0, *routes[2].leg_s[1:]))
    usual, with_pause = (
        fit_route_times(flown).leg_s(200.0, 8.0)
        for flown in (routes, [*routes[:2], paused, *routes[3:]])
    )
    assert with_pause == pytest.approx(usual, abs=0.5)


def test_wind_of_airborne_blocks_is_interpolated_on_the_track():
    track = fly(8.0, 30.0, 0.0)
    t_s = np.arange(1.0, 11.0, 2.0)
    columns = [np.zeros(5)] * 18
    blocks = Blocks("f", t_s, *columns, np.array([False, True, True, True, True]), 1.2)
    north = np.array([1.0, 3.0, 3.0, 7.0])
    along = wind_on_track_grid(track, blocks, EstimatedWind(north, -north, north, 3.0))
    at = np.searchsorted(track.t_s, [0.0, 4.0, 8.0, 50.0])
    assert along[at] == pytest.approx(np.array([[1, -1], [2, -2], [5, -5], [7, -7]]), abs=1e-6)


def test_a_flight_that_is_cut_off_has_nothing_to_go():
    with pytest.raises(LeewayError, match="f: the log ends in flight"):
        build_flown_route(fly(8.0, 30.0, 0.0, cut_short=True), 30.0, 8.0)


def test_half_way_lies_at_half_of_the_legs():
    track = fly(8.0, 30.0, 0.0)
    route = build_flown_route(track, 30.0, 8.0)
    *_, half = takeoff_corner_and_midpoint(track, route)
    lengths = np.array(route.plan.leg_m)
    flown = lengths[0] + (half.leg_progress - 1.0) * lengths[1]
    assert half.name == "half"
    assert flown == pytest.approx(0.5 * lengths.sum())
    north, east = track.position_ne_m(half.index)
    (n1, e1), (n2, e2) = CORNERS[1], CORNERS[2]
    share = half.leg_progress - 1.0
    assert (north, east) == pytest.approx((n1 + share * (n2 - n1), e1 + share * (e2 - e1)), abs=6.0)


def test_energy_to_go_is_power_times_time_by_hand():
    plan, times = RoutePlan(60.0, 10.0, (100.0, 200.0)), RouteTimes((5, 0.5), (1, 0.2), (10, 1))
    level = float(multirotor_power_w(M100, M100.flying_mass_kg(0.5), 10.0))
    climb, descent = (
        float(multirotor_power_w(M100, M100.flying_mass_kg(0.5), 0.0, rate)) for rate in (2.0, -1.0)
    )
    by_hand = (climb * 35.0 + level * (10 + 20 + 2 * 3.0) + descent * 70.0) / 3600.0
    assert predict_remaining_energy_wh(M100, times, plan, 0.5, 0.0, 0.0, 1.225) == pytest.approx(
        by_hand
    )
    by_hand = (level * 0.5 * (20 + 3.0) + descent * 70.0) / 3600.0
    assert predict_remaining_energy_wh(M100, times, plan, 0.5, 1.5, 0.0, 1.225) == pytest.approx(
        by_hand
    )


def known(days=6, seed=1):
    rng = np.random.default_rng(seed)
    flights = []
    for day in range(days):
        of_day = rng.normal(0.0, 0.02)
        for number in range(6):
            speed, height = (4.0, 8.0, 12.0)[number % 3], (25.0, 100.0)[number % 2]
            factor = math.exp(of_day + rng.normal(0.0, 0.01))
            track = fly(speed, height, 0.25 * (number % 3), factor)
            route = build_flown_route(track, height, speed)
            flights.append(
                TrainingFlight(track, route, np.zeros(2), 1.225, f"d{day}", 10 * day + number // 3)
            )
    return flights


def test_a_forecast_finds_power_by_phase_and_covers_a_new_day():
    forecast = fit_energy_forecast(M100, known())
    flown = forecast.airframe.power_flown
    assert flown.descent_frac < flown.level_frac
    assert 0.005 < math.sqrt(forecast.flown.day_variance) < 0.05
    errors = []
    for new in known(days=20, seed=9):
        stated = forecast.predict_track_energy(new.track, np.zeros(2), 1.225)
        errors.append(new.track.energy_wh / stated.predicted_wh - 1.0)
        assert stated.upper_wh > stated.predicted_wh
    assert np.mean(np.abs(errors)) < 0.03


def test_what_was_drawn_so_far_moves_what_is_to_come():
    forecast = fit_energy_forecast(M100, known())
    usual, thirsty = (fly(8.0, 100.0, 0.25, factor) for factor in (1.0, 1.06))
    stated = []
    for track in (usual, thirsty):
        route = build_flown_route(track, 100.0, 8.0)
        *_, half = takeoff_corner_and_midpoint(track, route)
        stated.append(
            forecast.predict_remaining_energy(track, route, half, np.zeros(2), 1.225).predicted_wh
        )
    assert 1.02 < stated[1] / stated[0] < 1.07


def test_another_vehicle_s_power_is_refused():
    track = fly(8.0, 30.0, 0.0)
    with pytest.raises(LeewayError, match="climb: measured over modelled energy"):
        measured_to_modelled_power_by_phase([energy_by_phase(track, 0.2 * track.power_w)])


def test_power_by_phase_scales_the_model_and_without_it_nothing_changes():
    table = FlownPower(climb_frac=1.1, level_frac=1.02, descent_frac=0.9)
    flown = with_flown_power_ratios(M100, table)
    for climb, frac in ((3.0, 1.1), (0.0, 1.02), (-2.0, 0.9), (-0.5, 0.96)):
        plain = multirotor_power_w(M100, 4.0, 5.0, climb)
        assert multirotor_power_w(flown, 4.0, 5.0, climb) == pytest.approx(frac * plain)


def test_routes_price_descent_by_the_table():
    table = FlownPower(climb_frac=1.0, level_frac=1.0, descent_frac=0.9)
    land = (Leg(LegKind.LAND, (0.0, 0.0, -50.0), (0.0, 0.0, 0.0), 0.0),)
    hover = (Leg(LegKind.HOVER, (0.0, 0.0, -50.0), (0.0, 0.0, -50.0), 0.0, duration_s=60.0),)
    calm = np.zeros((1, 2))
    plain, flown = RouteEnergy(M100), RouteEnergy(with_flown_power_ratios(M100, table))
    ratio = (
        flown.leg_costs_wind_major(land, calm).energy_wh
        / plain.leg_costs_wind_major(land, calm).energy_wh
    )
    assert ratio[0, 0] == pytest.approx(0.9)
    assert flown.leg_costs_wind_major(hover, calm).energy_wh == pytest.approx(
        plain.leg_costs_wind_major(hover, calm).energy_wh
    )


def test_few_flights_tell_a_bound_for_all_of_a_flight_and_none_for_its_parts():
    flights = [flight for flight in known() if flight.day in ("d0", "d1", "d2")][::2]
    forecast = fit_energy_forecast(M100, flights)
    assert forecast.points == {}
    assert forecast.flown.days == 3


def test_flights_of_one_day_are_refused():
    with pytest.raises(LeewayError, match="1 days, 3 expected"):
        fit_energy_forecast(M100, [flight for flight in known() if flight.day == "d0"])
