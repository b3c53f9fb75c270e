"""One way to time, and one way to report it: median, spread, number, and the ratio to another.

CPU time is what a computation costs on a busy machine. Wall time is what somebody waits.
"""

import statistics
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from sim_bridge.adapters.wall_clock import cpu_s, wall_s


@dataclass(frozen=True, slots=True)
class Samples:
    """Measured values of one thing, all in one unit; at least one."""

    values: tuple[float, ...]

    @classmethod
    def of(cls, values: Iterable[float], scale: float = 1.0) -> "Samples":
        """The values times `scale`, such as 1e6 from seconds to microseconds."""
        return cls(tuple(scale * value for value in values))

    @property
    def n(self) -> int:
        return len(self.values)

    @property
    def median(self) -> float:
        return float(statistics.median(self.values))

    @property
    def least(self) -> float:
        return min(self.values)

    @property
    def most(self) -> float:
        return max(self.values)

    @property
    def p99(self) -> float:
        """99th percentile, interpolated linearly between the two nearest values."""
        return float(np.percentile(self.values, 99))

    def over(self, other: "Samples") -> float:
        """The ratio of the medians."""
        return self.median / other.median

    def spread(self, digits: int = 1) -> str:
        """Least to most; empty for a single value."""
        return f"{self.least:.{digits}f} to {self.most:.{digits}f}" if self.n > 1 else ""

    def text(self, unit: str, digits: int = 1) -> str:
        """Such as `12.3 us (11.9 to 15.0, n 30)`."""
        middle = f"{self.median:,.{digits}f} {unit}"
        return f"{middle} ({self.spread(digits)}, n {self.n})" if self.n > 1 else middle


def cpu_time_s(work: Callable[[], object]) -> float:
    """Seconds of this process's CPU that one call takes."""
    began_s = cpu_s()
    work()
    return cpu_s() - began_s


def wall_time_s(work: Callable[[], object]) -> float:
    """Seconds that one call takes by the wall clock."""
    began_s = wall_s()
    work()
    return wall_s() - began_s


def repeated(work: Callable[[], object], times: int) -> Samples:
    """CPU seconds of so many calls."""
    return Samples.of(cpu_time_s(work) for _ in range(times))
