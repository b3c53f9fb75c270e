"""Turbulence and front detection from the filter's own wind corrections.

The corrections of a consistent filter have the expected variance and are uncorrelated in time
(innovations are white, Kailath 1968). Larger corrections indicate stronger gusts; corrections that
persist in one direction indicate a lasting change of wind.
"""

import math
from dataclasses import dataclass
from typing import ClassVar


@dataclass(slots=True)
class Turbulence:
    """Ratio of the local gust variance to the prior's, learned in flight.

    Over some seconds, the wind corrections of a consistent filter have the expected variance
    (covariance matching, Mehra 1972). Larger corrections indicate stronger gusts, unless single
    readings deviate from their stated noise by as much.
    """

    ratio: float = 1.0
    is_given: bool = False  # given, not learned
    windows: int = 0
    north_mps: float = 0.0
    east_mps: float = 0.0
    expected_m2ps2: float = 0.0
    noise: float = 0.0
    seconds: float = 0.0

    WINDOW_S: ClassVar[float] = 2.0
    PRIOR_WINDOWS: ClassVar[int] = 15
    MAX_WINDOWS: ClassVar[int] = 60  # two minutes: weather changes
    MAX_NIS: ClassVar[float] = 9.0
    MIN_NOISE: ClassVar[float] = 0.05
    RANGE: ClassVar[tuple[float, float]] = (0.05, 1.5)  # larger ratios are model errors

    def update_turbulence_ratio(
        self,
        wind_correction_ne_mps: tuple[float, float],
        expected_variance_m2ps2: float,
        mean_nis: float,
        dt_s: float,
    ) -> None:
        """Update the ratio by a wind correction and its expected variance. `mean_nis` is the
        normalised square of the innovation, 1 as expected."""
        self.north_mps += wind_correction_ne_mps[0]
        self.east_mps += wind_correction_ne_mps[1]
        self.expected_m2ps2 += expected_variance_m2ps2
        self.noise += mean_nis * dt_s
        self.seconds += dt_s
        if self.seconds < self.WINDOW_S:
            return
        size = self.north_mps**2 + self.east_mps**2
        noise = max(self.noise / self.seconds, self.MIN_NOISE)
        excess = min(size / max(self.expected_m2ps2 * noise, 1e-9), self.MAX_NIS)
        self.windows = min(self.windows + 1, self.MAX_WINDOWS)
        share = 1.0 / (self.PRIOR_WINDOWS + self.windows)
        low, high = self.RANGE
        self.ratio = min(max(self.ratio * (1.0 + share * (excess - 1.0)), low), high)
        self.north_mps = self.east_mps = self.expected_m2ps2 = 0.0
        self.noise = self.seconds = 0.0


@dataclass(slots=True)
class LastingChangeDetector:
    """Detector of lasting changes of wind that are faster than gusts.

    Corrections and their expected variances are summed over about `MEMORY_S`. Without a front, the
    squared sum over the variance, both axes together, is nearly exponential with mean 1 (chi-square
    of 2 degrees, halved): it exceeds `LIMIT` for exp(-LIMIT) of the time, with white corrections
    about five times an hour. The random walk of the mean is then increased for about `DECAY_S`. A
    filter with a slow walk would attribute the tilt in a front to trim and drag gain: in a hover in
    4 m/s, a step of 5 m/s within 10 s left an error of 2 m/s until the heading changed.
    """

    north_mps: float = 0.0
    east_mps: float = 0.0
    expected_m2ps2: float = 0.0
    process_noise_m2ps3: float = 0.0

    MEMORY_S: ClassVar[float] = 4.0
    LIMIT: ClassVar[float] = 7.0
    DECAY_S: ClassVar[float] = 4.0
    PROCESS_NOISE_M2PS3: ClassVar[float] = (
        1.0  # 5 m/s in 10 s along one axis is 2.5, in both 1.2 each
    )

    def update_and_detect_front_m2ps2(
        self,
        wind_correction_ne_mps: tuple[float, float],
        expected_variance_m2ps2: float,
        dt_s: float,
    ) -> float:
        """Update the sums by a wind correction and its expected variance. Returns the mean square
        of the summed corrections (m2/s2 per axis) if a new front is detected, else 0."""
        keep = math.exp(-dt_s / self.MEMORY_S)
        self.north_mps = keep * self.north_mps + wind_correction_ne_mps[0]
        self.east_mps = keep * self.east_mps + wind_correction_ne_mps[1]
        self.expected_m2ps2 = keep * keep * self.expected_m2ps2 + expected_variance_m2ps2
        self.process_noise_m2ps3 *= math.exp(-dt_s / self.DECAY_S)
        size = self.north_mps**2 + self.east_mps**2
        if size <= self.LIMIT * self.expected_m2ps2:
            return 0.0
        is_new = self.process_noise_m2ps3 < 0.1 * self.PROCESS_NOISE_M2PS3
        self.process_noise_m2ps3 = self.PROCESS_NOISE_M2PS3
        return 0.5 * size if is_new else 0.0
