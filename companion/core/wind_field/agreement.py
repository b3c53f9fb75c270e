"""Whether what one member tells fits what all others tell.

A constant added to some of the values changes what the others expect of them by nothing. Its
generalised least-squares estimate over its standard error is

    z = g' K^-1 r / sqrt(g' K^-1 g)

with g the indicator of these values, r what was told less the prior and K its covariance, the
member's own stated error included (Cook and Weisberg 1982, ch. 2: the mean-shift outlier model). A
wind that is truly other at its place is in K, too. z^2 on both axes together is chi-square of two
degrees where the model holds.

Tested are all that a member tells, and its newest minute. The newest minute has the higher limit:
a front reaches one member first. Two that contradict one another are both left out, unless one is
the vehicle itself: nobody can tell which of them is right.
"""

from collections.abc import Callable

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field.tellings import KeptStretches

ALL_LIMIT, NEW_LIMIT = 30.0, 60.0
"""Chi-square of two degrees is past 30 once in three million; recorded wind has heavier tails. A
front of 8 m/s is about 45 where a forecast of a minute errs by 1.2 m/s on each axis."""
NEW_S = 60.0
LEAST_TELLINGS = 3
"""Fewer say little of a member: a single outlier is not a habit."""


def contradicting(
    mean_shift_squares: Callable[[Floats], Floats],
    kept: KeptStretches,
    now_s: float,
    always: str = "",
    firm: frozenset[str] = frozenset(),
) -> dict[str, str]:
    """Who is to be left out next, and why; `always` and who is `firm` never are. Empty: all agree.

    `mean_shift_squares` gives z^2 on both axes together for groups (n, groups) of values.
    """
    present = np.unique(kept.member)
    if present.size < 2:
        return {}
    whose = kept.member[:, None] == present[None, :]
    fresh = now_s - kept.last[:, 0] <= NEW_S
    groups = np.concatenate([whose, whose & fresh[:, None]], axis=1).astype(np.float64)
    told = groups.T @ kept.count
    square = mean_shift_squares(groups)
    square[told < LEAST_TELLINGS] = 0.0
    count = present.size
    stays = firm | {always}
    excess = np.maximum(square[:count] / ALL_LIMIT, square[count:] / NEW_LIMIT)
    bad = [
        (float(e), kept.members[number])
        for e, number in zip(excess, present, strict=True)
        if e > 1.0 and kept.members[number] not in stays
    ]
    if not bad:
        return {}
    if count == 2 and not any(kept.members[number] in stays for number in present):
        return {name: "contradicted by the only other" for _, name in bad}
    worst, name = max(bad)
    return {name: f"contradicts the others, {worst:.1f} times the limit"}
