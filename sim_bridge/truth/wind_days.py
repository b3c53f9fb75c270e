"""Independent days of simulated wind from a stated process, in any number.

Each day has a mean wind of its own, uniform from 0.75 to 1.25 times the given mean, from a uniform
direction. About it the vector moves by a sum of independent Ornstein-Uhlenbeck processes on both
axes. Their standard deviations, as shares of the day's mean: 0.10 with a memory of 20 minutes
(weather over the hour), 0.09 with 3 minutes (large eddies of the boundary layer), and 0.165 with
L_u / U, the longitudinal form of the Dryden spectrum of MIL-F-8785C at 40 m (L_u = 180 m, sigma_u =
1.65 sigma_w, sigma_w = 0.1 U). The two slow shares are assumed, near what is seen at coasts. Every
part is Gaussian and Markov, so what can be known of its future is known exactly.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

EDDY_LENGTH_M = 180.0


@dataclass(frozen=True, slots=True)
class DayProcess:
    """One day: mean vector; standard deviations (m/s) and correlation times (s) of the parts."""

    mean_ne_mps: tuple[float, float]
    std_mps: tuple[float, float, float]
    correlation_s: tuple[float, float, float]


def draw_day_process(mean_mps: float, rng: np.random.Generator) -> DayProcess:
    """A day's process about a site's mean wind speed."""
    speed = mean_mps * float(rng.uniform(0.75, 1.25))
    direction_rad = float(rng.uniform(0.0, 2.0 * math.pi))
    return DayProcess(
        mean_ne_mps=(speed * math.cos(direction_rad), speed * math.sin(direction_rad)),
        std_mps=(0.10 * speed, 0.09 * speed, 0.165 * speed),
        correlation_s=(1200.0, 180.0, EDDY_LENGTH_M / speed),
    )


def draw_day_wind_series(process: DayProcess, seconds: int, rng: np.random.Generator) -> Floats:
    """Wind vector (direction it blows TO), north and east, at every second: (seconds + 1, 2)."""
    wind = np.tile(np.array(process.mean_ne_mps), (seconds + 1, 1))
    for std, memory in zip(process.std_mps, process.correlation_s, strict=True):
        wind += std * _draw_unit_variance_process(seconds, memory, rng)
    return wind


def _draw_unit_variance_process(seconds: int, memory_s: float, rng: np.random.Generator) -> Floats:
    """An Ornstein-Uhlenbeck process of unit variance on both axes, exact at whole seconds."""
    keep = math.exp(-1.0 / memory_s)
    noise = math.sqrt(1.0 - keep * keep) * rng.standard_normal((seconds + 1, 2))
    value = rng.standard_normal(2)
    out = np.empty((seconds + 1, 2))
    for k in range(seconds + 1):
        out[k] = value
        value = keep * value + noise[k]
    return out
