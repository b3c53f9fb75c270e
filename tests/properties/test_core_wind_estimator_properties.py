"""The wind estimator in any flight: a valid covariance that never shrinks without data."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from companion.adapters.files.params import read_airframe
from companion.core.wind.estimator import WindEstimator, WindObservation

M100 = read_airframe("m100")

angle = st.floats(-0.8, 0.8)
speed = st.floats(-20.0, 20.0)
observation = st.builds(
    WindObservation,
    t_s=st.sampled_from([0.0, 0.05, 0.1, 0.1, 0.1, 0.4, 3.0, 60.0]),
    airborne=st.sampled_from([True, True, True, False]),
    mass_kg=st.floats(2.0, 6.0),
    vel_ned_mps=st.one_of(st.none(), st.tuples(speed, speed, st.floats(-3.0, 3.0))),
    roll_rad=st.one_of(st.none(), angle),
    pitch_rad=st.one_of(st.none(), angle),
    yaw_rad=st.one_of(st.none(), st.floats(-math.pi, math.pi)),
    airspeed_mps=st.one_of(st.none(), st.floats(-5.0, 40.0)),
    airspeed_is_magnitude=st.booleans(),
    autopilot_wind_to_ne_mps=st.one_of(st.none(), st.tuples(speed, speed)),
    autopilot_wind_cov_m2ps2=st.one_of(
        st.none(), st.tuples(st.floats(0.0, 9.0), st.just(0.0), st.floats(0.0, 9.0))
    ),
    airspeed_fr_mps=st.one_of(st.none(), st.tuples(speed, speed)),
)


@settings(max_examples=60, deadline=None)
@given(
    seen=st.lists(observation, min_size=1, max_size=40),
    wait_s=st.floats(0.0, 600.0),
)
def test_waiting_never_makes_us_more_certain_and_the_covariance_is_one(
    seen: list[WindObservation], wait_s: float
) -> None:
    estimator, t_s = WindEstimator(M100), 0.0
    for one in seen:
        t_s += one.t_s
        estimator.update(replace(one, t_s=t_s))
        now, later = estimator.belief(t_s), estimator.belief(t_s + wait_s)
        assert np.isfinite(now.mean_to_ne_mps).all()
        np.testing.assert_array_equal(now.cov_ne_m2ps2, now.cov_ne_m2ps2.T)
        assert np.linalg.eigvalsh(now.cov_ne_m2ps2)[0] > 0.0
        grown = later.cov_ne_m2ps2 - now.cov_ne_m2ps2
        assert np.linalg.eigvalsh(grown)[0] >= -1e-9
        np.testing.assert_array_equal(later.mean_to_ne_mps, now.mean_to_ne_mps)


@pytest.mark.sample
@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 1000),
    course=st.floats(-math.pi, math.pi),
    trim=st.floats(-0.02, 0.02),
)
@example(seed=830, course=1.0, trim=0.015625)  # almost no airspeed: a trim is 1.6 m/s of wind
def test_on_one_heading_for_ever_it_does_not_diverge(seed: int, course: float, trim: float) -> None:
    rng = np.random.default_rng(seed)
    estimator = WindEstimator(M100)
    wind = rng.normal(0.0, 4.0, 2)
    vel = 8.0 * np.array([math.cos(course), math.sin(course)])
    linear, _ = M100.linear_drag_forward_right_n_per_mps(M100.mass.empty_kg, 1.225)
    quadratic = M100.drag.quadratic_forward_n_per_mps2
    for k in range(1500):
        air = vel - wind - 0.5 * rng.standard_normal(2)
        drag = (linear + quadratic * float(np.linalg.norm(air))) * air / M100.mass.empty_kg
        cos, sin = math.cos(course), math.sin(course)
        estimator.update(
            WindObservation(
                t_s=0.4 * k,
                airborne=True,
                mass_kg=M100.mass.empty_kg,
                vel_ned_mps=(float(vel[0]), float(vel[1]), 0.0),
                roll_rad=math.atan((-sin * drag[0] + cos * drag[1]) / 9.80665),
                pitch_rad=-math.atan((cos * drag[0] + sin * drag[1]) / 9.80665) + trim,
                yaw_rad=course,
            )
        )
    belief = estimator.belief(600.0)
    error = belief.mean_to_ne_mps - wind
    # A trim that no turn reveals reads as wind: up to 2 m/s in slow air, and the covariance knows.
    air = vel - wind
    drag = (linear + quadratic * float(np.linalg.norm(air))) * air / M100.mass.empty_kg
    felt = drag - 9.80665 * trim * vel / 8.0
    force_n = M100.mass.empty_kg * float(np.linalg.norm(felt))
    speed_mps = (math.sqrt(linear**2 + 4.0 * quadratic * force_n) - linear) / (2.0 * quadratic)
    read_as_wind = speed_mps * felt / float(np.linalg.norm(felt)) - air
    assert float(np.linalg.norm(error)) < float(np.linalg.norm(read_as_wind)) + 1.8
    assert float(error @ np.linalg.solve(belief.cov_ne_m2ps2, error)) < 16.0


@pytest.mark.parametrize(
    "broken",
    [
        {"t_s": math.nan},
        {"mass_kg": math.nan},
        {"mass_kg": 0.0},
        {"roll_rad": math.nan},
        {"airspeed_mps": math.inf},
        {"vel_ned_mps": (0.0, math.nan, 0.0)},
        {"autopilot_wind_to_ne_mps": (math.nan, 0.0)},
        {"autopilot_wind_cov_m2ps2": (math.inf, 0.0, 1.0)},
        {"airspeed_fr_mps": (1.0, math.nan)},
    ],
)
def test_nan_is_refused(broken: dict) -> None:
    estimator = WindEstimator(M100)
    clean = WindObservation(1.0, True, 2.5, (1.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="wind observation"):
        estimator.update(replace(clean, **broken))
