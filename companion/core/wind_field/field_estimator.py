"""Estimate of the wind over a site from the members' reports, with a forecast as prior.

Each update recomputes the field from at most `MAX_SEGMENTS` segment means in a few milliseconds
(`settled_field`). Members that contradict the others are excluded (`agreement`).
"""

from dataclasses import replace

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind_field import terrain_effect
from companion.core.wind_field.agreement import exclusion_reason_by_member
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.front_term import FrontTerm
from companion.core.wind_field.fronts import WindFront
from companion.core.wind_field.settled_field import AirState, FieldEstimate, WindPrior
from companion.core.wind_field.wind_reports import (
    KEPT_S,
    MAX_AGE_S,
    MERGED_S,
    REPORT_AVERAGING_S,
    MemberReports,
    MemberWindReport,
    ReportSegment,
    SegmentArrays,
)

MAX_SEGMENTS = 150
"""Covers the last two minutes of a hundred drones, or the complete memory of eight."""
_MANY_MEMBERS = 12
"""With more members than this, recent reports are merged over longer times."""

_MIN_AGE_DIFFERENCE_S = 2.0
"""A current estimate adds information if it is this much newer than the last stored report."""

_SPARE_SEGMENTS = 3
"""Segments kept of each member beyond its share: some members report less often, or leave."""

MIN_MISFIT, MAX_MISFIT = 1.1, 6.0
"""Limits of the mean square misfit, which scales the process's variances: above the lower limit the
air is gustier than the process, or a front passes."""

FRONT_MEMORY_S = KEPT_S + 300.0
"""Time after detection when a front has left the site and all earlier reports are dropped."""

LEARNING_INTERVAL_S = 60.0
"""Minimum interval for learning the terrain effect, which about doubles the cost of an update."""


class FieldEstimator:
    """Estimator of the site wind, one per desk or vehicle. Without `prior` any wind is possible."""

    def __init__(self, process: FieldProcess, prior: WindPrior | None = None) -> None:
        self._process = process
        self._prior = prior or WindPrior((0.0, 0.0), process.process.level_std_mps)
        self._members: dict[str, MemberReports] = {}
        self._front: WindFront | None = None
        self._terrain = terrain_effect.TerrainShare()

    def set_front(self, front: WindFront | None) -> None:
        """Set the accepted front, or its better estimate; None: no front.

        It is used while an accepted member has detected it, until older reports expire.
        """
        self._front = front

    def set_prior(self, prior: WindPrior) -> None:
        """Set the forecast for positions without reports; it changes with time."""
        self._prior = prior

    def add_report_or_rejection_reason(self, report: MemberWindReport, now_s: float) -> str:
        """Add a report at any rate. Returns the reason for a rejection, or empty.

        Times are on the receiver's clock: old reports and reports from the future are rejected.
        """
        if not -1.0 <= now_s - report.t_s <= MAX_AGE_S:
            return f"{now_s - report.t_s:.0f} s old"
        merge_s = min(REPORT_AVERAGING_S * -(-len(self._members) // _MANY_MEMBERS), MERGED_S)
        return self._members.setdefault(report.member, MemberReports()).store_or_rejection_reason(
            report, merge_s
        )

    @property
    def terrain_share(self) -> float:
        """Estimated terrain effect over the mean wind; 0: none."""
        return self._terrain.share

    def remove_member(self, member: str) -> None:
        """Delete all reports of a member."""
        self._members.pop(member, None)

    def prune_learn_and_estimate_field(
        self,
        now_s: float,
        own_member: str = "",
        protected_members: frozenset[str] = frozenset(),
        newest_report_not_stored: MemberWindReport | None = None,
    ) -> FieldEstimate:
        """Estimate the current field. `own_member` (the vehicle itself) is never excluded, nor are
        members in `protected_members`, which are checked elsewhere. `newest_report_not_stored`:
        current estimate, not stored.
        """
        each = MAX_SEGMENTS // max(len(self._members), 1) + _SPARE_SEGMENTS
        for name in list(self._members):
            self._members[name].merge_old_and_drop_expired_segments(now_s, each)
            if (
                not self._members[name].segments
                and not self._members[name].is_rejected_for_constant_wind
            ):
                del self._members[name]
        kept = SegmentArrays.from_member_reports(
            self._members_with_newest_report(newest_report_not_stored), MAX_SEGMENTS
        )
        out: dict[str, str] = {}
        if not kept.count.size or now_s < self._terrain.learned_s:
            self._terrain = terrain_effect.TerrainShare()
        judged = AirState(terrain_share=self._terrain.share)
        while True:
            estimate = self._estimate_scaled_by_misfit(kept, now_s, judged)
            bad = exclusion_reason_by_member(
                estimate.mean_shift_chi_squares, kept, now_s, own_member, protected_members
            )
            if not bad:
                break
            out |= bad
            kept = kept.without_members(frozenset(bad))
        # After the exclusion: an invented front would explain the false reports of its sender.
        front = self._active_front_term(kept, now_s)
        due = now_s - self._terrain.learned_s >= LEARNING_INTERVAL_S
        if due:
            self._update_terrain_share(kept, now_s, front, estimate)
        air = AirState(1.0, self._terrain.share, front)
        if air != judged:
            estimate = self._estimate_scaled_by_misfit(kept, now_s, air, estimate)
        estimate.excluded = dict(out)
        return estimate

    def _update_terrain_share(
        self,
        report_segments: SegmentArrays,
        now_s: float,
        front: FrontTerm | None,
        reusable_estimate: FieldEstimate,
    ) -> None:
        """Update the terrain effect from the stored reports."""
        logs = self._segment_log_likelihoods_by_share(
            report_segments, now_s, front, reusable_estimate
        )
        member_logs = {
            report_segments.members[int(number)]: logs[:, report_segments.member == number].sum(
                axis=1
            )
            for number in np.unique(report_segments.member)
        }
        all_logs, others = logs.sum(axis=1), np.zeros(len(terrain_effect.SHARES))
        if len(member_logs) > terrain_effect.MIN_OTHER_MEMBERS:
            most = self._terrain.add_evidence_and_find_dominant_member(member_logs, now_s)
            others = self._segment_log_likelihoods_by_share(
                report_segments.without_members(frozenset([most])), now_s, front
            )
            others = others.sum(axis=1)
        self._terrain.update_share(all_logs, others, now_s)

    def _segment_log_likelihoods_by_share(
        self,
        report_segments: SegmentArrays,
        now_s: float,
        front: FrontTerm | None,
        reusable_estimate: FieldEstimate | None = None,
    ) -> Floats:
        """Return log likelihoods of the segments under each of `terrain_effect.SHARES` (shares, n).
        Segments that were learned before have 0."""
        logs: list[Floats] = []
        newer = report_segments.middle[:, 0] > self._terrain.learned_s
        for share in terrain_effect.SHARES:
            reusable_estimate = self._estimate_scaled_by_misfit(
                report_segments, now_s, AirState(1.0, share, front), reusable_estimate
            )
            logs.append(np.where(newer, reusable_estimate.segment_log_likelihoods(), 0.0))
        return np.array(logs)

    def _estimate_scaled_by_misfit(
        self,
        report_segments: SegmentArrays,
        now_s: float,
        air: AirState,
        reusable_estimate: FieldEstimate | None = None,
    ) -> FieldEstimate:
        """Estimate with variances scaled by the misfit, reusing the law of `reusable_estimate`."""
        estimate = FieldEstimate(
            self._process, self._prior, report_segments, now_s, air, reusable_estimate
        )
        if (misfit := estimate.variance_misfit_ratio()) <= MIN_MISFIT:
            return estimate
        scaled_air = replace(air, gust_factor=min(misfit, MAX_MISFIT))
        return FieldEstimate(
            self._process, self._prior, report_segments, now_s, scaled_air, estimate
        )

    def _active_front_term(self, report_segments: SegmentArrays, now_s: float) -> FrontTerm | None:
        """Return the front if it is recent and a member that detected it is accepted."""
        front = self._front
        if front is None or now_s - front.detected_s > FRONT_MEMORY_S:
            return None
        accepted = {report_segments.members[int(k)] for k in np.unique(report_segments.member)}
        return FrontTerm(front) if any(one.member in accepted for one in front.detections) else None

    def _members_with_newest_report(
        self, newest_report: MemberWindReport | None
    ) -> dict[str, MemberReports]:
        """Return all members, with a current estimate added to one of them."""
        if newest_report is None or newest_report.rejection_reason_or_empty():
            return self._members
        before = self._members.get(newest_report.member, MemberReports()).segments
        if before and newest_report.t_s - before[-1].last[0] < _MIN_AGE_DIFFERENCE_S:
            return self._members
        return self._members | {
            newest_report.member: MemberReports([*before, ReportSegment.from_report(newest_report)])
        }
