"""Fronts over a site: which members may report one, and the fronts of the last half hour."""

from dataclasses import dataclass, field

from companion.core.wind_field.fronts import FrontMonitor, FrontUpdate, FrontWithdrawn, WindFront
from companion.core.wind_field.wind_reports import MemberWindReport
from ground_station.core.site_wind.wind_reporters import ReportingMember, ReportingMembers

MIN_HEIGHT_FRACTION = 0.5
"""Minimum height, as a share of cruise height: a descent into weaker wind is no front. A landing in
15 m/s looks like a change of 16 m/s.
"""

EXCLUSION_GRACE_S = 60.0
"""A member excluded for longer cannot report a front. Not sooner, because the first member inside a
front also contradicts the others.
"""

FRONT_KEPT_S = 1800.0
"""Time after which a front has left any site."""


@dataclass(slots=True)
class SiteFronts:
    """The fronts of one receiver. `height_m`: cruise height above ground."""

    monitor: FrontMonitor
    members: ReportingMembers
    height_m: float
    fronts: list[WindFront] = field(default_factory=list)
    """Latest estimate of each front, oldest front first."""

    def update_fronts_with_report(
        self, report: MemberWindReport, member: ReportingMember, t_s: float
    ) -> FrontUpdate | None:
        """Process a wind report. Returns a new, updated or withdrawn front, else None."""
        low = report.height_m < MIN_HEIGHT_FRACTION * self.height_m
        if low or (member.exclusion_reason and t_s - member.excluded_s > EXCLUSION_GRACE_S):
            return None
        found = self.monitor.add_report_and_update_front(report)
        if isinstance(found, FrontWithdrawn):
            before = len(self.fronts)
            self.fronts = [one for one in self.fronts if one.detected_s != found.front.detected_s]
            return found if len(self.fronts) < before else None
        if found is None or self._is_detected_by_single_station(found):
            return None
        self.fronts = [*(one for one in self.fronts if one.detected_s != found.detected_s), found]
        return found

    def drop_expired_and_get_fronts(self, now_s: float) -> list[WindFront]:
        """Return the fronts that may still be on the site."""
        self.fronts = [one for one in self.fronts if now_s - one.detected_s <= FRONT_KEPT_S]
        return self.fronts

    def _is_detected_by_single_station(self, front: WindFront) -> bool:
        """Return True if one station alone detected the front: it may be faulty."""
        detecting_members = {one.member for one in front.detections}
        return len(detecting_members) == 1 and detecting_members <= self.members.stations
