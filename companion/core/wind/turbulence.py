"""What the filter's own corrections tell of the air: how gusty it is, and whether a front passes.

A filter that is right corrects its wind by as much as it expects to, now this way and now that
(innovations are white, Kailath 1968). Corrections that are greater tell of stronger gusts, and such
as go on in one direction of a wind that changes for good.
"""

import math
from dataclasses import dataclass
from typing import ClassVar


@dataclass(slots=True)
class Turbulence:
    """How gusty it is here: the gusts' variance over the prior's, learned in flight.

    A filter that is right about gusts corrects its wind, over some seconds, by as much as it
    expects to (covariance matching, Mehra 1972). Where it corrects more, gusts are stronger. Where
    single readings are better, or worse, than their stated noise, so are the corrections: that is
    no gust.
    """

    ratio: float = 1.0
    is_held: bool = False  # it is given, and not learned
    windows: int = 0
    north_mps: float = 0.0
    east_mps: float = 0.0
    expected_m2ps2: float = 0.0
    noise: float = 0.0
    seconds: float = 0.0

    WINDOW_S: ClassVar[float] = 2.0
    PRIOR_WINDOWS: ClassVar[int] = 15
    MOST_WINDOWS: ClassVar[int] = 60  # two minutes: weather changes
    MOST_SURPRISE: ClassVar[float] = 9.0
    LEAST_NOISE: ClassVar[float] = 0.05
    RANGE: ClassVar[tuple[float, float]] = (0.05, 1.5)  # more would be the model's error, not gusts

    def corrected(
        self,
        step_ne_mps: tuple[float, float],
        expected_m2ps2: float,
        surprise: float,
        dt_s: float,
    ) -> None:
        """The wind was corrected by this much, where a variance of so much was expected;
        `surprise` is the normalised square of the innovation, 1 as expected."""
        self.north_mps += step_ne_mps[0]
        self.east_mps += step_ne_mps[1]
        self.expected_m2ps2 += expected_m2ps2
        self.noise += surprise * dt_s
        self.seconds += dt_s
        if self.seconds < self.WINDOW_S:
            return
        size = self.north_mps**2 + self.east_mps**2
        noise = max(self.noise / self.seconds, self.LEAST_NOISE)
        excess = min(size / max(self.expected_m2ps2 * noise, 1e-9), self.MOST_SURPRISE)
        self.windows = min(self.windows + 1, self.MOST_WINDOWS)
        share = 1.0 / (self.PRIOR_WINDOWS + self.windows)
        low, high = self.RANGE
        self.ratio = min(max(self.ratio * (1.0 + share * (excess - 1.0)), low), high)
        self.north_mps = self.east_mps = self.expected_m2ps2 = 0.0
        self.noise = self.seconds = 0.0


@dataclass(slots=True)
class Front:
    """Whether the wind changes for good, faster than any gust is expected to.

    The test: corrections are summed over about `MEMORY_S`, and so are the variances that were
    expected of them. Without a front the sum's square over the variance, both axes together, is
    close to exponential with mean 1 (chi-square of 2 degrees, halved): past `LIMIT` for exp(-LIMIT)
    of the time, which white corrections are about five times in an hour. Past it, the mean may walk
    as a front makes it, and for `LASTS_S` on. Else a filter that holds the wind to be slow takes
    what a front does to the tilt for trim, and for drag's gain: in a hover in 4 m/s a step of 5 m/s
    within 10 s left 2 m/s of error for as long as the heading stayed.
    """

    north_mps: float = 0.0
    east_mps: float = 0.0
    expected_m2ps2: float = 0.0
    walk_m2ps3: float = 0.0

    MEMORY_S: ClassVar[float] = 4.0
    LIMIT: ClassVar[float] = 7.0
    LASTS_S: ClassVar[float] = 4.0
    WALK_M2PS3: ClassVar[float] = 1.0  # 5 m/s in 10 s along one axis is 2.5, in both 1.2 each

    def corrected(
        self, step_ne_mps: tuple[float, float], expected_m2ps2: float, dt_s: float
    ) -> float:
        """The wind was corrected by this much, where a variance of so much was expected. What the
        corrections have come to (m2/s2 an axis) if a front is seen that was not before; else 0."""
        keep = math.exp(-dt_s / self.MEMORY_S)
        self.north_mps = keep * self.north_mps + step_ne_mps[0]
        self.east_mps = keep * self.east_mps + step_ne_mps[1]
        self.expected_m2ps2 = keep * keep * self.expected_m2ps2 + expected_m2ps2
        self.walk_m2ps3 *= math.exp(-dt_s / self.LASTS_S)
        size = self.north_mps**2 + self.east_mps**2
        if size <= self.LIMIT * self.expected_m2ps2:
            return 0.0
        is_new = self.walk_m2ps3 < 0.1 * self.WALK_M2PS3
        self.walk_m2ps3 = self.WALK_M2PS3
        return 0.5 * size if is_new else 0.0
