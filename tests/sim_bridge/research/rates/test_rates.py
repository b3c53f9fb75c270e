"""Subset simulation against closed forms, and the deliveries that it draws."""

import math

import numpy as np
import pytest
from scipy.special import ndtr

from sim_bridge.research.rates.mission import DeliveryWorld
from sim_bridge.research.rates.study import (
    PLAIN,
    SUBSET,
    RateRow,
    RateRun,
    combine_runs_of_rate,
    list_runs,
    losses_by_accepted_rate_sheet,
    method_comparison_sheet,
    method_difference_in_standard_errors,
)
from sim_bridge.research.rates.subset import subset_simulation
from sim_bridge.research.study.intervals import share_upper95
from sim_bridge.truth.wind_days import build_day_process, day_wind_series


@pytest.mark.sample
@pytest.mark.parametrize(("sigmas", "dimensions"), [(2.0, 5), (4.0, 200)])
def test_a_rare_event_of_known_chance_is_found(sigmas, dimensions):
    """The mean of 200 standard normals over 4 sigma: 3.2e-5, by 3,700 evaluations a run."""

    def performance(normal):
        return float(normal.sum()) / math.sqrt(normal.size) - sigmas

    runs = [
        subset_simulation(performance, dimensions, 800, np.random.default_rng([7, k]))
        for k in range(12)
    ]
    true = float(ndtr(-sigmas))
    mean = np.mean([run.chance for run in runs])
    scatter = np.std([run.chance for run in runs], ddof=1)
    assert mean == pytest.approx(true, abs=3.5 * scatter / math.sqrt(len(runs)))
    assert scatter / true < 0.8
    # The error that a run states is about the scatter between runs.
    assert np.mean([run.variation for run in runs]) == pytest.approx(scatter / true, rel=0.7)
    assert all(list(run.levels) == sorted(run.levels) for run in runs)
    assert max(run.evaluations for run in runs) < 800 * 6


def test_what_never_fails_has_no_chance_and_says_so():
    found = subset_simulation(
        lambda normal: -1.0 - float(normal @ normal), 3, 100, np.random.default_rng(1), 3
    )
    assert (found.chance, found.variation) == (0.0, math.inf)
    # Its levels reached a probability of 1e-3: more than that is excluded, less is not.
    assert 1e-3 < found.upper95 < 6e-3


def test_chains_that_stand_still_say_a_limit_and_no_estimate():
    # Islands everywhere: a step of any length is as good as a new draw, so that beyond the second
    # level one in a hundred is accepted. The true chance is 1e-4.
    def performance(normal):
        return math.fmod(1e6 * abs(float(normal.sum())), 1.0) - (1.0 - 1e-4)

    found = subset_simulation(performance, 5, 400, np.random.default_rng(5))
    assert (found.chance, found.variation) == (0.0, math.inf)
    assert 1e-4 < found.upper95 < 0.03


def test_the_limit_holds_in_19_runs_of_20_however_the_run_ended():
    # True chances: 3.2e-5 of a mean over 4 sigma; runs of two levels only have no estimate.
    def performance(normal):
        return float(normal.sum()) / math.sqrt(normal.size) - 4.0

    true = float(ndtr(-4.0))
    for levels in (2, 8):
        runs = [
            subset_simulation(performance, 20, 200, np.random.default_rng([9, k]), levels)
            for k in range(20)
        ]
        assert sum(run.upper95 >= true for run in runs) >= 17
        assert all((run.chance == 0.0) is (levels == 2) for run in runs)
    assert np.median([run.upper95 for run in runs]) < 10.0 * true


def test_nothing_seen_of_independent_trials_is_the_rule_of_three():
    assert share_upper95(0, 300) == pytest.approx(3.0 / 300, rel=0.01)
    # Clopper and Pearson, tables of 1934: 5 of 50, upper 95 % one-sided (97.5 of 90 %) 0.199.
    assert share_upper95(5, 50) == pytest.approx(0.199, abs=0.001)


def test_what_fails_often_is_counted_in_one_level():
    found = subset_simulation(lambda n: float(n[0]) + 0.5, 2, 2000, np.random.default_rng(2))
    assert found.evaluations == 2000
    assert found.chance == pytest.approx(float(ndtr(0.5)), abs=0.04)


def test_the_wind_has_the_days_spread():
    rng, process = np.random.default_rng(3), build_day_process(8.0, 0.0)
    wind = np.array(
        [day_wind_series(process, rng.standard_normal((3, 400, 2)))[-1] for _ in range(600)]
    )
    spread = 8.0 * math.sqrt(0.10**2 + 0.09**2 + 0.165**2)
    assert wind.mean(axis=0) == pytest.approx([8.0, 0.0], abs=0.25)
    assert wind.std(axis=0) == pytest.approx([spread, spread], rel=0.12)


@pytest.mark.sample
def test_the_same_numbers_fly_the_same_and_a_stricter_rate_goes_less_often():
    loose, strict = DeliveryWorld(0.1), DeliveryWorld(1e-5)
    rng = np.random.default_rng(4)
    drawn = [rng.standard_normal(loose.random_variable_count) for _ in range(40)]
    flown = [loose.simulate_delivery(one) for one in drawn]
    assert flown[0] == loose.simulate_delivery(drawn[0])
    careful = [strict.simulate_delivery(one) for one in drawn]
    assert sum(one.delivered for one in careful) < sum(one.delivered for one in flown)
    assert all(one.shortfall == -1.0 for one in flown if not one.departed)
    assert all(0.01 < one.flown_h < 0.3 for one in flown if one.departed)


def test_a_pack_that_holds_nothing_is_a_loss_and_one_of_twice_the_energy_is_none():
    loose = DeliveryWorld(0.1)
    drawn = np.random.default_rng(4).standard_normal(loose.random_variable_count)
    while not loose.simulate_delivery(drawn).departed:
        drawn = np.roll(drawn, 4)
    for pack, lost in ((-45.0, True), (50.0, False)):  # of 2 % each
        drawn[3] = pack
        assert (loose.simulate_delivery(drawn).shortfall > 0.0) is lost


def run(method, chance, variation=0.2, upper=0.05, hours=20.0):
    return RateRun(0.1, method, chance, variation, upper, 840, 300, 240, 200, hours)


def test_rates_are_per_hour_flown_and_their_error_is_the_larger_of_scatter_and_stated():
    row = combine_runs_of_rate(0.1, SUBSET, [run(SUBSET, 0.01), run(SUBSET, 0.03)])
    assert row.lost_per_hour == pytest.approx(0.02 * 600 / 40.0)
    assert row.std_per_hour == pytest.approx(0.01 * 600 / 40.0)
    assert row.most_per_hour == pytest.approx((0.02 + 1.645 * 0.01) * 600 / 40.0)
    assert row.minutes == pytest.approx(60.0 * 40.0 / 480)
    plain = combine_runs_of_rate(0.1, PLAIN, [run(PLAIN, 0.02)])
    assert plain.std_per_hour == pytest.approx(math.sqrt(0.02 * 0.98 / 300) * 300 / 20.0)


def test_a_row_without_an_estimate_says_its_limit_and_never_nought_with_no_error():
    stood = run(SUBSET, 0.0, None, 0.001)
    row = combine_runs_of_rate(0.1, SUBSET, [stood, run(SUBSET, 0.0, None, 0.003)])
    assert (row.lost_per_hour, row.std_per_hour) == (None, None)
    assert row.most_per_hour == pytest.approx(0.002 * 600 / 40.0)
    mixed = combine_runs_of_rate(0.1, SUBSET, [stood, run(SUBSET, 0.002)])
    assert mixed.most_per_hour > row.most_per_hour
    counted = combine_runs_of_rate(0.1, PLAIN, [run(PLAIN, 0.0, None, 0.01)] * 10)
    assert counted.lost_per_hour is None
    assert counted.most_per_hour == pytest.approx(3.0 / 200.0, rel=0.01)  # of 200 hours
    sheet = losses_by_accepted_rate_sheet([row, mixed, counted]).to_markdown()
    assert "| none seen |  | 3.0e-02 |" in sheet
    assert "0.0e+00" not in sheet
    assert "no estimate" in method_comparison_sheet(counted, row).note
    nothing = combine_runs_of_rate(0.1, SUBSET, [run(SUBSET, 0.0, None, 1.0, 0.0)])
    assert "none flew" in losses_by_accepted_rate_sheet([nothing]).to_markdown()


def test_agreement_is_in_standard_errors_of_the_difference():
    def row(lost, std):
        return RateRow(0.1, PLAIN, lost, std, 1.0, 1.0, 1.0, 5.0, 100, 100)

    assert method_difference_in_standard_errors(row(0.10, 0.03), row(0.15, 0.04)) == pytest.approx(
        1.0
    )


def test_every_run_has_a_seed_of_its_own():
    found = list_runs((1e-2,), 300, 2, 500, 1)
    keys = {(w.rate, w.method, w.part) for w in found}
    assert len(keys) == len(found) == 6
