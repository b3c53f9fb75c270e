"""The release of the parcel: monitor the hover, look for evidence, retry once, return.

Safety rule 5: the parcel counts as released by the fall of the hover power and by the gripper's
reports, weighed together (release_watch.py).
"""

import math
from dataclasses import dataclass

from companion.core.mission.actions import LogNote, ReleaseParcel
from companion.core.mission.alerts import Alert
from companion.core.mission.event_text import DELIVERED
from companion.core.mission.events import Event, OrderAccepted, ReleaseFeedback
from companion.core.mission.jump_watch import JumpType
from companion.core.pilot.context import FlightContext, LatestAssessment
from companion.core.pilot.estimators.release_watch import (
    ReleaseMonitor,
    add_hover_samples_from_telemetry,
    build_release_monitor,
)
from companion.core.pilot.flight_state import ParcelState
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.observed_state import HEIGHT_DOUBT_M
from companion.core.pilot.return_decision import BudgetMonitor
from companion.core.pilot.transitions import Phase, Trigger

RELEASE_RETRY_S = 3.6


@dataclass(slots=True, eq=False)
class ParcelReleaseController:
    """Looks for evidence of the release over the customer."""

    _state: ParcelState
    _jumps: MissionProgressMonitor
    _budget: BudgetMonitor
    _assessment: LatestAssessment

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process the gripper's feedback, or the acknowledgement of its command."""
        is_report = isinstance(event, ReleaseFeedback) or (
            isinstance(event, OrderAccepted) and event.order == "release"
        )
        if is_report and self._state.release_monitor is not None:
            self._state.release_monitor.gripper_reports += 1

    def record_hover_samples(self, context: FlightContext) -> None:
        """Pass the hover over the customer to the watch."""
        over_customer = context.phase in (Phase.DELIVER, Phase.RELEASE)
        if over_customer and context.flight.vehicle.payload_kg > 0.0:
            add_hover_samples_from_telemetry(
                self._get_or_create_release_monitor(context), context.telemetry
            )

    def record_release_order(self, context: FlightContext) -> None:
        """The onboard mission releases the parcel now."""
        self._state.release_commanded = True
        self._get_or_create_release_monitor(context).record_release_order(context.t_s)

    def tick(self, context: FlightContext) -> None:
        """Look for evidence of the release; retry once; then return."""
        state = self._state
        if (
            context.flight_plan is None
            or self._jumps.pending_jump_item_index is not None
            or state.delivered
        ):
            return
        if context.flight.vehicle.payload_kg <= 0.0:
            self._record_delivery_and_jump_home(context, "no parcel to weigh")
            return
        evidence = self._get_or_create_release_monitor(context).release_evidence_text(context.t_s)
        if evidence is not None:
            self._record_delivery_and_jump_home(context, evidence)
            return
        if not state.release_repeated and context.time_in_phase_s > RELEASE_RETRY_S:
            state.release_repeated = True
            if not context.telemetry.command_faults():
                context.queue_actions(ReleaseParcel())
                context.queue_actions(LogNote("release not confirmed yet: commanded again"))

    def report_unconfirmed_release(self, context: FlightContext) -> None:
        """Leave without evidence: the parcel counts as still carried (safety rule 5)."""
        if not self._state.delivered:
            text = "release not confirmed: returning loaded"
            context.record_decision("release_unconfirmed", text)
            context.report_alert(Alert.RELEASE_UNCONFIRMED)

    def _get_or_create_release_monitor(self, context: FlightContext) -> ReleaseMonitor:
        if self._state.release_monitor is None:
            payload_kg = context.flight.vehicle.payload_kg
            wind = context.estimates.wind
            wind_mps = math.hypot(*wind.mean_to_ne_mps) if wind and wind.valid else 0.0
            self._state.release_monitor = build_release_monitor(
                context.estimates.route_energy, payload_kg, wind_mps
            )
        return self._state.release_monitor

    def _record_delivery_and_jump_home(self, context: FlightContext, evidence: str) -> None:
        plan = context.flight_plan
        assert plan is not None
        self._state.delivered = True
        context.estimates.payload_kg = 0.0
        self._assessment.discard()
        self._budget.assess_remaining_if_older(context, 0.0)
        context.record_decision(DELIVERED, evidence)
        difference_m = abs(context.telemetry.observed.height_difference_m)
        if difference_m > HEIGHT_DOUBT_M:
            context.report_alert(Alert.RELEASED_IN_DOUBT, difference_m=difference_m)
        else:
            context.report_alert(Alert.DELIVERED, evidence=evidence)
        context.request_checkpoint()
        if not context.telemetry.command_faults():
            self._jumps.order_jump(context, plan.mission.returning[0], JumpType.HOME)
            context.apply_phase_trigger(Trigger.DROP_OVER, "delivered")
