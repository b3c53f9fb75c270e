"""The coherent field: the series at its centre, Davenport's coherence, its variance everywhere.

Coherence is measured between series at two positions by cross-spectra over many draws, against the
formula written out here.
"""

import math

import numpy as np
import pytest

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.coherent_field import Coherence, CoherentField

SECONDS, MEAN_MPS, SPACING_M = 256, 8.0, 75.0
DRAWS = 24
NORTH = np.array([MEAN_MPS, 0.0])


def drawn(seed: int, coherence: Coherence, mean: np.ndarray = NORTH) -> CoherentField:
    """Return a field of noise that is white except for the shortest seconds."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((SECONDS, 2))
    smooth = sum(w * np.roll(noise, k, axis=0) for k, w in enumerate((1, 4, 6, 4, 1)))
    series = mean + smooth / np.sqrt(np.square([1, 4, 6, 4, 1]).sum())
    return CoherentField(series, coherence, rng, half_side_m=300.0, spacing_m=SPACING_M)


def series_at(field: CoherentField, north_m: float, east_m: float) -> np.ndarray:
    t_s = np.arange(float(SECONDS))
    return field.to_ne_mps(t_s, np.full(SECONDS, north_m), np.full(SECONDS, east_m))


@pytest.fixture(scope="module")
def fields() -> list[CoherentField]:
    return [drawn(seed, Coherence(longitudinal=4.0, across=13.0)) for seed in range(DRAWS)]


def cross(
    fields: list[CoherentField], one: tuple[float, float], other: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the complex coherence of the winds at two positions, and its frequencies."""
    power = np.zeros((2, SECONDS // 2 + 1))
    both = np.zeros(SECONDS // 2 + 1, complex)
    for field in fields:
        a, b = (np.fft.rfft(series_at(field, *place), axis=0) for place in (one, other))
        power += (np.abs([a, b]) ** 2).sum(axis=-1)
        both += (a * b.conj()).sum(axis=-1)
    return both / np.sqrt(power[0] * power[1]), np.fft.rfftfreq(SECONDS)


def test_the_middle_meets_the_series_itself() -> None:
    rng = np.random.default_rng(4)
    series = NORTH + np.cumsum(0.2 * rng.standard_normal((SECONDS, 2)), axis=0)
    field = CoherentField(series, Coherence(), rng, half_side_m=300.0)
    assert np.abs(series_at(field, 0.0, 0.0) - series)[:-1].max() < 1e-4


@pytest.mark.parametrize("wind", [(8.0, 0.0), (0.0, -8.0), (-5.0, 6.0)])
def test_the_middle_is_the_series_in_any_direction_of_the_wind(wind: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    series = np.array(wind) + rng.standard_normal((SECONDS, 2))
    field = CoherentField(series, Coherence(), rng, half_side_m=300.0)
    assert np.abs(series_at(field, 0.0, 0.0) - series).max() < 1e-4


@pytest.mark.sample
@pytest.mark.parametrize(
    ("north_m", "east_m"), [(0.0, 75.0), (0.0, 150.0), (150.0, 0.0), (150.0, 150.0)]
)
def test_coherence_is_davenports(
    fields: list[CoherentField], north_m: float, east_m: float
) -> None:
    """Means over eight frequencies and 24 draws, both axes: known to about 0.05."""
    here, there = (-150.0, -75.0), (-150.0 + north_m, -75.0 + east_m)
    found, frequency = cross(fields, here, there)
    passed = np.exp(-2j * np.pi * frequency * north_m / MEAN_MPS)  # the wind arrives there later
    for first in (2, 10, 30):
        some = slice(first, first + 8)
        measured = float(np.real(found[some] * passed[some]).mean())
        apart = math.hypot(4.0 * north_m, 13.0 * east_m)
        expected = float(np.exp(-frequency[some] * apart / MEAN_MPS).mean())
        assert measured == pytest.approx(expected, abs=0.12)


def test_frozen_turbulence_comes_unchanged_and_lossy_turbulence_does_not() -> None:
    """The canary of the coherence: without loss all turbulence is predictable 100 m downstream."""
    for coherence, is_same in (
        (Coherence(longitudinal=0.0), True),
        (Coherence(longitudinal=4.0), False),
    ):
        field = drawn(2, coherence)
        delay_s = 20
        up, down = series_at(field, 0.0, 0.0), series_at(field, *(delay_s * field.mean_ne_mps))
        error = np.abs(down[delay_s:] - up[:-delay_s]).max()
        assert (error < 1e-3) == is_same


def variance(series: np.ndarray) -> float:
    return float(series.var(axis=0).mean())


def test_variance_is_the_same_at_nodes_and_between(fields: list[CoherentField]) -> None:
    half = 0.5 * SPACING_M
    at_node = np.mean([variance(series_at(f, 150.0, 75.0)) for f in fields])
    between = np.mean([variance(series_at(f, 150.0 + half, 75.0 + half)) for f in fields])
    assert at_node == pytest.approx(1.0, abs=0.12)  # 7 % is lost between the seconds
    assert between == pytest.approx(at_node, rel=0.08)
    corners = np.mean(  # the canary: the variance of plain interpolation
        [
            variance(
                np.mean(
                    [series_at(f, 150.0 + a, 75.0 + b) for a in (0.0, 75.0) for b in (0.0, 75.0)],
                    axis=0,
                )
            )
            for f in fields[:12]
        ]
    )
    assert corners < 0.6 * at_node


def test_the_same_seed_gives_the_same_field_and_another_another() -> None:
    one, same, other = (drawn(seed, Coherence()) for seed in (5, 5, 6))
    where = 140.0, -130.0
    assert np.array_equal(series_at(one, *where), series_at(same, *where))
    assert not np.allclose(series_at(one, *where), series_at(other, *where))


def test_a_trend_is_carried_with_the_mean_and_does_not_jump() -> None:
    rng = np.random.default_rng(1)
    series = NORTH + np.linspace(-2.0, 2.0, SECONDS)[:, None] * np.array([1.0, 0.0])
    field = CoherentField(series + 1e-6 * rng.standard_normal(series.shape), Coherence(), rng,
                          half_side_m=300.0)  # fmt: skip
    wind = series_at(field, -240.0, 0.0)[:, 0]
    assert wind[10] == pytest.approx(series[40, 0], abs=0.01)
    assert np.abs(np.diff(wind)).max() < 0.05


@pytest.mark.parametrize(
    ("series", "words"),
    [
        (np.tile(NORTH, (30, 1)), "60 or more"),
        (np.tile(0.01 * NORTH, (100, 1)), "carries nothing"),
    ],
)
def test_what_is_no_field_is_refused(series: np.ndarray, words: str) -> None:
    with pytest.raises(TruthError, match=words):
        CoherentField(series, Coherence(), np.random.default_rng(1))


def test_a_place_off_the_site_and_a_decay_of_nobody_are_refused() -> None:
    with pytest.raises(TruthError, match="outside of the field"):
        series_at(drawn(1, Coherence()), 2000.0, 0.0)
    with pytest.raises(TruthError, match="along = -1"):
        Coherence(longitudinal=-1.0).raise_if_out_of_range()
