"""Wind forecast: against the process itself, and against a recording."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from companion.core.base.errors import LeewayError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from companion.core.wind.process import WindProcessParams

ROOT = Path(__file__).parents[3]
COAST = ROOT.parent / "shared" / "data" / "wind" / "coast_2023_1hz.csv"
# The process that was first fitted by hand; the tests below hold for any.
PROCESS = WindProcessParams(
    format="wind-process/1",
    name="by hand",
    memory_s=(15.0, 150.0, 1500.0),
    variance_m2ps2=(1.0, 0.6, 1.5),
    reference_wind_mps=8.6,
    least_scale=0.75,
    most_scale=1.8,
    level_std_mps=10.0,
    seen_noise_std_mps=0.4,
)
HORIZONS = np.array([0.0, 30.0, 120.0, 300.0, 600.0, 1200.0])


def belief(t_s: float, north: float, east: float, std: float = 0.5) -> WindBelief:
    cov = std**2 * np.eye(2)
    return WindBelief(t_s, np.array([north, east]), cov, ("tilt",), True)


def followed(north: float, east: float, seconds: int = 300) -> WindOutlook:
    outlook = WindOutlook(PROCESS)
    for t in range(0, seconds + 1, 5):
        outlook.update_from_estimate(belief(float(t), north, east))
    return outlook


def test_steady_wind_is_expected_to_stay() -> None:
    forecast = followed(3.0, -8.0).forecast(belief(301.0, 3.0, -8.0), HORIZONS)
    np.testing.assert_allclose(forecast.mean_to_ne_mps, np.tile([3.0, -8.0], (6, 1)), atol=0.3)


def test_the_further_ahead_the_less_certain() -> None:
    forecast = followed(3.0, -8.0).forecast(belief(301.0, 3.0, -8.0), HORIZONS)
    assert np.all(np.diff(np.diag(forecast.change_cov_m2ps2)) > 0.0)


def test_a_gust_is_expected_to_pass_and_a_lasting_change_to_stay() -> None:
    outlook = followed(0.0, -6.0)
    gust = outlook.forecast(belief(305.0, 0.0, -9.0), HORIZONS).mean_to_ne_mps[:, 1]
    for t in range(305, 905, 5):
        outlook.update_from_estimate(belief(float(t), 0.0, -9.0))
    lasting = outlook.forecast(belief(906.0, 0.0, -9.0), HORIZONS).mean_to_ne_mps[:, 1]
    assert -7.5 < gust[3] < -6.0
    assert lasting[3] < -8.0


def test_the_covariance_is_one_and_the_samples_have_it() -> None:
    forecast = followed(1.0, 7.0).forecast(belief(301.0, 1.0, 7.0, std=0.8), HORIZONS)
    cov = forecast.total_cov_m2ps2
    assert np.linalg.eigvalsh(cov)[0] > -1e-9
    paths = forecast.draw_wind_paths(40_000, np.random.default_rng(4))
    assert paths.shape == (40_000, 6, 2)
    np.testing.assert_allclose(paths.mean(axis=0), forecast.mean_to_ne_mps, atol=0.04)
    np.testing.assert_allclose(np.cov(paths.reshape(40_000, 12).T), cov, atol=0.09)


def test_the_estimates_own_error_stays_at_every_horizon() -> None:
    outlook = followed(0.0, 8.0)
    sure = outlook.forecast(belief(301.0, 0.0, 8.0, std=0.4), HORIZONS)
    unsure = outlook.forecast(belief(301.0, 0.0, 8.0, std=1.2), HORIZONS)
    np.testing.assert_allclose(sure.error_cov_m2ps2, 0.0, atol=1e-12)
    np.testing.assert_allclose(unsure.error_cov_m2ps2, (1.44 - 0.16) * np.eye(2))


def test_the_weights_are_the_best_linear_predictor_of_the_process() -> None:
    """Brute force: condition the joint Gaussian of all observations and the future at once."""
    memory, variance = np.array([15.0, 150.0, 1500.0]), np.array([1.0, 0.6, 1.5])
    times = np.arange(0.0, 301.0, 5.0)
    rng = np.random.default_rng(5)
    speeds = -4.0 + rng.normal(0.0, 1.0, times.size)

    def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        lag = np.abs(a[:, None] - b[None, :])
        parts = sum(v * np.exp(-lag / m) for v, m in zip(variance, memory, strict=True))
        return parts + 100.0

    seen = covariance(times, times) + 0.16 * np.eye(times.size)
    ahead = covariance(times[-1] + HORIZONS[1:], times)
    expected = ahead @ np.linalg.solve(seen, speeds)
    outlook = WindOutlook(PROCESS)
    for t, speed in zip(times[:-1], speeds[:-1], strict=True):
        # The scale follows the speed seen, so hold it at 1: the other axis makes 8.6 of it.
        outlook.update_from_estimate(_scaled(float(t), float(speed)))
    forecast = outlook.forecast(_scaled(float(times[-1]), float(speeds[-1])), HORIZONS[1:])
    np.testing.assert_allclose(forecast.mean_to_ne_mps[:, 1], expected, atol=0.01)


def _scaled(t_s: float, east: float) -> WindBelief:
    return belief(t_s, math.sqrt(8.6**2 - east**2), east)


def test_an_unknown_wind_is_ignored_and_forecast_as_unknown() -> None:
    outlook = WindOutlook(PROCESS)
    nothing = WindBelief(5.0, np.zeros(2), 64.0 * np.eye(2), (), False)
    outlook.update_from_estimate(nothing)
    forecast = outlook.forecast(nothing, HORIZONS)
    assert np.diag(forecast.change_cov_m2ps2).min() > 50.0


def test_a_restart_keeps_the_history() -> None:
    outlook = followed(2.0, -5.0)
    again = WindOutlook(PROCESS)
    again.restore(outlook.snapshot())
    now = belief(310.0, 1.0, -7.0)
    ours, theirs = outlook.forecast(now, HORIZONS), again.forecast(now, HORIZONS)
    np.testing.assert_array_equal(ours.mean_to_ne_mps, theirs.mean_to_ne_mps)
    np.testing.assert_array_equal(ours.change_cov_m2ps2, theirs.change_cov_m2ps2)
    with pytest.raises(LeewayError):
        again.restore({"format": "wind-outlook/1", "t_s": None, "parts": [[1.0]], "cov": []})


def test_the_stated_quantiles_cover_what_the_coast_recording_did() -> None:
    """The mean over the next 150, 600 and 1200 s, from what was seen before."""
    if not COAST.exists():
        pytest.skip(f"{COAST} is not here")
    rows = list(csv.DictReader(COAST.read_text().splitlines()))
    speed = np.array([float(r["wind_speed_mps"]) for r in rows])
    from_rad = np.radians([float(r["wind_from_deg"]) for r in rows])
    wind = -np.stack([speed * np.cos(from_rad), speed * np.sin(from_rad)], axis=1)
    total = np.vstack([np.zeros(2), np.cumsum(wind, axis=0)])
    rng = np.random.default_rng(6)
    for ahead_s, worst_error in ((150, 1.05), (600, 1.05), (1200, 1.05)):
        normalised, errors = [], []
        for start in range(0, len(wind) - ahead_s - 310, 61):
            outlook = WindOutlook(PROCESS)
            for t in range(start, start + 301, 5):
                low = max(t - 9, 0)
                seen = (total[t + 1] - total[low]) / (t + 1 - low) + rng.normal(0.0, 0.3, 2)
                now = belief(float(t), seen[0], seen[1])
                outlook.update_from_estimate(now)
            middles = (np.arange(10) + 0.5) * ahead_s / 10.0
            forecast = outlook.forecast(now, middles)
            mean = (total[t + ahead_s] - total[t]) / ahead_s
            error = mean - forecast.mean_to_ne_mps.mean(axis=0)
            variance = forecast.change_cov_m2ps2.mean() + forecast.error_cov_m2ps2[0, 0]
            errors.append(error)
            normalised.append(error / math.sqrt(variance))
        spread = np.sqrt(np.mean(np.square(errors), axis=0))
        assert spread.max() < worst_error  # 0.7 to 1.0 m/s with 300 s of history
        # A few independent winds only: about 1 is right, far below would be useless caution.
        assert 0.6 < np.sqrt(np.mean(np.square(normalised))) < 1.25
        assert np.mean(np.abs(normalised) > 2.576) < 0.03  # stated: 0.01
