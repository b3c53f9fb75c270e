"""The ideal test of fronts: its covariance is the truth's, and its odds are likelihood ratios."""

import numpy as np
import pytest

from companion.core.base.arrays import Floats
from sim_bridge.research.fleet_wind.alert_study import Beliefs, beliefs
from sim_bridge.research.fleet_wind.front_bound import (
    LOG_ODDS,
    LOOK_S,
    BoundFigures,
    FrontLaw,
    IdealObserver,
    judge_bounds,
)
from sim_bridge.research.fleet_wind.patrols import Patrol, patrols
from sim_bridge.truth.fields.coherent_field import Coherence, CoherentField
from sim_bridge.truth.fields.front import PassingFront
from sim_bridge.truth.fields.site_wind import SiteWind

COHERENCE = Coherence(4.0, 13.0)
SECONDS = 300


def gusts(rng: np.random.Generator, seconds: int = SECONDS) -> Floats:
    """Eight metres a second to the south with gusts of 0.8 m/s that last 30 s."""
    keep, found = np.exp(-1.0 / 30.0), np.zeros((seconds, 2))
    for k in range(1, seconds):
        found[k] = keep * found[k - 1] + 0.8 * np.sqrt(1.0 - keep**2) * rng.standard_normal(2)
    return found + np.array([-8.0, 0.5])


def another(series: Floats, rng: np.random.Generator) -> Floats:
    """A series of the same spectrum: its phases are drawn anew, so that the middle is, too."""
    mean = series.mean(axis=0)
    turned = np.fft.rfft(series - mean, axis=0)
    turned *= np.exp(2j * np.pi * rng.random(turned.shape))
    return mean + np.fft.irfft(turned, series.shape[0], axis=0)


def told_in(
    field: CoherentField, ways: list[Patrol], rng: np.random.Generator, *fronts: PassingFront
) -> Beliefs:
    return beliefs(SiteWind(field, fronts), ways, 0.0, float(field.seconds), rng)


def test_the_covariance_is_that_of_drawn_winds_at_two_places_and_times() -> None:
    """Over 60 fields: of 80 m along, 20 m across and 12 s, against the sample's."""
    rng = np.random.default_rng(1)
    series = gusts(rng)
    along, across, later_s = 80.0, 20.0, 12.0
    products: list[Floats] = []
    for _ in range(60):
        field = CoherentField(another(series, rng), COHERENCE, rng)
        t_s = np.arange(40.0, 240.0, 5.0)
        unit = field.mean_ne_mps / field.mean_mps
        first = np.array([-600.0, 300.0])
        second = first + along * unit + across * np.array([-unit[1], unit[0]])
        winds = [
            field.turned(field.to_ne_mps(times, *np.tile(place, (times.size, 1)).T))
            - field.expected_turned_mps(times, *np.tile(place, (times.size, 1)).T)
            for place, times in ((first, t_s), (second, t_s + later_s))
        ]
        products.append((winds[0] * winds[1]).mean(axis=0))
    found, std = np.mean(products, axis=0), np.std(products, axis=0) / np.sqrt(60.0)
    apart_m = np.hypot(4.0 * along, 13.0 * across)
    lag_s = later_s - along / field.mean_mps
    table = field.covariances_m2ps2(np.array([0.0, apart_m]), 0.0)
    low = int(abs(lag_s))
    said = table[:, 1, low] + (abs(lag_s) - low) * (table[:, 1, low + 1] - table[:, 1, low])
    assert said == pytest.approx(found, abs=4.0 * float(std.max()))
    assert (said > 5.0 * std).all(), "there is something to compare"
    assert (table[:, 0, 0] > 1.2 * said).all()


def test_the_mean_odds_without_a_front_are_one_and_with_it_more() -> None:
    """What a likelihood ratio is: its mean is one where there is no front, whatever the wind does.

    A weak front, so that the mean of some hundred odds is known to a few hundredths.
    """
    rng = np.random.default_rng(2)
    series = gusts(rng)
    ways = patrols(4, 2, float(SECONDS), rng)
    weak = PassingFront(150.0, 170.0, 6.0, (-0.3, 0.05), 30.0)
    calm: list[float] = []
    amid: list[float] = []
    for _ in range(40):
        field = CoherentField(another(series, rng), COHERENCE, rng)
        observer, law = IdealObserver(field, COHERENCE, ways), FrontLaw.known(weak)
        told = told_in(field, ways, rng), told_in(field, ways, rng, weak)
        for index in (160, 220, 280):
            one, other = np.exp(observer.log_odds(index, (law,), told))[0]
            calm.append(one)
            amid.append(other)
    error = float(np.std(calm)) / np.sqrt(40.0)
    assert error < 0.15
    assert np.mean(calm) == pytest.approx(1.0, abs=3.0 * error)
    assert np.mean(amid) > np.mean(calm) + 3.0 * error


def test_a_front_is_told_by_both_soon_after_it_is_felt_and_nothing_is_told_without() -> None:
    rng = np.random.default_rng(4)
    series = gusts(rng, 900)
    field, ways = CoherentField(series, COHERENCE, rng), patrols(6, 3, 900.0, rng)
    front = PassingFront(500.0, 175.0, 11.0, (-7.5, 0.5), 40.0)
    told = told_in(field, ways, rng, front), told_in(field, ways, rng)
    found = judge_bounds(field, COHERENCE, ways, front, (5.0, 10.0), *told)
    sure = LOG_ODDS.index(8.0)
    for one in (found.front_known, found.law_known):
        (delay_s,) = one.delays_s[sure]
        assert -20.0 < delay_s < 20.0
        assert one.false[sure] == 0
        first = [delays[0] for delays in one.delays_s[sure:] if delays]
        assert first == sorted(first), "later at higher odds"
    looked_h = (900 - 120) / 3600.0
    assert found.law_known.hours == pytest.approx(looked_h, abs=4 * LOOK_S / 3600.0 + 0.005)


def test_figures_of_worlds_are_added() -> None:
    none = ((),) * (len(LOG_ODDS) - 1)
    zeros = (0,) * (len(LOG_ODDS) - 1)
    one = BoundFigures(((4.0,), *none), (0, *zeros), (2, *zeros), 1.0)
    other = BoundFigures(((), *none), (1, *zeros), (1, *zeros), 0.5)
    both = one + other
    assert (both.delays_s[0], both.missed[0], both.false[0], both.hours) == ((4.0,), 1, 3, 1.5)
