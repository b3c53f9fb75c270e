"""Wind reports of the members and their storage.

A report is a mean over about 10 s. Reports older than half a minute are merged into one-minute
means, which preserves the information about the past at lower cost.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.core.base.arrays import Floats, Ints

REPORT_AVERAGING_S = 10.0
"""Averaging time of a report: reports at shorter intervals repeat the same information."""
RECENT_S = 30.0
MERGED_S = 60.0
KEPT_S = 900.0
"""Age limit: later reports cover even slow changes."""

FROZEN_S = 50.0
FROZEN_COUNT = 5
"""A member whose wind is constant to 1 cm/s for this time and number of reports is rejected."""

MAX_WIND_MPS = 60.0
MAX_STD_MPS = 20.0
MAX_AGE_S = 20.0
MAX_SPEED_MPS = 60.0
MAX_DISTANCE_M = 50_000.0
MAX_HEIGHT_M = 3_000.0
MIN_STD_MPS = 0.3
"""Lower bound of a reported standard deviation: the best wind estimate onboard a multirotor."""


@dataclass(frozen=True, slots=True)
class MemberWindReport:
    """One member's wind estimate at its position.

    `position_ne_m` about the origin of the desk or vehicle, `height_m` above the ground, mean and
    covariance of the direction that the air moves to. `t_s` on the receiver's clock.
    """

    member: str
    t_s: float
    position_ne_m: tuple[float, float]
    height_m: float
    mean_to_ne_mps: tuple[float, float]
    cov_ne_m2ps2: tuple[float, float, float]
    """nn, ne, ee"""

    def rejection_reason_or_empty(self) -> str:
        """Return the reason why the report is implausible; empty if it is plausible."""
        nn, ne, ee = self.cov_ne_m2ps2
        numbers = (*self.position_ne_m, self.height_m, *self.mean_to_ne_mps, nn, ne, ee, self.t_s)
        if not all(map(math.isfinite, numbers)):
            return "a value is not finite"
        if math.hypot(*self.mean_to_ne_mps) > MAX_WIND_MPS:
            return f"wind above {MAX_WIND_MPS:g} m/s"
        if min(nn, ee) <= 0.0 or ne * ne > nn * ee or max(nn, ee) > MAX_STD_MPS**2:
            return "invalid covariance"
        if math.hypot(*self.position_ne_m) > MAX_DISTANCE_M:
            return f"farther than {MAX_DISTANCE_M / 1000.0:g} km from the origin"
        if abs(self.height_m) > MAX_HEIGHT_M:
            return f"height outside +-{MAX_HEIGHT_M:g} m above the ground"
        return ""

    @property
    def conservative_variance_ne_m2ps2(self) -> tuple[float, float]:
        """Uncorrelated variances north and east, in each direction at least the reported variance.

        [[a, b], [b, c]] <= diag(a + |b|, c + |b|).
        """
        nn, ne, ee = self.cov_ne_m2ps2
        least = MIN_STD_MPS**2
        return max(nn + abs(ne), least), max(ee + abs(ne), least)


@dataclass(slots=True)
class ReportSegment:
    """Mean of a member's reports over a segment of its path.

    `first` and `last`: time, north, east, height at the ends.
    """

    count: int
    first: tuple[float, float, float, float]
    last: tuple[float, float, float, float]
    wind_ne_mps: tuple[float, float]
    variance_ne_m2ps2: tuple[float, float]

    @classmethod
    def from_report(cls, report: MemberWindReport) -> "ReportSegment":
        """Create a segment from one report, which is a mean over the seconds before it."""
        north, east = report.position_ne_m
        here = (report.t_s, north, east, report.height_m)
        return cls(1, here, here, report.mean_to_ne_mps, report.conservative_variance_ne_m2ps2)

    def merged_with(self, later: "ReportSegment") -> "ReportSegment":
        """Return the weighted mean of this segment and a later one."""
        count = self.count + later.count
        old, new = self.count / count, later.count / count
        wind, variance = (
            (old * a[0] + new * b[0], old * a[1] + new * b[1])
            for a, b in (
                (self.wind_ne_mps, later.wind_ne_mps),
                (self.variance_ne_m2ps2, later.variance_ne_m2ps2),
            )
        )
        return ReportSegment(count, self.first, later.last, wind, variance)

    @property
    def ends_wind_variances_and_count(self) -> tuple[float, ...]:
        """Both ends (8), wind (2), variances (2) and count."""
        return (*self.first, *self.last, *self.wind_ne_mps, *self.variance_ne_m2ps2, self.count)


@dataclass(slots=True)
class MemberReports:
    """Stored reports of one member, oldest first."""

    segments: list[ReportSegment] = field(default_factory=list)
    newest: MemberWindReport | None = None
    _same_since_s: float = 0.0
    _same_count: int = 0

    def store_or_rejection_reason(
        self, report: MemberWindReport, merge_interval_s: float = REPORT_AVERAGING_S
    ) -> str:
        """Store a report. Returns the reason for a rejection; empty if stored or redundant.

        `merge_interval_s`: recent reports within this time are merged.
        """
        if reason := report.rejection_reason_or_empty():
            return reason
        before = self.newest
        if before is not None:
            if report.t_s <= before.t_s:
                return ""
            if (
                report.t_s - before.t_s < REPORT_AVERAGING_S - 0.5
                and self.segments
                and report.t_s - self.segments[-1].last[0] <= KEPT_S
            ):
                return ""
            moved_m = math.dist(before.position_ne_m, report.position_ne_m)
            if moved_m / max(report.t_s - before.t_s, 1e-3) > MAX_SPEED_MPS:
                self.segments.clear()
                self.newest = report
                return f"position moved faster than {MAX_SPEED_MPS:g} m/s"
        if reason := self._update_constant_wind_and_reject(report):
            return reason
        self.newest = report
        segment = ReportSegment.from_report(report)
        last = self.segments[-1] if self.segments else None
        if last is not None and report.t_s - last.first[0] < merge_interval_s - 0.5:
            self.segments[-1] = last.merged_with(segment)
        else:
            self.segments.append(segment)
        return ""

    @property
    def is_rejected_for_constant_wind(self) -> bool:
        """Whether the member is rejected for a constant wind; `merge_old_and_drop_expired_segments`
        keeps this state.
        """
        return self._same_count >= FROZEN_COUNT

    def merge_old_and_drop_expired_segments(self, now_s: float, max_segments: int) -> None:
        """Merge segments that are not recent, drop old ones and keep the latest `max_segments`."""
        kept: list[ReportSegment] = []
        for one in self.segments:
            if now_s - one.last[0] > KEPT_S:
                continue
            before = kept[-1] if kept else None
            fits = before is not None and one.last[0] - before.first[0] < MERGED_S - 0.5
            if before is not None and fits and now_s - one.last[0] > RECENT_S:
                kept[-1] = before.merged_with(one)
            else:
                kept.append(one)
        self.segments = kept[-max_segments:]

    def _update_constant_wind_and_reject(self, report: MemberWindReport) -> str:
        """Return a reason if the wind is constant for too long; drops the reports of that time."""
        before = self.newest
        if before is None or before.mean_to_ne_mps != report.mean_to_ne_mps:
            self._same_since_s, self._same_count = report.t_s, 1
            return ""
        self._same_count += 1
        if self._same_count < FROZEN_COUNT or report.t_s - self._same_since_s < FROZEN_S - 0.5:
            return ""
        constant_since_s = self._same_since_s
        self.segments = [one for one in self.segments if one.last[0] < constant_since_s]
        self.newest = report
        return f"reported the same wind for {report.t_s - constant_since_s:.0f} s"


@dataclass(frozen=True, slots=True)
class SegmentArrays:
    """Segments of all members as arrays in order of time: member numbers, ends (n, 4), winds and
    variances (n, 2), counts (n,)."""

    members: tuple[str, ...]
    member: Ints
    middle: Floats
    first: Floats
    last: Floats
    wind_ne_mps: Floats
    variance_ne_m2ps2: Floats
    count: Floats

    @classmethod
    def from_member_reports(
        cls, members: dict[str, MemberReports], max_segments: int
    ) -> "SegmentArrays":
        """Build the arrays from at most `max_segments` segments, without the oldest ones."""
        rows = sorted(
            _iterate_member_number_and_segment(members),
            key=lambda row: row[1].first[0] + row[1].last[0],
        )
        rows = rows[-max_segments:]
        numbers = np.array([row[1].ends_wind_variances_and_count for row in rows]).reshape(-1, 13)
        first, last = numbers[:, 0:4], numbers[:, 4:8]
        middle = 0.5 * (first + last)
        middle[:, 0] -= 0.5 * REPORT_AVERAGING_S  # a report is a mean over the seconds before it
        return cls(
            tuple(members),
            np.array([row[0] for row in rows], np.int64),
            middle,
            first,
            last,
            numbers[:, 8:10],
            numbers[:, 10:12],
            numbers[:, 12],
        )

    def without_members(self, member_names: frozenset[str]) -> "SegmentArrays":
        """Return a copy without the segments of the named members."""
        stays = np.array([self.members[int(k)] not in member_names for k in self.member], np.bool_)
        return SegmentArrays(
            self.members,
            self.member[stays],
            self.middle[stays],
            self.first[stays],
            self.last[stays],
            self.wind_ne_mps[stays],
            self.variance_ne_m2ps2[stays],
            self.count[stays],
        )


def _iterate_member_number_and_segment(
    members: dict[str, MemberReports],
) -> Iterator[tuple[int, ReportSegment]]:
    for number, name in enumerate(members):
        for stretch in members[name].segments:
            yield number, stretch
