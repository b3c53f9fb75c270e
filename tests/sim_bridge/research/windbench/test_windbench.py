"""The rule by hand, and the command over a synthetic flight whose wind is known."""

import csv
import math

import numpy as np
import pytest

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from sim_bridge.research.windbench.contest import WindowScore, score_estimator
from sim_bridge.research.windbench.drag_fusion import px4_drag_params_from_airframe
from sim_bridge.research.windbench.estimators import estimators_by_name
from sim_bridge.research.windbench.flights import read_bench_folder, starts_in_the_air
from tests.sim_bridge.research.study_command import run_study

WIND_NE = (3.0, -2.0)
G = 9.80665


def scored(day, read, believed, std=None, vector=None, folder="d"):
    return WindowScore(folder, day, f"{day} {read}", read, believed, std, vector)


def test_days_count_alike_however_many_windows_they_have():
    rows = [scored("a", 5.0, 6.0, 0.5)] * 9 + [scored("b", 5.0, 8.0, 1.0)]
    found = score_estimator("e", rows)
    assert found.score_mps == pytest.approx(math.sqrt((1.0 + 9.0) / 2.0))
    assert found.nees == pytest.approx((9 * 4.0 + 9.0) / 10)
    assert (found.low_mps, found.high_mps) == pytest.approx((1.0, 3.0))
    assert found.folders == {"d": pytest.approx(math.sqrt(5.0))}


def sensor(days, vector=None):
    """Return an anemometer that reads 0.8 of the airspeed and 1.5 more."""
    speeds = (4.0, 7.0, 12.0)
    return [scored(f"{d}", 0.8 * v + 1.5, v, 0.5, vector) for d in range(days) for v in speeds]


def test_the_anemometers_scale_is_fitted_on_other_days_and_only_where_there_are_three():
    assert score_estimator("e", sensor(4)).score_mps == pytest.approx(0.0, abs=1e-9)
    assert score_estimator("e", sensor(3)).score_mps > 0.3
    assert score_estimator("e", sensor(4, vector=0.7)).score_mps > 0.3
    odd = [scored("4", 20.0, 10.0)]  # a separate day: the fit excludes the judged day
    assert score_estimator("e", [*sensor(4), *odd]).score_mps > 4.0


def test_a_vector_is_judged_where_a_reference_tells_it():
    assert score_estimator("e", [scored("a", 5.0, 5.0, None, 2.0)]).vector_mps == 2.0
    found = score_estimator("e", [scored("a", 5.0, 5.0)])
    assert (found.vector_mps, found.nees) == (None, None)


def write_log(path, airframe, *, reference=True, seconds=150.0):
    """North, east, south, west at 8 m/s, nose along the course; tilt balances drag and turns."""
    t_s = np.arange(0.0, seconds, 0.2)
    leg = np.where(t_s < 20.0, -1, (t_s // 15.0).astype(int) % 4)
    course = np.radians(90.0 * leg)
    velocity = np.where(leg[:, None] < 0, 0.0, 8.0 * np.c_[np.cos(course), np.sin(course)])
    eased = np.ones(21) / 21.0  # corners take 4 s, and the tilt accelerates
    velocity = np.c_[tuple(np.convolve(v, eased, "same") for v in velocity.T)]
    accel = np.gradient(velocity, t_s, axis=0)
    air = velocity - np.array(WIND_NE)
    cos, sin = np.cos(course), np.sin(course)
    body = np.c_[cos * air[:, 0] + sin * air[:, 1], cos * air[:, 1] - sin * air[:, 0]]
    drag, mass = airframe.drag, airframe.mass.empty_kg
    linear = np.array([drag.linear_forward_n_per_mps, drag.linear_right_n_per_mps])
    square = np.array([drag.quadratic_forward_n_per_mps2, drag.quadratic_right_n_per_mps2])
    speed = np.linalg.norm(body, axis=1)[:, None]
    pull = (linear + square * speed) * body / mass
    pull += np.c_[cos * accel[:, 0] + sin * accel[:, 1], cos * accel[:, 1] - sin * accel[:, 0]]
    up = t_s >= 15.0
    pitch = np.where(up, -np.arctan(pull[:, 0] / G), 0.0)
    roll = np.where(up, np.arctan(pull[:, 1] * np.cos(pitch) / G), 0.0)
    climb = np.where((t_s >= 15.0) & (t_s < 20.0), -4.0, 0.0)
    height = 12.0 + np.cumsum(-climb) * 0.2
    head = "t_s vel_n_mps vel_e_mps vel_d_mps roll_deg pitch_deg yaw_deg alt_m lat_deg lon_deg"
    rows = [t_s, *velocity.T, climb, *np.degrees([roll, pitch, course]), height]
    rows += [55.0 + np.cumsum(velocity[:, 0]) * 0.2 / 111_195.0]
    rows += [8.0 + np.cumsum(velocity[:, 1]) * 0.2 / 63_900.0]
    if reference:
        head += " wind_to_n_ref_mps wind_to_e_ref_mps"
        rows += [np.full(len(t_s), WIND_NE[0]), np.full(len(t_s), WIND_NE[1])]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([head.split(), *np.round(np.c_[tuple(rows)], 6).tolist()])


OWN = """
import numpy as np
from companion.core.wind.observation import WindBelief

class Knows:
    def __init__(self, airframe):
        pass
    def update(self, observation):
        assert observation.airspeed_mps is None
        return ()
    def belief(self, t_s):
        return WindBelief(t_s, np.array([3.0, -2.0]), 0.01 * np.eye(2), ("tilt",), True)
"""


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "made"
    made.mkdir()
    write_log(made / "one.csv", read_airframe("generic"))
    return made


@pytest.mark.sample
def test_the_command_ranks_an_estimator_of_ones_own_by_what_it_knows(folder, tmp_path, monkeypatch):
    (tmp_path / "my_wind.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    write_log(folder / "blind.csv", read_airframe("generic"), reference=False)
    document, printed = run_study(
        tmp_path, "windbench", f"{folder}=generic", "--estimator", "my_wind:Knows"
    )
    assert "made: blind.csv: no ten seconds in the air with airspeed_mps" in printed
    found = {s["estimator"]: s for s in document["standings"]}
    assert found["my_wind:Knows"]["score_mps"] == pytest.approx(0.0, abs=0.05)
    assert found["my_wind:Knows"]["vector_mps"] == pytest.approx(0.0, abs=1e-6)
    assert found["best constant wind of each flight (hindsight)"]["vector_mps"] < 1e-6
    # Still air errs by the wind: its vector is off by all of it.
    still = found["still air (ground speed as airspeed)"]
    assert still["vector_mps"] == pytest.approx(math.hypot(*WIND_NE))
    for name in ("Leeway", "plain EKF (filterpy)", "PX4's drag fusion, tuned",
                 "ArduPilot's drag fusion, tuned"):  # fmt: skip
        assert found[name]["vector_mps"] < 0.6 * still["vector_mps"], name
    rows = list(csv.reader((tmp_path / "out" / "windbench.csv").read_text().splitlines()))
    assert rows[1][1] in ("my_wind:Knows", "best constant wind of each flight (hindsight)")


def test_starts_in_the_air_know_nothing_of_what_was_before(folder, tmp_path):
    (flight,) = read_bench_folder(folder, "generic").flights
    first_s = next(o.t_s for o in flight.observations if o.airborne)
    starts = list(starts_in_the_air(flight, 30.0))
    assert [s.name for s in starts] == [f"one.csv from {30 * k} s" for k in (1, 2)]
    for k, start in enumerate(starts, 1):
        begin_s = start.observations[0].t_s
        assert begin_s == pytest.approx(first_s + 30.0 * k, abs=0.11)
        assert len(start.velocity_ne_mps) == len(start.observations)
        for window in start.windows:
            t_s = start.observations[window.rows.start].t_s
            assert t_s >= begin_s + 29.9
            (same,) = (w for w in flight.windows if flight.observations[w.rows.start].t_s == t_s)
            assert same.wind_to_ne_mps is window.wind_to_ne_mps
    with pytest.raises(LeewayError, match="--starts 500: no flight is long enough"):
        run_study(tmp_path, "windbench", f"{folder}=generic", "--starts", "500")


def test_the_worst_flight_is_told_apart_from_the_mean():
    rows = [scored("a", 5.0, 5.0, None, v) for v in (1.0, 1.0)] + [scored("b", 6.0, 6.0, None, 3.0)]
    assert score_estimator("e", rows).worst_mps == pytest.approx(3.0)


def test_what_cannot_be_used_is_said_in_one_line(tmp_path, folder):
    with pytest.raises(LeewayError, match="no such folder"):
        read_bench_folder(tmp_path / "nowhere", "generic")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(LeewayError, match="empty: no flight with an anemometer"):
        read_bench_folder(empty, "generic")
    for words in ("nowhere:It", "json", "json:NoSuch"):
        with pytest.raises(
            LeewayError, match=f"wind estimator .*{words}.*MODULE:NAME|{words}: not loaded"
        ):
            estimators_by_name((words,))


def test_windows_are_whole_and_begin_half_a_minute_after_take_off(folder):
    (flight,) = read_bench_folder(folder, "generic").flights
    took_off = next(seen.t_s for seen in flight.observations if seen.airborne)
    begins = [flight.observations[w.rows.start].t_s for w in flight.windows]
    assert begins[0] == pytest.approx(took_off + 30.0, abs=0.3)
    assert np.diff(begins) == pytest.approx(10.0, abs=0.3)
    assert all(w.wind_to_ne_mps == pytest.approx(WIND_NE) for w in flight.windows)


def test_px4s_coefficients_are_those_that_explain_the_airframes_drag():
    airframe = read_airframe("m100")
    found, drag, mass = (
        px4_drag_params_from_airframe(airframe),
        airframe.drag,
        airframe.mass.empty_kg,
    )
    speed = 10.0
    by_px4 = 0.5 * 1.225 * speed**2 / found.bcoef_forward_kgpm2
    assert by_px4 == pytest.approx(drag.quadratic_forward_n_per_mps2 * speed**2 / mass)
