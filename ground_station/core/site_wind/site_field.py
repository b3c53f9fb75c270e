"""The wind field over a site, by drones alone and with stations; exclusion of members.

Drones are checked against each other, stations against drones. A station never excludes a drone.
"""

import numpy as np

from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.field_estimator import FieldEstimator
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.fronts import WindFront
from companion.core.wind_field.settled_field import FieldEstimate, WindPrior
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S, MemberWindReport
from ground_station.core.schema.day import Forecast
from ground_station.core.site_wind.estimated_wind import (
    SiteWindEstimate,
    wind_estimate_at,
    wind_from_direction_deg,
)
from ground_station.core.site_wind.wind_reporters import ReportingMember, ReportingMembers

ESTIMATE_INTERVAL_S = REPORT_AVERAGING_S
"""Minimum interval of field estimates: a wind report is a mean over as long."""

PRIOR_STD_FACTOR = 5.0
"""Factor on the forecast's stated error: a wrong forecast stays wrong for hours, and measurements
must outweigh it within a minute or two.
"""

READMISSION_S, READMISSION_CHI_SQUARE = 120.0, 9.21
"""A member excluded for contradiction is readmitted after its wind has fitted the others for so
long, within a chi-square (two degrees of freedom) that chance exceeds once in a hundred times. The
fit of all its reports is no criterion: false reports inflate the estimated gusts until they fit.
"""

STATION_CHI_SQUARE = 30.0
"""A station is excluded if it differs from the drones' field, or without drones from the forecast,
by more than this chi-square (two degrees of freedom: once in three million).
"""


class SiteFieldEstimator:
    """The wind field of one receiver. All times are of its own clock."""

    def __init__(
        self,
        process: WindProcessParams,
        members: ReportingMembers,
        forecast: Forecast | None,
        height_m: float,
    ) -> None:
        """`forecast` at `height_m` above ground is the prior before any wind report; None: any
        wind.
        """
        prior = None if forecast is None else _prior_from_forecast(forecast, height_m)
        self._forecast, self._height_m = forecast, height_m
        self._members = members
        self._process = FieldProcess(process)
        self._drone_estimator = FieldEstimator(self._process, prior)
        self._full_estimator = FieldEstimator(self._process, prior)
        self._field: FieldEstimate | None = None
        self._drone_field: FieldEstimate | None = None

    def set_prior(self, forecast: Forecast) -> None:
        """Set the prior at cruise height to a later time of the forecast."""
        self._forecast = forecast
        for estimator in (self._drone_estimator, self._full_estimator):
            estimator.set_prior(_prior_from_forecast(forecast, self._height_m))

    def set_front(self, front: WindFront | None) -> None:
        """Set or update the front of the field; None: withdraw it."""
        for estimator in (self._drone_estimator, self._full_estimator):
            estimator.set_front(front)
        self._field = None

    def add_drone_report_if_valid(
        self, report: MemberWindReport, member: ReportingMember, t_s: float
    ) -> bool:
        """Add a drone's wind report. Returns True for a valid wind, even of an excluded drone."""
        if member.exclusion_reason:
            self._try_readmit_excluded_member(member, t_s)
            return True
        reason = self._drone_estimator.add_report_or_rejection_reason(report, t_s)
        if reason:
            self._members.record_rejection(report.member, reason, t_s)
        self._full_estimator.add_report_or_rejection_reason(report, t_s)
        return not reason

    def add_station_report_or_exclude(
        self, report: MemberWindReport, member: ReportingMember, t_s: float
    ) -> bool:
        """Add a wind report of a station. The station is excluded if it contradicts the drones, or
        without other reports the forecast.
        """
        if member.exclusion_reason:
            self._try_readmit_excluded_member(member, t_s)
        elif reason := self._station_contradiction_reason(report, t_s):
            self._full_estimator.remove_member(report.member)
            member.exclude(reason, t_s)
            self._field = None
        elif reason := self._full_estimator.add_report_or_rejection_reason(report, t_s):
            self._members.record_rejection(report.member, reason, t_s)
            return False
        return True

    # --- the fields ----------------------------------------------------------------------------

    def update_and_get_field(self, t_s: float) -> FieldEstimate:
        """Return the field estimate, at most `ESTIMATE_INTERVAL_S` old."""
        before = self._field
        if before is not None and 0.0 <= t_s - before.now_s < ESTIMATE_INTERVAL_S:
            return before
        field_estimate = self._drone_field = self._drone_estimator.prune_learn_and_estimate_field(
            t_s
        )
        self._exclude_contradicting_members(field_estimate, t_s)
        if self._members.stations:
            field_estimate = self._full_estimator.prune_learn_and_estimate_field(
                t_s, protected_members=self._members.drone_names
            )
            self._exclude_contradicting_members(field_estimate, t_s)
        self._field = field_estimate
        return field_estimate

    @property
    def terrain_share(self) -> float:
        """Standing wind variation over the ground by drones, relative to the mean wind."""
        return self._drone_estimator.terrain_share

    def _current_drone_field(self, t_s: float) -> FieldEstimate:
        """Return the estimate by drones alone, at most `ESTIMATE_INTERVAL_S` old."""
        self.update_and_get_field(t_s)
        assert self._drone_field is not None
        return self._drone_field

    def _exclude_contradicting_members(self, field_estimate: FieldEstimate, t_s: float) -> None:
        for name, reason in field_estimate.excluded.items():
            self._drone_estimator.remove_member(name)
            self._full_estimator.remove_member(name)
            self._members.exclude(name, reason, t_s)

    # --- excluded and accepted members ---------------------------------------------------------

    def exclusion_reason_by_member(self, t_s: float) -> dict[str, str]:
        """Return the excluded members with the reasons."""
        self.update_and_get_field(t_s)
        return self._members.exclusion_reason_by_member(t_s)

    def latest_accepted_reports(self, t_s: float, max_age_s: float) -> list[MemberWindReport]:
        """Return the latest report of each accepted member that reported recently, by name."""
        self.update_and_get_field(t_s)
        return self._members.latest_accepted_reports(t_s, max_age_s)

    def drones_with_sufficient_reports(self, t_s: float) -> list[str]:
        """Return the accepted drones that have reported recently and for long enough."""
        self.update_and_get_field(t_s)
        return self._members.drones_with_sufficient_reports(t_s)

    def stations_with_sufficient_reports(self, t_s: float) -> list[str]:
        """Return the accepted stations that have reported recently and for long enough."""
        self.update_and_get_field(t_s)
        return self._members.stations_with_sufficient_reports(t_s)

    def _station_contradiction_reason(self, report: MemberWindReport, t_s: float) -> str:
        """Return the reason to exclude a station; empty: it fits, or there is no reference."""
        found = self._expected_wind_at_station(report, t_s)
        if found is None or found.chi_square_of_report(report) <= STATION_CHI_SQUARE:
            return ""
        reference = "the drones" if self.drones_with_sufficient_reports(t_s) else "the forecast"
        from_deg = wind_from_direction_deg(found.to_ne_mps)
        return f"differs from {reference}: {found.speed_mps:.1f} m/s from {from_deg:.0f} there"

    def _expected_wind_at_station(
        self, report: MemberWindReport, t_s: float
    ) -> SiteWindEstimate | None:
        """Return the expected wind at a station: by drones; without drones and other stations, by
        the forecast. None: no reference.
        """
        if self.drones_with_sufficient_reports(t_s):
            return self._drone_field_wind_at_report(report, t_s)
        accepted = self._members.latest_accepted_reports(t_s)
        others = [one for one in accepted if one.member != report.member]
        if others or self._forecast is None:
            return None
        return self._expected_report_by_forecast(self._forecast, report.height_m)

    def _drone_field_wind_at_report(self, report: MemberWindReport, t_s: float) -> SiteWindEstimate:
        field, height_m = self._current_drone_field(t_s), report.height_m
        return wind_estimate_at(field, report.position_ne_m, height_m, t_s, REPORT_AVERAGING_S)

    def _expected_report_by_forecast(self, forecast: Forecast, height_m: float) -> SiteWindEstimate:
        """Return the expected single report by the forecast: variance of forecast, shear, eddy."""
        shear_ratio, shear_error = self._process.wind_shear_ratio_and_error(
            np.array([height_m]), self._height_m
        )
        north, east = (float(x) for x in float(shear_ratio[0]) * np.array(forecast.to_ne_mps))
        speed_mps = float(np.hypot(north, east))
        process = self._process.process
        eddies = process.variance_scale(speed_mps) * sum(process.variance_m2ps2)
        variance = forecast.std_mps**2 + (float(shear_error[0]) * speed_mps) ** 2 + eddies
        return SiteWindEstimate((north, east), (variance, 0.0, variance))

    def _try_readmit_excluded_member(self, member: ReportingMember, t_s: float) -> None:
        """Readmit an excluded member whose wind has fitted the others for long enough."""
        if t_s - member.last_check_s < REPORT_AVERAGING_S:
            return
        latest_report, member.last_check_s = member.latest_report, t_s
        is_station = latest_report.member in self._members.stations
        expects = self._expected_wind_at_station if is_station else self._drone_field_wind_at_report
        expected = expects(latest_report, t_s)
        if (
            expected is not None
            and expected.chi_square_of_report(latest_report) > READMISSION_CHI_SQUARE
        ):
            member.agreeing_since_s = None
        elif member.agreeing_since_s is None:
            member.agreeing_since_s = t_s
        elif t_s - member.agreeing_since_s >= READMISSION_S:
            member.exclusion_reason = ""


def _prior_from_forecast(forecast: Forecast, height_m: float) -> WindPrior:
    return WindPrior(forecast.to_ne_mps, PRIOR_STD_FACTOR * forecast.std_mps, height_m)
