"""Periodic reports of a flight: wind, energy, the gate's assessment, and news of the fleet wind."""

from dataclasses import replace

from companion.core.mission.actions import (
    AlertReport,
    AssessmentReport,
    EnergyReport,
    PublishValues,
    WindReport,
)
from companion.core.mission.alerts import Alert
from companion.core.mission.events import CONTROL_CLAIM
from companion.core.pilot.authority import ControlAuthority
from companion.core.pilot.context import FlightContext, LatestAssessment, margin_above_reserve_wh
from companion.core.pilot.control.return_alarm import ReturnAlarm
from companion.core.pilot.flight_state import PromisedStop
from companion.core.pilot.home_watch import HomeMonitor
from companion.core.pilot.return_decision import BudgetMonitor
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase
from companion.core.return_budget.budget import Assessment
from companion.core.return_budget.outcomes import SiteMargin

REPORT_INTERVAL_S = 1.0
WIND_REPORT_INTERVAL_S = 0.5


class FlightReports:
    """Queues each periodic report when it is due; all are due at the first tick of this process."""

    def __init__(
        self,
        authority: ControlAuthority,
        budget: BudgetMonitor,
        latest: LatestAssessment,
        home: HomeMonitor,
        promise: PromisedStop,
    ) -> None:
        self._authority = authority
        self.return_alarm = ReturnAlarm(budget, latest, home, promise)
        self._values_s: float | None = None
        self._wind_s: float | None = None
        self._fleet_wind_s: float | None = None

    def report_fleet_wind_if_due(self, context: FlightContext) -> None:
        """Report changes of the fleet wind, once a second in the air."""
        reported_s = self._fleet_wind_s
        if context.phase not in FLIGHT_PHASES or (
            reported_s is not None and 0.0 <= context.t_s - reported_s < REPORT_INTERVAL_S - 1e-6
        ):
            return
        self._fleet_wind_s = context.t_s
        for text in context.estimates.new_fleet_wind_change_texts(context.t_s):
            report = AlertReport.create(Alert.FLEET_WIND, news=text)
            context.record_decision("fleet_wind", report.text)
            context.queue_actions(report)

    def queue_due_reports(self, context: FlightContext) -> None:
        """Report wind, energy, assessment and alarms of the return at their intervals."""
        self.return_alarm.tick(context)
        wind, t_s = context.estimates.wind, context.t_s
        wind_due = context.seconds_since(self._wind_s) >= WIND_REPORT_INTERVAL_S - 1e-6
        if wind is not None and wind.valid and wind_due:
            self._wind_s = t_s
            north, east = (float(x) for x in wind.mean_to_ne_mps)
            cov = wind.cov_ne_m2ps2
            spread = float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])
            context.queue_actions(WindReport(t_s, north, east, *spread))
        if context.seconds_since(self._values_s) >= REPORT_INTERVAL_S - 1e-6:
            self._values_s = t_s
            self._queue_energy_and_gate_report(context)

    def _queue_energy_and_gate_report(self, context: FlightContext) -> None:
        wind, energy = context.estimates.wind, context.estimates.energy
        seen, values = context.recent_assessment(), dict[str, float]()
        if seen and energy and context.phase is Phase.LAND and context.telemetry.on_ground:
            # Landed: the same margin as in the outcome.
            seen = replace(seen, margin_wh=margin_above_reserve_wh(context, energy))
        claim_s = self._authority.published_control_start_s(context.phase)
        if claim_s is not None:
            values[CONTROL_CLAIM] = claim_s
        if wind is not None and wind.valid:
            values["LW_WINDN"], values["LW_WINDE"] = (float(x) for x in wind.mean_to_ne_mps)
        if energy is not None:
            values["LW_ENERGY"] = energy.mean_wh
            report = energy.mean_wh, energy.std_wh, energy.source, energy.used_wh
            context.queue_actions(EnergyReport(context.t_s, *report))
        if seen is not None:
            values |= {
                "LW_MARGIN": seen.margin_wh,
                "LW_PHOME": seen.p_home,
                "LW_PSTATED": seen.p_home_stated,
                "LW_PHNOW": seen.p_home_now,
                "LW_PSUCC": seen.p_success,
            }
            if (home := _home_site(context, seen)) is not None:
                values["LW_MHOME"] = home.margin_now_wh
            context.queue_actions(_assessment_report(seen))
        if self.return_alarm.last_moment_in_s is not None:
            values["LW_TLEFT"] = self.return_alarm.last_moment_in_s
        context.queue_actions(PublishValues(values))


def _home_site(context: FlightContext, assessment: Assessment) -> SiteMargin | None:
    """Return depot or promised stop, where the return route ends, if a route leads there."""
    flown = context.flight_plan
    return flown and assessment.site_by_name(flown.plan.return_route_end_name)


def _assessment_report(assessment: Assessment) -> AssessmentReport:
    return AssessmentReport(
        assessment.t_s,
        assessment.p_home,
        assessment.p_home_stated,
        assessment.p_home_now,
        assessment.p_success,
        assessment.margin_wh,
        assessment.energy_left_wh,
        assessment.energy_need_wh,
        assessment.p_home_unattended,
        assessment.required_p_home,
        assessment.p_home_next,
        assessment.p_home_onward,
        assessment.p_success_onward,
        assessment.sites,
    )
