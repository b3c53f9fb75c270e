"""The fitted wind process: its file, its fit, its score, and the chains made of it."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.signal import lfilter
from scipy.stats import multivariate_normal
from scipy.stats import t as student_t

from companion.adapters.files.params import read_wind_process
from companion.analysis.wind_fit.fit import (
    AveragedWind,
    average_wind_over_10_s,
    fit_wind_process_to_recordings,
    process_log_likelihood,
)
from companion.analysis.wind_fit.holdout import (
    FITTED,
    LONG_MEAN,
    PERSISTENCE,
    cross_validate_wind_process,
)
from companion.analysis.wind_fit.score import (
    ValidationInterval,
    fit_student_t_dof,
    outlook_forecasts_by_horizon,
    score_forecasts,
)
from companion.core.base.errors import LeewayError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindForecast
from companion.core.wind.process import (
    WindProcessParams,
    variance_share_after_averaging,
    wind_process_from_dict,
)

ROOT = Path(__file__).parents[3]
COAST = read_wind_process("coast")
KNOWN = replace(
    COAST,
    memory_s=(20.0, 600.0),
    variance_m2ps2=(1.0, 1.5),
    reference_wind_mps=8.0,
    tail_dof=None,
)


def simulated(process: WindProcessParams, count: int, seed: int, dof: float | None = None):
    """10 s means of the process by exact steps about a wind of 8 m/s from the west."""
    random = np.random.default_rng(seed)
    wind = np.tile([0.0, 8.0], (count, 1))
    for memory, variance in zip(process.memory_s, process.variance_m2ps2, strict=True):
        part = np.sqrt(variance) * random.standard_normal(2)
        keep = np.exp(-10.0 / memory)
        for i in range(count):
            push = random.standard_normal(2)
            if dof is not None:
                push *= np.sqrt((dof - 2.0) / random.chisquare(dof))
            part = keep * part + np.sqrt(variance * (1.0 - keep**2)) * push
            wind[i] += part
    return AveragedWind(10.0 * np.arange(count), wind)


def means_of_seconds(process: WindProcessParams, count: int, seed: int) -> AveragedWind:
    """10 s means of the process itself, made second by second: tenths of a second hardly matter."""
    random = np.random.default_rng(seed)
    wind = np.tile([0.0, 8.0], (10 * count, 1))
    for memory, variance in zip(process.memory_s, process.variance_m2ps2, strict=True):
        keep = np.exp(-1.0 / memory)
        pushes = np.sqrt(variance * (1.0 - keep**2)) * random.standard_normal((10 * count, 2))
        pushes[0] = np.sqrt(variance) * random.standard_normal(2)
        wind += lfilter([1.0], [1.0, -keep], pushes, axis=0)
    return AveragedWind(10.0 * np.arange(count) + 5.0, wind.reshape(count, 10, 2).mean(axis=1))


# --- the file ------------------------------------------------------------------------------------


def test_every_shipped_process_loads_and_says_where_it_is_from() -> None:
    files = sorted((ROOT / "params" / "wind").glob("*.toml"))
    assert files
    for path in files:
        assert read_wind_process(path.stem).name == path.stem
        assert path.read_text().split("\n")[1].startswith("# How wind changes, fitted to ")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("memory_s", [60.0, 15.0, 1500.0], "memory_s: expected rising numbers"),
        ("variance_m2ps2", [1.0], "variance_m2ps2: 1 numbers: expected 3"),
        ("variance_m2ps2", [1.0, float("nan"), 1.0], "variance_m2ps2"),
        ("reference_wind_mps", 0.0, "reference_wind_mps = 0.0: expected"),
        ("tail_dof", 2.0, "tail_dof = 2.0: expected"),
        ("memory", [1.0], "unknown field `memory`"),
        ("format", "wind-process/2", "format"),
    ],
)
def test_a_wrong_process_file_is_refused_by_name(key: str, value: object, words: str) -> None:
    table = tomllib.loads((ROOT / "params" / "wind" / "coast.toml").read_text())
    table[key] = value
    with pytest.raises(LeewayError, match=r"site\.toml") as refused:
        wind_process_from_dict(table, "site.toml")
    assert words in str(refused.value)


def test_an_unknown_process_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(LeewayError, match="no such wind process; there are: coast"):
        read_wind_process("moon")


def test_a_mean_over_a_time_keeps_the_share_of_variance_that_brute_force_finds() -> None:
    """Var of the mean by the double integral of exp(-|a - b| / T), midpoint rule."""
    at = (np.arange(2000) + 0.5) * 60.0 / 2000
    for memory in (5.0, 15.0, 300.0):
        expected = np.exp(-np.abs(np.subtract.outer(at, at)) / memory).mean()
        assert variance_share_after_averaging(np.array([memory]), 60.0)[0] == pytest.approx(
            expected, rel=1e-4
        )


# --- the fit -------------------------------------------------------------------------------------


def test_the_likelihood_is_that_of_the_joint_normal_law() -> None:
    """Oracle: scipy's multivariate normal, covariance written out here, a gap included."""
    whole = simulated(KNOWN, 60, seed=1)
    keep = np.r_[0:20, 35:60]
    gappy = AveragedWind(whole.t_s[keep], whole.wind_to_ne_mps[keep])
    # Covariance of two means: that of their moments, averaged over both by the midpoint rule.
    inside = (np.arange(400) + 0.5) / 40.0
    apart = np.subtract.outer(inside, inside)

    def of_means(lag_s: float) -> float:
        return float(
            np.exp(-np.abs(apart + lag_s) / 20.0).mean()
            + 1.5 * np.exp(-np.abs(apart + lag_s) / 600.0).mean()
        )

    lag = np.abs(np.subtract.outer(gappy.t_s, gappy.t_s))
    each = {x: of_means(x) for x in np.unique(lag)}
    moved = gappy.wind_to_ne_mps - gappy.wind_to_ne_mps.mean(axis=0)
    scale = (np.hypot(*gappy.wind_to_ne_mps.mean(axis=0)) / 8.0) ** 2
    cov = scale * np.vectorize(each.__getitem__)(lag)
    cov += 100.0 + 0.01 * np.eye(keep.size)
    law = multivariate_normal(np.zeros(keep.size), cov)
    expected = law.logpdf(moved[:, 0]) + law.logpdf(moved[:, 1])
    assert process_log_likelihood(KNOWN, [gappy]) == pytest.approx(expected, rel=1e-5)


@pytest.mark.sample
def test_a_fit_recovers_the_process_that_made_the_wind() -> None:
    made = [means_of_seconds(KNOWN, 360, seed) for seed in (2, 3, 4)]
    fit = fit_wind_process_to_recordings(made, "made", process_part_count=2)
    found = np.log([*fit.process.memory_s, *fit.process.variance_m2ps2])
    true = np.log([*KNOWN.memory_s, *KNOWN.variance_m2ps2])
    assert np.all(np.abs(found - true) < 3.0 * fit.log_std)
    assert fit.log_std[0] < 0.2  # the fast memory is well known from three hours
    assert fit.process.reference_wind_mps == pytest.approx(8.0, abs=1.0)


def test_too_little_wind_is_refused() -> None:
    with pytest.raises(LeewayError, match="600 s of usable wind: expected 1200"):
        fit_wind_process_to_recordings([simulated(KNOWN, 60, seed=4)], "short")


def test_ten_second_means_leave_out_what_is_half_empty() -> None:
    t_s = np.array([t for t in range(60) if not 23 <= t < 38], float)
    wind = np.stack([t_s, -t_s], axis=1)
    runs = average_wind_over_10_s(t_s, wind)
    assert [r.t_s.tolist() for r in runs] == [[5.0, 15.0], [45.0, 55.0]]
    np.testing.assert_allclose(runs[0].wind_to_ne_mps[:, 0], [4.5, 14.5])


# --- tails and scores ----------------------------------------------------------------------------


@pytest.mark.sample
def test_samples_with_a_tail_have_the_stated_variance_and_students_quantiles() -> None:
    forecast = WindForecast(np.array([60.0]), np.zeros((1, 2)), np.eye(1), np.zeros((2, 2)), 6.0)
    drawn = forecast.draw_wind_paths(200_000, np.random.default_rng(5))[:, 0, 0]
    assert drawn.var() == pytest.approx(1.0, abs=0.03)
    expected = student_t.ppf(0.995, 6.0) * np.sqrt(4.0 / 6.0)
    assert np.quantile(drawn, 0.995) == pytest.approx(expected, rel=0.03)


def test_errors_as_stated_score_as_stated() -> None:
    errors = np.random.default_rng(9).standard_normal((200_000, 4))
    score = score_forecasts("drawn", 60.0, (errors, np.ones_like(errors)))
    assert score.coverage == pytest.approx((0.9, 0.98, 0.99, 0.999), abs=1e-3)
    assert score.upper99_ratio == pytest.approx(1.0, abs=0.01)


def test_the_tail_that_is_fitted_is_that_of_the_errors() -> None:
    random = np.random.default_rng(6)
    heavy = random.standard_t(5.0, 24_000)
    normal = random.standard_normal(24_000)
    assert fit_student_t_dof([heavy]) in (5.0, 6.0)
    assert fit_student_t_dof([normal]) in (None, 30.0)
    assert fit_student_t_dof([normal, 3.0 * normal]) in (None, 30.0)  # two sites, no tail
    assert fit_student_t_dof([]) is None


def test_what_the_process_says_of_its_own_wind_is_calibrated() -> None:
    judged = [simulated(KNOWN, 260, seed) for seed in range(10, 15)]
    random = np.random.default_rng(7)
    for horizon_s in (60.0, 600.0):
        z, inside = [], []
        for means in judged:
            said = outlook_forecasts_by_horizon(
                KNOWN, ValidationInterval(means, 800.0, 2600.0), 0.4, random
            )
            error, std = said[horizon_s]
            z.append(error / std)
            inside.append(score_forecasts("own", horizon_s, said[horizon_s]).coverage[0])
        assert np.sqrt(np.mean(np.concatenate(z) ** 2)) == pytest.approx(1.0, abs=0.15)
        assert np.mean(inside) == pytest.approx(0.90, abs=0.05)


@pytest.mark.sample
def test_held_out_the_fit_beats_running_means_where_wind_reverts() -> None:
    found = cross_validate_wind_process([simulated(KNOWN, 480, seed=20)], process_part_count=2)
    assert found is not None
    assert len(found.folds) == 2
    by = {(s.method, s.horizon_s): s for s in found.scores}
    for horizon_s in (150.0, 300.0):
        ours = by[FITTED, horizon_s]
        assert ours.error_rms_mps < by[PERSISTENCE, horizon_s].error_rms_mps
        assert ours.nll < by[PERSISTENCE, horizon_s].nll
        assert ours.error_rms_mps < 1.05 * by[LONG_MEAN, horizon_s].error_rms_mps


def test_a_recording_that_cannot_be_divided_has_no_held_out_score() -> None:
    assert (
        cross_validate_wind_process([simulated(KNOWN, 150, seed=21)], process_part_count=2) is None
    )


# --- the planner's chains ------------------------------------------------------------------------


def belief(t_s: float, north: float, east: float) -> WindBelief:
    return WindBelief(t_s, np.array([north, east]), 0.25 * np.eye(2), ("tilt",), True)
