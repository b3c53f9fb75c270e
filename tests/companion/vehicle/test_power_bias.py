"""Ratio of drawn to modelled power: learned slowly, and again after a change."""

import math

import numpy as np
import pytest

from companion.core.vehicle.draw_change import LowCurrentDetector
from companion.core.vehicle.power_bias import PowerScale

STEP_S = 0.2
MODEL_W = 480.0
PRIOR = 0.04


def flown(scale: PowerScale, seconds: float, ratio: float, noise: list[float] | None = None) -> int:
    """Return the number of reported changes, with power at this ratio to the model's."""
    steps = round(seconds / STEP_S)
    noise = noise or [0.0] * steps
    return sum(
        scale.update_and_report_draw_change(STEP_S, MODEL_W * ratio * math.exp(e), MODEL_W)
        for e in noise[:steps]
    )


def gusts(seconds: float, std: float, seed: int) -> list[float]:
    """A log ratio that wanders as in flight: exponentially correlated over 4 s."""
    rng, value, out = np.random.default_rng(seed), 0.0, []
    keep = math.exp(-STEP_S / 4.0)
    for _ in range(round(seconds / STEP_S)):
        value = keep * value + math.sqrt(1.0 - keep**2) * std * rng.standard_normal()
        out.append(float(value))
    return out


@pytest.mark.parametrize("ratio", [1.25, 1.7, 2.0])
def test_safety_rule_4_a_draw_that_stays_higher_is_told_within_ten_seconds(ratio: float) -> None:
    scale = PowerScale(PRIOR)
    assert flown(scale, 60.0, 1.0) == 0
    before = scale.model_error()
    assert flown(scale, 10.0, ratio) == 1
    after = scale.model_error()
    assert before.scale == pytest.approx(1.0, abs=0.001)
    # Most of a change of that size is adopted, with a large stated uncertainty.
    assert 1.0 + 0.5 * (ratio - 1.0) < after.scale < ratio + 0.01
    assert after.std_frac > 4.0 * before.std_frac


@pytest.mark.parametrize("ratio", [1.7, 2.0])
def test_safety_rule_4_a_large_rise_is_told_within_ten_seconds_in_gusts(ratio: float) -> None:
    scale = PowerScale(PRIOR)
    assert flown(scale, 60.0, 1.0, gusts(60.0, 0.1, 3)) == 0
    assert flown(scale, 10.0, ratio, gusts(10.0, 0.1, 4)) >= 1


def test_the_new_ratio_becomes_known_again() -> None:
    scale = PowerScale(PRIOR)
    flown(scale, 60.0, 1.0)
    flown(scale, 10.0, 2.0)
    unsure = scale.model_error().std_frac
    assert flown(scale, 180.0, 2.0) == 0
    assert scale.model_error().scale == pytest.approx(2.0, rel=0.05)
    assert scale.model_error().std_frac < 0.4 * unsure


def test_an_isolated_outlier_costs_nothing() -> None:
    plain, struck = PowerScale(PRIOR), PowerScale(PRIOR)
    for scale, times in ((plain, 1.0), (struck, 6.0)):
        flown(scale, 60.0, 1.0)
        for k in range(25):  # one reading, held for 5 s until the next comes
            scale.update_and_report_draw_change(STEP_S, MODEL_W * times, MODEL_W, age_s=k * STEP_S)
        flown(scale, 60.0, 1.0)
    assert struck.model_error().scale == plain.model_error().scale
    assert struck.model_error().std_frac == pytest.approx(plain.model_error().std_frac, rel=0.01)


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_rough_air_is_no_change(seed: int) -> None:
    # 0.13 over 4 s: the variation of the ratio in the default flight's rough air.
    assert flown(PowerScale(PRIOR), 300.0, 1.05, gusts(300.0, 0.13, seed)) == 0


def test_braking_and_descending_never_make_the_model_hopeful() -> None:
    scale = PowerScale(PRIOR)
    flown(scale, 60.0, 1.0)
    assert flown(scale, 30.0, 0.55) == 0
    assert scale.model_error().scale > 0.99


def test_a_rise_that_ends_is_told_and_never_taken_for_less_than_the_model() -> None:
    scale = PowerScale(PRIOR)
    flown(scale, 60.0, 1.0)
    flown(scale, 60.0, 2.0)
    assert flown(scale, 20.0, 1.0) == 1
    assert 1.0 <= scale.model_error().scale < 1.3


def seconds_until_low(gain: float, seed: int | None = None, model_std_frac: float = PRIOR) -> float:
    detector = LowCurrentDetector(0.0, model_std_frac)
    noise = [0.0] * 1500 if seed is None else gusts(300.0, 0.1, seed)
    for step, e in enumerate(noise):
        if detector.update_and_detect(STEP_S, MODEL_W * gain * math.exp(e), MODEL_W):
            assert detector.gain is not None
            assert detector.gain[0] == pytest.approx(gain, rel=0.15)
            return step * STEP_S
    return math.inf


@pytest.mark.parametrize(("gain", "limit_s"), [(0.6, 10.0), (0.65, 11.0), (0.7, 14.0), (0.8, 34.0)])
def test_a_current_sensor_that_reads_low_is_found(gain: float, limit_s: float) -> None:
    assert seconds_until_low(gain) < limit_s


def test_a_current_that_stays_at_the_idle_value_of_the_ground_is_found_low() -> None:
    detector, idle_w = LowCurrentDetector(0.0, PRIOR), 0.03 * MODEL_W
    assert any(
        detector.update_and_detect(STEP_S, idle_w, MODEL_W) for _ in range(round(8.0 / STEP_S))
    )


def test_an_honest_or_high_current_is_not_found_low_in_gusts() -> None:
    for seed in range(20):
        assert seconds_until_low(1.0, seed) == math.inf
    assert seconds_until_low(1.25) == math.inf
    assert seconds_until_low(0.7, model_std_frac=0.3) == math.inf
