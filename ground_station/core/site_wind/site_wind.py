"""The wind over a site, estimated by one desk, map or `monitor` from the reports of all airborne
drones and stations; and approaching fronts.
"""

import numpy as np

from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.fronts import FrontMonitor, FrontUpdate, FrontWithdrawn, WindFront
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, MemberWindReport
from companion.fleet.messages import State
from ground_station.core.schema.day import Forecast
from ground_station.core.site_wind.estimated_wind import SiteWindEstimate, wind_estimate_at
from ground_station.core.site_wind.site_field import SiteFieldEstimator
from ground_station.core.site_wind.site_fronts import SiteFronts
from ground_station.core.site_wind.state_reports import StateWindReports
from ground_station.core.site_wind.wind_reporters import (
    REPORT_TIMEOUT_S,
    ReportingMember,
    ReportingMembers,
)


class SiteWind:
    """Estimates the site wind from the states of a fleet. All times are of one clock of the
    receiver.

    Positions are metres (north, east) about the depot; without a depot, about the first reported
    position (only texts and times of fronts are meaningful then).
    """

    def __init__(
        self,
        process: WindProcessParams,
        depot_deg: tuple[float, float] | None = None,
        forecast: Forecast | None = None,
        height_m: float = 40.0,
        *,
        watches_fronts: bool = True,
    ) -> None:
        """`depot_deg`: latitude and longitude. `forecast` at `height_m` above ground is the prior
        before any report; None: any wind. `watches_fronts` False: no front is reported.
        """
        self.height_m = height_m
        self._state_reports = StateWindReports(depot_deg)
        self._members = ReportingMembers()
        self._estimator = SiteFieldEstimator(process, self._members, forecast, height_m)
        self._watches_fronts = watches_fronts
        self._fronts = SiteFronts(FrontMonitor(process), self._members, height_m)

    def update_from_state(self, state: State, t_s: float) -> FrontUpdate | None:
        """Process a state. Returns a new, updated or withdrawn front, else None."""
        report = self._state_reports.wind_report_from_state(state, t_s)
        member = None if report is None else self._members.record_report(report, t_s)
        if report is None or member is None:
            return None
        if not self._estimator.add_drone_report_if_valid(report, member, t_s):
            return None
        return self._update_front_from_report(report, member, t_s)

    def update_from_station_report(
        self, report: MemberWindReport, t_s: float
    ) -> FrontUpdate | None:
        """Process a station's measurement. Returns a new, updated or withdrawn front, else None."""
        member = self._members.record_report(report, t_s)
        if member is None:
            return None
        self._members.stations.add(report.member)
        if not self._estimator.add_station_report_or_exclude(report, member, t_s):
            return None
        return self._update_front_from_report(report, member, t_s)

    def _update_front_from_report(
        self, report: MemberWindReport, member: ReportingMember, t_s: float
    ) -> FrontUpdate | None:
        if not self._watches_fronts:
            return None
        self._estimator.update_and_get_field(t_s)  # excluded members report no front
        self._fronts.monitor.set_terrain_share(self._estimator.terrain_share)
        found = self._fronts.update_fronts_with_report(report, member, t_s)
        if isinstance(found, FrontWithdrawn):
            self._estimator.set_front(None)
        elif found is not None:
            self._estimator.set_front(found)
        return found

    def set_prior(self, forecast: Forecast) -> None:
        """Set the prior at cruise height to a later time of the forecast."""
        self._estimator.set_prior(forecast)

    def position_ne_m(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Return a position in metres about the depot."""
        return self._state_reports.position_ne_m_setting_first_origin(lat_deg, lon_deg)

    # --- reporting members ---------------------------------------------------------------------

    @property
    def station_names(self) -> frozenset[str]:
        """Members that are ground stations."""
        return frozenset(self._members.stations)

    def latest_accepted_reports(
        self, t_s: float, max_age_s: float = REPORT_TIMEOUT_S
    ) -> list[MemberWindReport]:
        """Return the latest report of each accepted member that reported recently, by name."""
        return self._estimator.latest_accepted_reports(t_s, max_age_s)

    def exclusion_reason_by_member(self, t_s: float) -> dict[str, str]:
        """Return the excluded members with the reasons."""
        return self._estimator.exclusion_reason_by_member(t_s)

    def is_wind_known_by_drones(self, t_s: float) -> bool:
        """Return True if an accepted drone has reported recently and for long enough. Stations
        alone may all be wrong; `depot_wind_by_stations` returns their estimate.
        """
        return bool(self._estimator.drones_with_sufficient_reports(t_s))

    # --- the field -----------------------------------------------------------------------------

    def wind_at(
        self,
        now_s: float,
        position_ne_m: tuple[float, float],
        height_m: float,
        target_s: float,
        averaging_s: float = REPORT_AVERAGING_S,
    ) -> SiteWindEstimate:
        """Return the wind at a position, height above ground and time, as a mean about it."""
        return wind_estimate_at(
            self._estimator.update_and_get_field(now_s),
            position_ne_m,
            height_m,
            target_s,
            averaging_s,
        )

    def depot_wind(
        self, now_s: float, lead_s: float, averaging_s: float
    ) -> SiteWindEstimate | None:
        """Return the wind over the depot at cruise height `lead_s` from now; None: not known."""
        if not self.is_wind_known_by_drones(now_s):
            return None
        return self.wind_at(now_s, (0.0, 0.0), self.height_m, now_s + lead_s, averaging_s)

    def depot_wind_by_stations(
        self, now_s: float, lead_s: float, averaging_s: float
    ) -> SiteWindEstimate | None:
        """Return the same by stations alone; None: drones report, or no station does."""
        if self.is_wind_known_by_drones(
            now_s
        ) or not self._estimator.stations_with_sufficient_reports(now_s):
            return None
        return self.wind_at(now_s, (0.0, 0.0), self.height_m, now_s + lead_s, averaging_s)

    def wind_at_report_centroid(self, now_s: float) -> SiteWindEstimate | None:
        """Return the present wind at the centroid and mean height of the reports, else None."""
        reports = self.latest_accepted_reports(now_s)
        if not reports:
            return None
        north, east, height = np.mean(
            [(*one.position_ne_m, one.height_m) for one in reports], axis=0
        )
        return self.wind_at(now_s, (float(north), float(east)), float(height), now_s)

    # --- fronts --------------------------------------------------------------------------------

    @property
    def fronts(self) -> list[WindFront]:
        """Fronts of the last half hour in their latest estimate, oldest first."""
        return self._fronts.fronts

    def drop_expired_and_get_fronts(self, now_s: float) -> list[WindFront]:
        """Return the fronts that may still be on the site."""
        return self._fronts.drop_expired_and_get_fronts(now_s)
