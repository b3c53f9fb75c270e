"""What a flight believes beside its files, while something of its vehicle is in doubt."""

import math

import msgspec
import numpy as np

from companion.core.monitor.promises import DRAW, PACK
from companion.core.monitor.record import Kept, Service
from companion.core.monitor.service import shift_test

ELLIPSE_CHI2 = 5.991
"""95 % of a chi-square with two degrees of freedom, which is above x with exp(-x / 2)."""

MOST_WIND_VARIANCE = 9.0
"""A threefold wind std stops nearly every flight: more would say no more."""

LOST_DRAW_LOG, LOST_CAPACITY_FRAC = math.log(1.10), 0.8
"""The careful belief after lost evidence: what the monitor is to find at the latest."""

LEAST_CAPACITY_FRAC = 0.3
"""As the flight file's `battery_health_frac`."""


class Doubts(msgspec.Struct, frozen=True, kw_only=True):
    """Nothing in doubt by default: then a flight is the same as without a monitor."""

    draw_log: float = 0.0
    """Log of the draw over the model's, mean."""
    draw_std: float = 0.0
    """Standard deviation of that, beside the airframe file's."""
    capacity_frac: float = 1.0
    """Of the pack's stated capacity."""
    wind_variance: float = 1.0
    """Times the wind process's."""
    words: tuple[str, ...] = ()
    """For the operator: what is in doubt, since when, and what clears it."""


NO_DOUBTS = Doubts()


def doubts_of(service: Service, pack: str) -> Doubts:
    """What the next flight is to believe, with this pack aboard.

    The draw's mean and standard deviation are those since its change (`ShiftTest.since_change`);
    capacity is a standard deviation under its mean, and nothing is ever better than stated.
    """
    lost = service.lost_left > 0
    draw_log, draw_std = _estimate(service.draw, DRAW)
    kept = service.packs.get(pack) or Kept()
    return Doubts(
        draw_log=max(draw_log, LOST_DRAW_LOG) if lost else draw_log,
        draw_std=draw_std,
        capacity_frac=min(_capacity_frac(kept), LOST_CAPACITY_FRAC if lost else 1.0),
        wind_variance=_wind_variance(service.wind),
        words=tuple(_words(service, pack, kept)),
    )


def _words(service: Service, pack: str, kept: Kept) -> list[str]:
    said: list[str] = []
    if service.lost_left > 0:
        said.append(
            "monitor: its record was lost; draw +10 % and pack 80 % are assumed for"
            f" {service.lost_left} flights; to clear: companion monitor reset lost"
        )
    if service.draw.alarm_flight is not None:
        mean, std = _estimate(service.draw, DRAW)
        said.append(
            f"monitor: draw is {math.exp(mean):.2f} +- {std:.2f} of the model's, found at flight"
            f" {service.draw.alarm_flight}; to clear: look at motors and propellers, calibrate,"
            " companion monitor reset draw"
        )
    if kept.alarm_flight is not None:
        said.append(
            f"monitor: pack {pack} has {100.0 * _capacity_frac(kept):.0f} % of its stated capacity,"
            f" found at flight {kept.alarm_flight}; to clear: fly another pack, or companion"
            f" monitor reset {pack}"
        )
    if service.wind.alarm_flight is not None:
        times = math.sqrt(_wind_variance(service.wind))
        said.append(
            f"monitor: wind changes {times:.1f} times as much as its process, found at flight"
            f" {service.wind.alarm_flight}; to clear: fit-wind, companion monitor reset wind"
        )
    return said


def _estimate(kept: Kept, promise: str) -> tuple[float, float]:
    """(mean, std) of what is in alarm, on its next day; (0, 0) where nothing is."""
    if kept.alarm_flight is None:
        return 0.0, 0.0
    precision, score = np.array(kept.days).T
    mean, std = shift_test(promise).since_change(precision, score)
    return max(float(mean), 0.0), float(std)


def _capacity_frac(kept: Kept) -> float:
    mean, std = _estimate(kept, PACK)
    return min(max(math.exp(-mean - std), LEAST_CAPACITY_FRAC), 1.0)


def _wind_variance(kept: Kept) -> float:
    """Times the process's at which 5 % would fail: a normal of variance f in two dimensions leaves
    the ellipse with exp(-chi2 / (2 f)).
    """
    if kept.alarm_flight is None:
        return 1.0
    checks, failed = np.array(kept.days).sum(axis=0)
    share = min(max(float(failed / checks), 0.05), 0.95)
    return min(ELLIPSE_CHI2 / (-2.0 * math.log(share)), MOST_WIND_VARIANCE)
