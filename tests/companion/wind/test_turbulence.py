"""Corrections of the wind estimate: gusts are not a front, and a front is detected."""

import math

import numpy as np

from companion.core.wind.turbulence import LastingChangeDetector

STEP_S = 0.1
VARIANCE_M2PS2 = 0.02  # of one correction, both axes together


def fronts_seen(corrections: np.ndarray) -> list[int]:
    """Return the indices of corrections at which a front is newly detected."""
    front = LastingChangeDetector()
    return [
        k
        for k, (north, east) in enumerate(corrections.tolist())
        if front.update_and_detect_front_m2ps2((north, east), VARIANCE_M2PS2, STEP_S) > 0.0
    ]


def white(count: int) -> np.ndarray:
    random = np.random.default_rng(3)
    return random.normal(0.0, math.sqrt(0.5 * VARIANCE_M2PS2), (count, 2))


def test_white_corrections_are_taken_for_a_front_a_few_times_in_an_hour() -> None:
    # Innovations of a filter that is right are white (Kailath 1968); the weighed sum's square over
    # its variance is exponential: above 7 for exp(-7) = 0.09 % of the time, 16 s in five hours;
    # with 4 s of memory it stays there for half a second or more at a time.
    hours = 5.0
    assert len(fronts_seen(white(round(hours * 3600.0 / STEP_S)))) <= 40


def test_corrections_that_go_on_in_one_direction_are_a_front() -> None:
    # 0.5 m/s each second, among corrections of 0.1 m/s an axis: 1 m/s in 2 s, where 0.6 are usual.
    corrections = white(600)
    corrections[300:] += [0.03, -0.04]
    seen = fronts_seen(corrections)
    assert seen
    assert 300 < seen[0] < 300 + 100


def test_after_a_front_the_wind_may_walk_for_some_seconds_and_no_longer() -> None:
    front = LastingChangeDetector()
    while front.update_and_detect_front_m2ps2((0.1, 0.0), VARIANCE_M2PS2, STEP_S) == 0.0:
        pass
    assert front.process_noise_m2ps3 == LastingChangeDetector.PROCESS_NOISE_M2PS3
    for _ in range(round(8.0 * LastingChangeDetector.DECAY_S / STEP_S)):
        front.update_and_detect_front_m2ps2((0.0, 0.0), VARIANCE_M2PS2, STEP_S)
    assert front.process_noise_m2ps3 < 0.01
