"""How soon a rise of the draw is told: rises are put where they belong, and the bound is one."""

import math

import numpy as np
import pytest

from sim_bridge.research.benchmarks import draw_bench
from sim_bridge.research.benchmarks.draw_bench import PowerHeard, bound_s, judged, sheet

POWER_W, EVERY_S = 400.0, 0.5


def flight(noise: float = 0.0, *, seconds: float = 200.0, seed: int = 1) -> PowerHeard:
    """Level from 20 to 160 s; it draws what its model says, but for white noise."""
    t_s = np.arange(0.0, seconds, EVERY_S)
    log = np.random.default_rng(seed).normal(0.0, noise, t_s.size)
    is_level = (t_s >= 20.0) & (t_s < 160.0)
    measured_w = POWER_W * np.exp(log)
    modelled_w = np.full(t_s.size, POWER_W)
    return PowerHeard(t_s, measured_w, modelled_w, np.zeros(t_s.size), is_level)


def test_rises_begin_in_level_flight_once_the_noise_is_known_and_early_enough_to_be_told():
    starts = flight().starts()
    assert starts.min() == 35.0
    assert starts.max() < 160.0
    assert flight(seconds=100.0).starts().max() <= 70.0


def test_a_large_rise_is_told_sooner_than_a_small_one_and_none_is_told_without_one():
    calm = flight(noise=0.02)
    assert calm.false_alarms() == 0
    small, large = (calm.told_after_s(rise, 60.0) for rise in (1.25, 2.0))
    assert small is not None
    assert large is not None
    assert 0.0 < large < small < 60.0


def test_the_noise_density_of_white_noise_is_its_variance_times_the_step():
    # Means of 10 s of white noise: variance 0.2^2 / 20; of 14 windows about their own mean.
    flights = [flight(noise=0.2, seed=seed) for seed in range(40)]
    measured = float(np.mean([one.noise_s() for one in flights]))
    assert measured == pytest.approx(0.2**2 * EVERY_S, rel=0.15)


def test_the_bound_is_what_the_best_cusum_reaches():
    """Simulated: a random walk in steps of 0.02 s, and a false alarm each 36 s on average."""
    noise_s, rise, step_s = 0.1, 1.4, 0.02
    mu, rng = math.log(rise), np.random.default_rng(7)
    unit_s = 2.0 * noise_s / mu**2
    heights = np.linspace(0.1, 12.0, 2000)
    h = heights[np.argmin(np.abs(unit_s * (np.exp(heights) - heights - 1.0) - 36.0))]
    delays, runs = [], 1500
    s, alive = np.zeros(runs), np.ones(runs, bool)
    for step in range(1, 3000):
        x = rng.normal(mu * step_s, math.sqrt(noise_s * step_s), runs)
        s = np.maximum(0.0, s + mu / noise_s * (x - 0.5 * mu * step_s))
        told = alive & (s >= h)
        delays += [step * step_s] * int(told.sum())
        alive &= ~told
    assert not alive.any()
    assert np.mean(delays) == pytest.approx(bound_s(rise, noise_s, 36.0 / 3600.0), rel=0.12)


def test_the_bound_grows_with_noise_and_rarer_false_alarms_and_falls_with_the_rise():
    assert bound_s(1.25, 0.1) > bound_s(1.4, 0.1) > bound_s(2.0, 0.1) > 0.0
    assert bound_s(1.4, 0.2) > bound_s(1.4, 0.1)
    assert bound_s(1.4, 0.1, 1000.0) > bound_s(1.4, 0.1, 10.0)


def test_the_table_has_a_row_for_each_rise_and_says_never_where_it_was_not_told(
    monkeypatch,
):
    row = judged("rough", [flight(noise=0.05)])
    assert (row.flights, row.false_alarms) == (1, 0)
    shown = sheet([row]).markdown()
    assert shown.count("| rough |") == 5
    monkeypatch.setattr(draw_bench, "RISES", (1.01,))
    never = judged("still", [flight(noise=0.001)])
    assert never.rises[0].told == 0 < never.rises[0].tried
    assert "| never |" in sheet([never]).markdown()
