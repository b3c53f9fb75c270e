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
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Floats = NDArray[np.float64]

EDDY_LENGTH_M = 180.0


@dataclass(frozen=True, slots=True)
class DayProcess:
    """One day: mean vector; standard deviations (m/s) and correlation times (s) of the parts."""

    mean_ne_mps: tuple[float, float]
    std_mps: tuple[float, float, float]
    correlation_s: tuple[float, float, float]


def build_day_process(speed_mps: float, direction_rad: float) -> DayProcess:
    """The process of a day with this mean wind, by the direction that it blows to."""
    return DayProcess(
        mean_ne_mps=(speed_mps * math.cos(direction_rad), speed_mps * math.sin(direction_rad)),
        std_mps=(0.10 * speed_mps, 0.09 * speed_mps, 0.165 * speed_mps),
        correlation_s=(1200.0, 180.0, EDDY_LENGTH_M / speed_mps),
    )


def draw_day_process(mean_mps: float, rng: np.random.Generator) -> DayProcess:
    """A day's process about a site's mean wind speed."""
    speed = mean_mps * float(rng.uniform(0.75, 1.25))
    return build_day_process(speed, float(rng.uniform(0.0, 2.0 * math.pi)))


def draw_day_wind_series(process: DayProcess, seconds: int, rng: np.random.Generator) -> Floats:
    """Wind vector (direction it blows TO), north and east, at every second: (seconds + 1, 2)."""

    def draw_normals() -> Floats:
        later, first = rng.standard_normal((seconds + 1, 2)), rng.standard_normal((1, 2))
        return np.concatenate([first, later[:-1]])

    return day_wind_series(process, [draw_normals() for _ in process.std_mps])


def day_wind_series(process: DayProcess, normals_by_part: Iterable[Floats]) -> Floats:
    """The wind series (n, 2) of these standard normal numbers, (n, 2) for each part.

    Each part is an Ornstein-Uhlenbeck process on both axes, exact at whole seconds.
    """
    wind = np.array(process.mean_ne_mps)
    parts = zip(process.std_mps, process.correlation_s, normals_by_part, strict=True)
    for std, memory, normals in parts:
        keep = math.exp(-1.0 / memory)
        driven = math.sqrt(1.0 - keep * keep) * normals
        driven[0] = normals[0]
        wind = wind + std * np.asarray(lfilter([1.0], [1.0, -keep], driven, axis=0))
    return wind
