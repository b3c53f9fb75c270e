"""Energy home from each decision point of flights with a closed-form truth."""

import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.analysis.measured_energy.decision_points import (
    last_descent_start_index,
    remaining_energy_at_decision_points,
)
from companion.analysis.measured_energy.flown_track import STEP_S, FlownTrack
from companion.core.base.errors import LeewayError
from companion.core.vehicle.power import multirotor_power_w

M100 = read_airframe("m100")
DENSITY = 1.2
HOVER_S, DOWN_S, HEIGHT_M = 60.0, 10.0, 20.0


def hover_w(airspeed_mps=0.0):
    return float(multirotor_power_w(M100, M100.mass.empty_kg, airspeed_mps, 0.0, DENSITY))


def hovers(power_w, height_m=None, climb_mps=None):
    """60 s at 20 m, then straight down at 2 m/s; power (n,) as measured."""
    n = round((HOVER_S + DOWN_S) / STEP_S)
    down = np.arange(n) * STEP_S >= HOVER_S
    if climb_mps is None:
        climb_mps = np.where(down, -2.0, 0.0)
    if height_m is None:
        height_m = HEIGHT_M + np.cumsum(climb_mps) * STEP_S
    still = np.zeros(n)
    return FlownTrack(
        name="f",
        payload_kg=0.0,
        t_s=np.arange(n) * STEP_S,
        north_m=still,
        east_m=still,
        height_m=height_m,
        vel_n_mps=still,
        vel_e_mps=still,
        climb_mps=climb_mps,
        power_w=np.broadcast_to(power_w, n) + still,
        alt_amsl_m=0.0,
        ends_in_flight=False,
    )


def calm(track):
    return np.zeros((len(track.t_s), 2))


def test_a_draw_that_rises_half_way_is_seen_at_its_worst_and_not_as_the_mean_of_the_flight():
    late = np.arange(round((HOVER_S + DOWN_S) / STEP_S)) * STEP_S >= 30.0
    track = hovers(hover_w() * np.where(late, 1.2, 1.0))
    points = remaining_energy_at_decision_points(M100, track, calm(track), DENSITY)
    assert points[0].at_s == 0.0
    assert points[0].measured_to_predicted_ratio == pytest.approx((30.0 + 1.2 * 40.0) / 70.0)
    assert max(point.measured_to_predicted_ratio for point in points) == pytest.approx(1.2)
    assert [p.at_s for p in points if p.measured_to_predicted_ratio > 1.1999] == pytest.approx(
        np.arange(30.0, 60.0)
    )
    half = points[35]
    assert half.measured_wh == pytest.approx(1.2 * hover_w() * 35.0 / 3600.0)


def test_each_point_knows_the_wind_that_was_believed_there_and_no_other():
    track = hovers(hover_w())
    wind = calm(track)
    wind[track.t_s >= 20.0] = (-9.0, 12.0)
    points = remaining_energy_at_decision_points(M100, track, wind, DENSITY)
    assert points[19].measured_to_predicted_ratio == pytest.approx(1.0)
    assert points[20].measured_to_predicted_ratio == pytest.approx(hover_w() / hover_w(15.0))
    assert abs(points[20].measured_to_predicted_ratio - 1.0) > 0.03


def test_nothing_is_decided_in_the_last_descent():
    points = remaining_energy_at_decision_points(M100, hovers(400.0), calm(hovers(400.0)), DENSITY)
    assert points[-1].at_s == pytest.approx(HOVER_S - 1.0)
    # A vehicle that stops its descent at 10 m still has a decision point there.
    climb = hovers(400.0).climb_mps.copy()
    at = np.arange(len(climb)) * STEP_S
    climb[(at >= 65.0) & (at < 67.0)] = 0.0
    assert last_descent_start_index(hovers(400.0, climb_mps=climb)) * STEP_S == pytest.approx(66.8)


def test_what_never_flew_is_refused_by_name():
    n = round((HOVER_S + DOWN_S) / STEP_S)
    with pytest.raises(LeewayError, match=r"^f: never more than 5 m above"):
        last_descent_start_index(hovers(400.0, height_m=np.full(n, 3.0)))
