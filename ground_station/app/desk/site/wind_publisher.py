"""Wind reports from the desk to each vehicle in flight or about to launch.

Forwards measurements that the desk accepts itself, nearest first, and a front as soon as it is
detected. Each vehicle decides how to use them.
"""

import math
from dataclasses import dataclass, field
from heapq import nsmallest

import msgspec

from companion.core.wind_field.fronts import WindFront
from companion.core.wind_field.shared_winds import (
    MAX_REPORTS,
    MOST_AGE_S,
    REPORT_INTERVAL_S,
    EncodedWindReport,
    SharedWinds,
    encode_front,
)
from companion.core.wind_field.wind_reports import MemberWindReport
from companion.fleet.messages import State
from ground_station.core.fleet.fleet_link import FleetLink
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.site_wind.site_fronts import FRONT_KEPT_S
from ground_station.core.site_wind.site_wind import SiteWind

FRONT_REPEATS = 3
"""Number of transmissions of a front that is new, updated or withdrawn: messages may be lost."""

MAX_REPORTS_PER_CYCLE = 50
"""Maximum reports per cycle of the desk: each is computed and signed in less than a millisecond,
and a thousand members also send and wait for reports.
"""


@dataclass(slots=True)
class _LastReport:
    """Last report sent to one vehicle."""

    sent_s: float = -math.inf
    front: WindFront | None = None
    """None: no front, or a withdrawn one."""
    front_repeats: int = FRONT_REPEATS


@dataclass(slots=True)
class WindPublisher:
    """Wind publisher of one desk. Times are of the desk's clock."""

    wind: SiteWind
    fleet: FleetLink
    _last_reports: dict[str, _LastReport] = field(default_factory=dict)

    def send_due_wind_reports(self, status: FleetStatus, now_s: float) -> None:
        """Send a report to each vehicle for which it is due."""
        fronts = self.wind.drop_expired_and_get_fronts(now_s)
        front = fronts[-1] if fronts else None
        due = self._vehicles_due_for_report(status, front, now_s)
        accepted = self.wind.latest_accepted_reports(now_s, MOST_AGE_S) if due else []
        for last_report, state, received_s in due:
            if front is not last_report.front:
                last_report.front, last_report.front_repeats = front, 0
            winds = self._build_report(state, received_s, accepted, last_report)
            if winds is not None:
                last_report.sent_s = now_s
                last_report.front_repeats += 1
                self.fleet.publish(winds)

    def _vehicles_due_for_report(
        self, status: FleetStatus, front: WindFront | None, now_s: float
    ) -> list[tuple[_LastReport, State, float]]:
        """Return the due vehicles, longest without a report first, with state and receive time."""
        due: list[tuple[_LastReport, State, float]] = []
        for name in sorted(status.vehicles):
            vehicle_status = status.status_of(name)
            state = vehicle_status.state
            if (
                state is None
                or vehicle_status.received_s is None
                or not vehicle_status.is_uniquely_online_and_reporting(now_s)
            ):
                continue
            last_report = self._last_reports.setdefault(name, _LastReport())
            if (
                last_report.front is not None
                and now_s - last_report.front.detected_s > FRONT_KEPT_S
            ):
                last_report.front = None  # it has left the site without being withdrawn
            has_new_front = front is not last_report.front
            if _needs_wind_report(state) and (
                has_new_front or now_s - last_report.sent_s >= REPORT_INTERVAL_S
            ):
                due.append((last_report, state, vehicle_status.received_s))
        due.sort(key=lambda one: one[0].sent_s)
        return due[:MAX_REPORTS_PER_CYCLE]

    def _build_report(
        self,
        state: State,
        received_s: float,
        accepted: list[MemberWindReport],
        last_report: _LastReport,
    ) -> SharedWinds | None:
        """Return the report for this state, received at `received_s`; None: there is no content."""
        assert state.lat_deg is not None
        assert state.lon_deg is not None
        north, east = position_ne_m = self.wind.position_ne_m(state.lat_deg, state.lon_deg)
        others = [one for one in accepted if one.member != state.vehicle]
        others = nsmallest(
            MAX_REPORTS,
            others,
            key=lambda one: (math.dist(one.position_ne_m, position_ne_m), one.member),
        )
        winds = [
            EncodedWindReport.encode(
                one, one.position_ne_m[0] - north, one.position_ne_m[1] - east, received_s - one.t_s
            )
            for one in others
            if received_s - one.t_s <= MOST_AGE_S
        ]
        front = msgspec.UNSET
        if last_report.front_repeats < FRONT_REPEATS:
            front = (
                None
                if last_report.front is None
                else encode_front(last_report.front, position_ne_m, received_s)
            )
        if not winds and front is msgspec.UNSET:
            return None
        return SharedWinds(
            vehicle=state.vehicle,
            instance_id=state.instance_id,
            as_of_s=round(state.uptime_s, 1),
            lat_deg=round(state.lat_deg, 4),
            lon_deg=round(state.lon_deg, 4),
            reports=winds,
            front=front,
        )


def _needs_wind_report(state: State) -> bool:
    """Whether it flies or has an assignment, and its state gives its position."""
    has_position = state.lat_deg is not None and state.lon_deg is not None
    return has_position and state.airframe != TRUCK and bool(state.armed or state.assignment)
