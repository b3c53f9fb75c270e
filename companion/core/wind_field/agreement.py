"""Consistency of each member's wind reports with those of all other members.

A constant added to a member's values does not change their expectation from the others. Its
generalised least-squares estimate over its standard error is

    z = g' K^-1 r / sqrt(g' K^-1 g)

with g the indicator of these values, r the reports less the prior and K their covariance, the
member's stated error included (Cook and Weisberg 1982, ch. 2: the mean-shift outlier model). K also
includes the true variation of the wind between positions. z^2 on both axes together is chi-square
with two degrees of freedom if the model holds.

Two groups are tested: all reports of a member, and those of the last minute. The last minute has
the higher limit, because a front reaches one member first. If only two members are present and
contradict each other, both are excluded, unless one is the vehicle itself.
"""

from collections.abc import Callable

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field.wind_reports import SegmentArrays

ALL_LIMIT, RECENT_LIMIT = 30.0, 60.0
"""Chi-square of two degrees exceeds 30 once in three million; recorded wind has heavier tails. A
front of 8 m/s gives about 45 where a one-minute forecast errs by 1.2 m/s on each axis."""
RECENT_S = 60.0
MIN_REPORTS = 3
"""Minimum number of reports for a test: a single outlier is no evidence of a fault."""


def exclusion_reason_by_member(
    mean_shift_squares: Callable[[Floats], Floats],
    segments: SegmentArrays,
    now_s: float,
    own_member: str = "",
    protected_members: frozenset[str] = frozenset(),
) -> dict[str, str]:
    """Return the members to exclude next, with the reason, but never `own_member` or
    `protected_members`.

    `mean_shift_squares` returns z^2 on both axes together for groups (n, groups) of values.
    """
    present = np.unique(segments.member)
    if present.size < 2:
        return {}
    is_member = segments.member[:, None] == present[None, :]
    is_recent = now_s - segments.last[:, 0] <= RECENT_S
    groups = np.concatenate([is_member, is_member & is_recent[:, None]], axis=1).astype(np.float64)
    report_counts = groups.T @ segments.count
    square = mean_shift_squares(groups)
    square[report_counts < MIN_REPORTS] = 0.0
    count = present.size
    stays = protected_members | {own_member}
    excess = np.maximum(square[:count] / ALL_LIMIT, square[count:] / RECENT_LIMIT)
    bad = [
        (float(e), segments.members[number])
        for e, number in zip(excess, present, strict=True)
        if e > 1.0 and segments.members[number] not in stays
    ]
    if not bad:
        return {}
    if count == 2 and not any(segments.members[number] in stays for number in present):
        return {name: "contradicts the only other member" for _, name in bad}
    worst, name = max(bad)
    return {name: f"contradicts the others, {worst:.1f} times the limit"}
