"""Turbulence against MIL-F-8785C: scales, variances, spectra, whatever the step."""

import math

import numpy as np
import pytest
from scipy.signal import welch

from sim_bridge.truth.dryden import DrydenTurbulence, dryden_intensities_mps, dryden_scales_m

FOOT = 0.3048


def test_scales_and_intensities_are_the_published_ones() -> None:
    """MIL-F-8785C 3.7.3 at 1000 ft (all equal) and 100 ft (by hand from its formulas)."""
    assert dryden_scales_m(1000 * FOOT) == pytest.approx((1000 * FOOT, 1000 * FOOT), rel=1e-6)
    assert dryden_intensities_mps(1000 * FOOT, 10.0) == pytest.approx((1.0, 1.0), rel=1e-6)
    scale_u, scale_w = dryden_scales_m(100 * FOOT)
    assert scale_w == pytest.approx(100 * FOOT)
    assert scale_u == pytest.approx(100 * FOOT / 0.2593**1.2, rel=1e-6)
    assert dryden_intensities_mps(100 * FOOT, 10.0)[0] == pytest.approx(0.2593**-0.4, rel=1e-6)


def test_heights_outside_the_standard_are_held_at_its_ends() -> None:
    assert dryden_scales_m(0.0) == dryden_scales_m(10 * FOOT)
    assert dryden_scales_m(900.0) == dryden_scales_m(1000 * FOOT)


def _gusts(seed: int, count: int, dt_s: float, speed: float = 12.0) -> np.ndarray:
    """Gusts at 60 m height in 10 m/s of wind; shape (count, 3)."""
    field = DrydenTurbulence(np.random.default_rng(seed))
    return np.array([field.advance_and_get_gust_mps(dt_s, 60.0, 10.0, speed) for _ in range(count)])


@pytest.mark.sample
@pytest.mark.parametrize("dt_s", [0.01, 1.0])
def test_variance_does_not_depend_on_the_step(dt_s: float) -> None:
    """sigma^2 over an ensemble of independent starts and after some steps, to 3 standard errors."""
    ends = np.array([_gusts(seed, 20, dt_s)[-1] for seed in range(1500)])
    sigma_u, sigma_w = dryden_intensities_mps(60.0, 10.0)
    error = 3 * math.sqrt(2 / len(ends))
    assert ends.var(axis=0) == pytest.approx([sigma_u**2, sigma_u**2, sigma_w**2], rel=error)


def _published(axis: int, wave: np.ndarray) -> np.ndarray:
    """One-sided PSD over spatial frequency in rad/m (MIL-F-8785C, Dryden form)."""
    scale = dryden_scales_m(60.0)[axis == 2]
    sigma = dryden_intensities_mps(60.0, 10.0)[axis == 2]
    square = (scale * wave) ** 2
    if axis == 0:
        return sigma**2 * 2 * scale / math.pi / (1 + square)
    return sigma**2 * scale / math.pi * (1 + 3 * square) / (1 + square) ** 2


@pytest.mark.night
@pytest.mark.parametrize("axis", [0, 1, 2], ids=["along", "across", "vertical"])
def test_spectrum_is_the_published_one(axis: int) -> None:
    """Welch's estimate over two decades, octave by octave, to 15 %."""
    dt_s, speed = 0.1, 12.0
    gusts = _gusts(7, 150_000, dt_s, speed)[:, axis]
    frequency_hz, density = welch(gusts, fs=1 / dt_s, nperseg=8192)
    wave = 2 * math.pi * frequency_hz / speed
    density = density * speed / (2 * math.pi)
    for low in 0.004 * 2.0 ** np.arange(6):
        band = (wave >= low) & (wave < 2 * low)
        ratio = density[band].mean() / _published(axis, wave[band]).mean()
        assert ratio == pytest.approx(1.0, abs=0.15), (low, ratio)


def test_a_faster_vehicle_meets_the_same_field_faster() -> None:
    """Frozen field: the same distances give the same gusts."""
    slow = _gusts(3, 50, 0.2, speed=5.0)
    fast = _gusts(3, 50, 0.1, speed=10.0)
    assert slow == pytest.approx(fast)


@pytest.mark.sample
def test_axes_are_independent() -> None:
    gusts = _gusts(11, 60_000, 0.5)
    correlation = np.corrcoef(gusts.T)
    assert np.abs(correlation - np.eye(3)).max() < 0.08
