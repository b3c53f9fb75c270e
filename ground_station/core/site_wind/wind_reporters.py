"""Members that report the wind of a site: first and latest report, and exclusion with its reason.

Exclusion is decided elsewhere (`site_field`) and recorded here.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, MemberWindReport

REPORT_TIMEOUT_S, MIN_SPAN_S = 120.0, 60.0
"""The field is known where a member has reported within the last two minutes, for a minute or
longer: this averages the gusts and turns of one drone.
"""

REJECTION_S = 1.5 * REPORT_AVERAGING_S
"""Validity of a rejection (frozen or impossible wind). A member with continued invalid reports is
rejected again within this time.
"""


@dataclass(slots=True)
class ReportingMember:
    """Reports of one member: the start of the unbroken sequence and the latest report.
    `exclusion_reason`: reason of its exclusion since `excluded_s`; `agreeing_since_s`: since when
    it fits the others again.
    """

    since_s: float
    latest_report: MemberWindReport
    exclusion_reason: str = ""
    excluded_s: float = 0.0
    agreeing_since_s: float | None = None
    last_check_s: float = -math.inf

    def exclude(self, reason: str, t_s: float) -> None:
        """Exclude the member from now on."""
        self.exclusion_reason, self.excluded_s, self.agreeing_since_s = reason, t_s, None


@dataclass(slots=True)
class ReportingMembers:
    """All members that have reported to one receiver. `stations`: ground stations among them."""

    stations: set[str] = field(default_factory=set)
    _by_name: dict[str, ReportingMember] = field(default_factory=dict)
    _rejections: dict[str, tuple[float, str]] = field(default_factory=dict)

    @property
    def drone_names(self) -> frozenset[str]:
        """Members that are not stations."""
        return frozenset(self._by_name.keys() - self.stations)

    def record_report(self, report: MemberWindReport, t_s: float) -> ReportingMember | None:
        """Record a report and return its member; None: the wind is impossible."""
        name = report.member
        if rejection_reason := report.rejection_reason_or_empty():
            self.record_rejection(name, rejection_reason, t_s)
            return None
        member = self._by_name.get(name)
        if member is None or t_s - member.latest_report.t_s > REPORT_TIMEOUT_S:
            previous = member
            member = self._by_name[name] = ReportingMember(t_s, report)
            if previous is not None and previous.exclusion_reason:
                member.exclude(previous.exclusion_reason, previous.excluded_s)
        member.latest_report = report
        return member

    def record_rejection(self, name: str, reason: str, t_s: float) -> None:
        """Record that the member's present report was rejected."""
        self._rejections[name] = t_s, reason

    def exclude(self, name: str, reason: str, t_s: float) -> None:
        """Exclude the member from now on."""
        if name in self._by_name:
            self._by_name[name].exclude(reason, t_s)

    def exclusion_reason_by_member(self, t_s: float) -> dict[str, str]:
        """Return the excluded members with the reasons."""
        rejected = {
            name: reason
            for name, (rejected_s, reason) in self._rejections.items()
            if t_s - rejected_s <= REJECTION_S
        }
        return rejected | {
            name: member.exclusion_reason
            for name, member in self._by_name.items()
            if member.exclusion_reason and t_s - member.latest_report.t_s <= REPORT_TIMEOUT_S
        }

    def latest_accepted_reports(
        self, t_s: float, max_age_s: float = REPORT_TIMEOUT_S
    ) -> list[MemberWindReport]:
        """Return the latest report of each accepted member that reported recently, by name."""
        excluded = self.exclusion_reason_by_member(t_s)
        return [
            member.latest_report
            for name, member in sorted(self._by_name.items())
            if name not in excluded and t_s - member.latest_report.t_s <= max_age_s
        ]

    def drones_with_sufficient_reports(self, t_s: float) -> list[str]:
        """Return the accepted drones that have reported recently and for long enough."""
        return self._members_reporting_long_enough(
            one.member for one in self.latest_accepted_reports(t_s) if self._is_drone(one)
        )

    def stations_with_sufficient_reports(self, t_s: float) -> list[str]:
        """Return the accepted stations that have reported recently and for long enough."""
        return self._members_reporting_long_enough(
            one.member for one in self.latest_accepted_reports(t_s) if not self._is_drone(one)
        )

    def _is_drone(self, report: MemberWindReport) -> bool:
        return report.member not in self.stations

    def _members_reporting_long_enough(self, names: Iterable[str]) -> list[str]:
        each = ((name, self._by_name[name]) for name in names)
        return [name for name, one in each if one.latest_report.t_s - one.since_s >= MIN_SPAN_S]
