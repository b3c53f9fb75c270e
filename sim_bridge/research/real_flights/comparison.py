"""Ours against each rival on the same flights: the difference, and its interval by days.

Flights of a day share their air, pack and sensors, so whole days are drawn with replacement. Behind
is who is behind beyond the interval.
"""

from collections.abc import Callable, Iterable, Sequence

import msgspec
import numpy as np

from companion.core.base.arrays import Floats

DRAWS, SEED = 4000, 1


class Comparison(msgspec.Struct, frozen=True):
    """Error of ours and of the rival, pooled, and the 95 % interval of ours less the rival's."""

    rival: str
    ours: float
    theirs: float
    low: float
    high: float

    @property
    def is_behind(self) -> bool:
        """Whether ours errs more, beyond what days scatter."""
        return self.low > 0.0


def compared(
    rival: str,
    rows: Iterable[tuple[str, float, float]],
    pooled: Callable[[Floats], Floats] = np.asarray,
) -> Comparison | None:
    """`rows`: a day, our loss and theirs, to be averaged over all rows of the days drawn; `pooled`
    makes the error of such a mean (say, the root of a mean square). `None` without rows."""
    known = list(rows)
    if not known:
        return None
    days = sorted({day for day, _, _ in known})
    sums = np.array([_sums([row for row in known if row[0] == day]) for day in days])
    count, ours, theirs = sums.T
    whole = pooled(np.array([ours.sum(), theirs.sum()]) / count.sum())
    rng = np.random.default_rng(SEED)
    drawn = rng.integers(0, len(days), (DRAWS, len(days)))
    counts = count[drawn].sum(axis=1)
    apart = pooled(ours[drawn].sum(axis=1) / counts) - pooled(theirs[drawn].sum(axis=1) / counts)
    low, high = np.percentile(apart, [2.5, 97.5])
    return Comparison(rival, float(whole[0]), float(whole[1]), float(low), float(high))


def _sums(rows: Sequence[tuple[str, float, float]]) -> tuple[float, float, float]:
    return float(len(rows)), sum(row[1] for row in rows), sum(row[2] for row in rows)
