"""Drag uncertainty passed by calibration to the wind estimator: fits with a given covariance."""

import math
from dataclasses import replace
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

from companion.analysis.calibration.airframe_fit import fit_airframe_to_flights
from companion.analysis.calibration.drag import fit_drag
from companion.analysis.calibration.drag_uncertainty import drag_uncertainty_fields

WORLD = run_path(str(Path(__file__).parent / "test_airframe_fit.py"))


def square(seed):
    sides = WORLD["square"]((12.6, 4.9, 8.4))
    return WORLD["blocks"](WORLD["fly"](sides, seed=seed, name=f"s{seed}"))


@pytest.fixture(scope="module")
def flights():
    return [square(seed) for seed in range(21, 26)]


@pytest.fixture(scope="module")
def fitted(flights):
    return fit_drag(flights, WORLD["wrong_start"]())


def scaled(fit, common, own):
    """Return the fit with a covariance in which forward and right drag have a common relative error
    and one of their own each, at any airspeed."""
    forward = np.array([1.0, 0.0, 1.0, 0.0, 0.0]) * fit.values
    right = np.array([0.0, 1.0, 0.0, 1.0, 0.0]) * fit.values
    cov = common**2 * np.outer(forward + right, forward + right)
    cov += own**2 * (np.outer(forward, forward) + np.outer(right, right))
    return replace(fit, cov=cov)


@pytest.mark.sample
def test_common_and_own_errors_of_the_axes_come_back(flights, fitted):
    found = drag_uncertainty_fields(flights, scaled(fitted, 0.06, 0.04))
    assert found["gain_std_frac"] == pytest.approx(0.06, rel=1e-6)
    assert found["axis_gain_std_frac"] == pytest.approx(0.04, rel=1e-6)


@pytest.mark.sample
def test_a_fit_that_is_sure_still_leaves_the_density_of_the_air(flights, fitted):
    found = drag_uncertainty_fields(flights, scaled(fitted, 0.001, 0.001))
    assert (found["gain_std_frac"], found["axis_gain_std_frac"]) == (0.02, 0.01)


def test_it_is_asked_at_the_airspeed_flown_not_beyond(flights, fitted):
    """An error of the quadratic against the linear term that cancels at about 8 m/s."""
    values = fitted.values
    row = np.array([8.0 * values[0], 0.0, -values[0], 0.0, 0.0])
    both = row + np.array([0.0, 8.0 * values[1], 0.0, -values[1], 0.0])
    found = drag_uncertainty_fields(flights, replace(fitted, cov=0.05**2 * np.outer(both, both)))
    cruise = 18.0
    of_cruise = abs(8.0 * values[0] * cruise - values[0] * cruise**2) * 0.05
    of_cruise /= values[0] * cruise + values[2] * cruise**2
    assert found["gain_std_frac"] < 0.3 * of_cruise


def test_the_scatter_of_trims_is_told_from_five_flights_on(flights, fitted):
    leaning = [
        replace(
            fitted,
            residual_mps2=tuple(
                left + lean for left, lean in zip(fitted.residual_mps2, leans, strict=True)
            ),
        )
        for leans in ((0.0,) * 5, (-0.2, -0.1, 0.0, 0.1, 0.2))
    ]
    straight, scattered = (drag_uncertainty_fields(flights, fit)["trim_std_deg"] for fit in leaning)
    lean_deg = math.degrees(np.std([-0.2, -0.1, 0.0, 0.1, 0.2], ddof=1) / 9.81)
    assert straight < 0.4
    assert scattered == pytest.approx(math.hypot(lean_deg, straight), abs=0.25)
    assert scattered > lean_deg - 0.25
    few = drag_uncertainty_fields(
        flights[:4], replace(fitted, winds=fitted.winds[:4], residual_mps2=fitted.residual_mps2[:4])
    )
    assert "trim_std_deg" not in few


@pytest.mark.sample
def test_a_calibrated_airframe_carries_them(flights):
    start = WORLD["wrong_start"]()
    drag = fit_airframe_to_flights(flights, start, measure_holdout_error=False).airframe.drag
    assert drag.gain_std_frac < start.drag.gain_std_frac
    assert drag.model_std_frac == 0.03
    assert 0.2 <= drag.trim_std_deg <= 1.0
