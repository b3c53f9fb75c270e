"""E-processes: at best fair while the certificate holds, at any stopping time, with day effects."""

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from companion.core.monitor.e_process import (
    ShareTest,
    ShiftTest,
    prior_weight_after_day,
    prior_weight_of_change_day,
)
from companion.core.monitor.promises import DRAW_STD, DRAW_TEST, PACK_TEST, WIND_TEST

SERVICES = 20_000


def seasons(test, std, values):
    """Return log e after each flight, (days, flights, services), of values of that shape."""
    evidence = test.initial_evidence(values.shape[2:])
    told = []
    for day in values:
        evidence = test.start_next_day(evidence)
        for value in day:
            evidence = test.with_added_flight(evidence, value, std)
            told.append(test.log_e_value(evidence))
    return np.array(told)


def null(days, flights, day_std, flight_std, mean, seed=11):
    """Draw from the null by its definition, without code shared with the study."""
    rng = np.random.default_rng(seed)
    common = rng.normal(mean, day_std, (days, 1, SERVICES))
    return common + rng.normal(0.0, flight_std, (days, flights, SERVICES))


def test_weights_of_all_starting_days_sum_to_one():
    for days in (1, 7, 400):
        given = math.fsum(prior_weight_of_change_day(day) for day in range(1, days + 1))
        assert given + prior_weight_after_day(days) == pytest.approx(1.0, abs=1e-12)


def test_a_bet_is_the_likelihood_ratio_of_a_days_flights_that_share_an_effect():
    test = ShiftTest(tolerance=0.01, day_std=0.02, shifts=(0.05,), max_value=10.0)
    values, std = np.array([0.04, 0.09, -0.01]), 0.03
    evidence = test.start_next_day(test.initial_evidence())
    for value in values:
        evidence = test.with_added_flight(evidence, value, std)
    cov = 0.02**2 * np.ones((3, 3)) + std**2 * np.eye(3)
    rise, none = (
        multivariate_normal(np.full(3, mean), cov).pdf(values) for mean in (0.01 + 0.05, 0.01)
    )
    # One bet starts on this first day; the weight of later days is not staked yet.
    expected = prior_weight_of_change_day(1) * rise / none + prior_weight_after_day(1)
    assert float(test.log_e_value(evidence)) == pytest.approx(math.log(expected), abs=1e-9)


@pytest.mark.parametrize("flights", [1, 4, 10])
def test_while_the_promise_holds_the_mean_evidence_is_at_most_one_whenever_one_stops(flights):
    values = null(6, flights, DRAW_TEST.day_std, DRAW_STD, DRAW_TEST.tolerance)
    e = np.exp(seasons(DRAW_TEST, DRAW_STD, values))
    # Of e capped at 20 the variance is at most 20, and of 20,000 services the mean's standard error
    # 0.032: four of them. The random seed is fixed.
    assert np.minimum(e, 20.0).mean(axis=1).max() <= 1.13
    # Stopping rule that favours an alarm: at the first evidence of 3, else at the end.
    reached = e >= 3.0
    stop = np.where(reached.any(axis=0), reached.argmax(axis=0), len(e) - 1)
    assert np.minimum(e[stop, np.arange(SERVICES)], 20.0).mean() <= 1.13
    assert reached.any(axis=0).mean() <= 1.0 / 3.0, "Ville's inequality"


def test_a_monitor_that_takes_the_flights_of_a_day_as_independent_alarms_falsely():
    values = null(20, 10, DRAW_TEST.day_std, DRAW_STD, DRAW_TEST.tolerance)[..., :2000]
    limit = math.log(200.0)
    aware = seasons(DRAW_TEST, DRAW_STD, values).max(axis=0) >= limit
    whole_std = math.hypot(DRAW_TEST.day_std, DRAW_STD)  # includes the full scatter of a flight
    blind_test = ShiftTest(DRAW_TEST.tolerance, 0.0, DRAW_TEST.shifts, DRAW_TEST.max_value)
    blind = seasons(blind_test, whole_std, values).max(axis=0) >= limit
    assert aware.mean() <= 0.005
    assert blind.mean() > 0.05


def test_a_lower_draw_than_promised_is_never_evidence():
    values = null(20, 5, 0.018, 0.028, mean=-0.10)
    assert seasons(DRAW_TEST, DRAW_STD, values).max() < math.log(10.0)


def test_one_wild_figure_alone_is_no_alarm_and_wipes_out_no_evidence():
    wild = seasons(DRAW_TEST, DRAW_STD, np.full((1, 1, 1), 1.3))
    assert wild[-1, 0] < math.log(200.0)
    risen = np.full((4, 10, 1), 0.12)
    risen[0, 3] = -1.3
    assert seasons(DRAW_TEST, DRAW_STD, risen)[-1, 0] > math.log(200.0)


def test_evidence_stays_finite_however_long_a_draw_is_too_high():
    told = seasons(DRAW_TEST, DRAW_STD, np.full((500, 10, 1), 0.15))
    assert np.isfinite(told).all()
    assert np.all(np.diff(told[::10, 0]) > 0.0)


def test_the_estimate_since_a_change_forgets_the_days_before_it():
    precision = np.full(30, 10 / DRAW_STD**2)
    excess = np.where(np.arange(30) < 24, 0.0, 0.10) - DRAW_TEST.tolerance
    mean, std = DRAW_TEST.mean_and_std_since_change(precision, precision * excess)
    assert float(mean) == pytest.approx(0.10, abs=1e-9)
    # Six days of ten flights, and the shared part of the next day.
    of_a_day = DRAW_TEST.day_std**2 + DRAW_STD**2 / 10
    assert float(std) == pytest.approx(math.sqrt(of_a_day / 6 + DRAW_TEST.day_std**2), rel=1e-9)


def test_the_estimate_of_a_slow_drift_is_that_of_its_last_days():
    drift = np.linspace(0.0, 0.29, 50)
    precision = np.full(50, 3 / 0.055**2)
    mean, std = PACK_TEST.mean_and_std_since_change(
        precision, precision * (drift - PACK_TEST.tolerance)
    )
    assert abs(float(mean) - drift[-1]) < float(std) + 0.02


def test_shares_of_failed_checks_bet_fairly_on_any_distribution_of_days():
    rng = np.random.default_rng(3)
    # On one day in five half of the checks fail, on others none: a tenth, all on a day together.
    bad = rng.random((40, SERVICES)) < 0.2
    evidence = WIND_TEST.initial_evidence((SERVICES,))
    worst = 0.0
    for day in bad:
        evidence = WIND_TEST.start_next_day(evidence)
        worst = max(worst, float(np.exp(WIND_TEST.log_e_value(evidence)).mean()))
        evidence = WIND_TEST.with_added_flight(evidence, 3.0 * day, 6.0)
    assert worst <= 1.05


def test_a_stake_that_could_lose_more_than_there_is_is_refused():
    with pytest.raises(ValueError, match="stakes"):
        ShareTest(allowed=0.1, stakes=(10.0,))
