"""Scatter by days, charges and flights: closed form, statsmodels, stated coverage."""

import numpy as np
import pytest

from companion.analysis.measured_energy.energy_scatter import (
    charge_number_by_flight,
    fit_energy_ratio_scatter,
)
from companion.core.base.errors import LeewayError


def drawn(rng, days, per_charge, charges, stds):
    """Return logarithms with their labels; stds of day, charge, flight."""
    logs, day_names, numbers = [], [], []
    for day in range(days):
        of_day = rng.normal(0.0, stds[0])
        for charge in range(charges):
            of_charge = rng.normal(0.0, stds[1])
            for _ in range(per_charge):
                logs.append(of_day + of_charge + rng.normal(0.0, stds[2]))
                day_names.append(f"d{day:03}")
                numbers.append(day * charges + charge)
    return np.array(logs), day_names, numbers


@pytest.mark.sample
def test_balanced_variances_are_those_of_the_analysis_of_variance():
    # Nested and balanced, estimates in the interior: REML is the analysis of variance (Searle,
    # Casella and McCulloch, Variance Components, 1992, 4.3).
    logs, days, charges = drawn(np.random.default_rng(3), 12, 3, 4, (0.03, 0.02, 0.02))
    cube = logs.reshape(12, 4, 3)
    within = cube.var(axis=2, ddof=1).mean()
    by_charge = 3 * cube.mean(axis=2).var(axis=1, ddof=1).mean()
    by_day = 12 * cube.mean(axis=(1, 2)).var(ddof=1)
    found = fit_energy_ratio_scatter(logs, days, charges)
    assert found.flight_variance == pytest.approx(within, rel=1e-3)
    assert found.charge_variance == pytest.approx((by_charge - within) / 3, rel=1e-2)
    assert found.day_variance == pytest.approx((by_day - by_charge) / 12, rel=1e-2)
    assert found.mean == pytest.approx(logs.mean())


@pytest.mark.sample
def test_unbalanced_variances_are_those_of_statsmodels():
    mixed = pytest.importorskip("statsmodels.regression.mixed_linear_model")
    rng = np.random.default_rng(8)
    logs, days, charges = drawn(rng, 11, 3, 4, (0.02, 0.015, 0.02))
    kept = np.sort(rng.permutation(len(logs))[:95])
    logs, days = logs[kept], [days[i] for i in kept]
    charges = [charges[i] for i in kept]
    names = np.array(charges)
    indicator = (names[:, None] == np.unique(names)[None, :]).astype(float)
    by_day = [indicator[np.array(days) == day] for day in sorted(set(days))]
    by_day = {day: m[:, m.any(axis=0)] for day, m in zip(sorted(set(days)), by_day, strict=True)}
    vcs = mixed.VCSpec(
        ["charge"],
        [[[f"c{i}" for i in range(m.shape[1])] for m in by_day.values()]],
        [list(by_day.values())],
    )
    ones = np.ones((len(logs), 1))
    scale = 100.0  # its optimiser needs numbers of about one
    model = mixed.MixedLM(scale * logs, ones, days, exog_re=ones, exog_vc=vcs)
    other = model.fit(reml=True)
    found = fit_energy_ratio_scatter(logs, days, charges)
    assert found.day_variance == pytest.approx(float(other.cov_re[0, 0]) / scale**2, rel=0.03)
    assert found.charge_variance == pytest.approx(float(other.vcomp[0]) / scale**2, rel=0.03)
    assert found.flight_variance == pytest.approx(float(other.scale) / scale**2, rel=0.03)
    assert found.mean == pytest.approx(float(other.fe_params[0]) / scale, abs=1e-4)


@pytest.mark.sample
def test_the_bound_covers_its_share_of_flights_on_new_days():
    # 150 campaigns of ten days, each with one flight on another day: 95 % +- 1.8 % (one sigma,
    # binomial). A bound that treats flights as exchangeable covers 87 %.
    rng = np.random.default_rng(5)
    stds, under, plain = (0.03, 0.01, 0.015), 0, 0
    for _ in range(150):
        logs, days, charges = drawn(rng, 10, 2, 3, stds)
        new = rng.normal(0.0, np.sqrt(np.sum(np.square(stds))))
        under += new <= np.log(
            fit_energy_ratio_scatter(logs, days, charges).upper_bound_factor(0.95)
        )
        plain += new <= logs.mean() + 1.645 * logs.std() * np.sqrt(1 / len(logs))
    assert 0.91 <= under / 150 <= 0.99
    assert plain / 150 < 0.9


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_bound_follows_the_measured_tail_of_flights(sign):
    # Exponential deviations of 2 %: their 95 % quantile is 2.00 or, mirrored, 0.95 of their std; a
    # normal's is 1.64.
    rng = np.random.default_rng(7)
    days = [f"d{number // 12:02}" for number in range(240)]
    logs = sign * 0.02 * (rng.exponential(1.0, 240) - 1.0)
    found = fit_energy_ratio_scatter(logs, days, range(240))
    share = 0.95 if sign > 0.0 else 0.05
    quantile = sign * 0.02 * (-np.log(1.0 - share) - 1.0)
    assert np.log(found.upper_bound_factor(0.95)) == pytest.approx(quantile, rel=0.15)


def test_flights_too_few_for_the_quantile_are_bounded_as_a_day():
    logs, days, charges = drawn(np.random.default_rng(4), 3, 3, 1, (0.01, 0.0, 0.015))
    found = fit_energy_ratio_scatter(logs, days, charges)
    t_of_two_days = 2.92
    assert np.log(found.upper_bound_factor(0.95)) == pytest.approx(
        found.mean + t_of_two_days * found.std, rel=1e-3
    )


def test_equal_flights_are_bounded_by_what_they_drew():
    days = [f"d{number // 5}" for number in range(40)]
    found = fit_energy_ratio_scatter(np.full(40, 0.01), days, range(40))
    assert np.log(found.upper_bound_factor(0.95)) == pytest.approx(0.01, abs=5e-4)


def test_days_that_differ_widen_the_bound():
    rng = np.random.default_rng(2)
    alike = fit_energy_ratio_scatter(*drawn(rng, 10, 3, 3, (0.0, 0.0, 0.02)))
    apart = fit_energy_ratio_scatter(*drawn(rng, 10, 3, 3, (0.03, 0.0, 0.02)))
    assert (
        apart.upper_bound_factor(0.95) / apart.median_factor
        > alike.upper_bound_factor(0.95) / alike.median_factor + 0.02
    )


def test_two_days_tell_nothing_of_a_third():
    with pytest.raises(LeewayError, match="2 days, at least 3"):
        fit_energy_ratio_scatter(np.zeros(6), ["a", "a", "a", "b", "b", "b"], [0, 0, 1, 2, 2, 3])


def test_a_charge_ends_with_the_day_and_where_the_voltage_rises():
    days = ["a", "a", "a", "a", "b", "b"]
    assert charge_number_by_flight(days, [25.6, 24.5, 23.4, 25.5, 25.4, 24.3]) == [0, 0, 0, 1, 2, 2]
