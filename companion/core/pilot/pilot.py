"""The pilot: events in, actions out. Composes the controllers of one flight (context.py).

It reads no clock and does no I/O. Phases and their order are data (transitions.py), and so is the
routing of events to parts (parts.py).
"""

from typing import Any, Final

from companion.core.certificate.certificate import Certificate
from companion.core.mission.actions import (
    Action,
    CancelOrders,
    LogNote,
    Order,
    SaveCheckpoint,
)
from companion.core.mission.alerts import Alert
from companion.core.mission.checkpoint import Checkpoint, checkpoint_to_dict
from companion.core.mission.events import (
    AutopilotDetected,
    AutopilotText,
    Event,
    FleetWindReceived,
    MissionProgress,
    OrderRefused,
    Tick,
)
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan
from companion.core.monitor.corrections import NO_CORRECTIONS, MonitorCorrections
from companion.core.pilot.authority import ControlAuthority, OrderedMode
from companion.core.pilot.context import (
    CurrentPlan,
    FlightContext,
    LatestAssessment,
    PilotOptions,
)
from companion.core.pilot.control.flight_reports import FlightReports
from companion.core.pilot.control.resume import FlightResumption
from companion.core.pilot.estimates import FlightEstimates
from companion.core.pilot.flight_sequence import FlightSequence
from companion.core.pilot.flight_state import (
    CurrentItem,
    FlightState,
    ParcelState,
    PromisedStop,
)
from companion.core.pilot.ground.autopilot_settings import (
    AutopilotSettings,
    RequirementsFunction,
)
from companion.core.pilot.ground.ground_sequence import GroundSequence
from companion.core.pilot.ground.start_checks import PreflightReport
from companion.core.pilot.landing import LandingController
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.neighbours.setpoint_takeover import SetpointController
from companion.core.pilot.parts import PilotParts
from companion.core.pilot.transitions import (
    COMMANDING_PHASES,
    END_PHASES,
    FLIGHT_PHASES,
    Phase,
)
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.separation.learned_policy import AvoidancePolicy
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.process import WindProcessParams

CHECKPOINT_INTERVAL_S = 5.0


class Pilot:
    """Flies one mission of one vehicle; `process_event` receives every event.

    `checkpoint`: of an earlier process of this flight, to continue from; a finished one is ignored.
    `estimates`: wind, energy and the gate; created from the airframe and the wind process when
    `None`. `policy`: the learned actor that flies near neighbours; `None`: straight to the item.
    `monitor_corrections`: findings of the vehicle's service monitor. `certificate`: bounds on the
    airframe's draw from recorded days.
    """

    def __init__(
        self,
        flight: Flight,
        airframe: Airframe,
        wind_process: WindProcessParams,
        *,
        obstacles: dict[str, Any] | None,
        requirements: RequirementsFunction,
        flight_digest: str,
        options: PilotOptions | None = None,
        checkpoint: Checkpoint | None = None,
        estimates: FlightEstimates | None = None,
        policy: AvoidancePolicy | None = None,
        monitor_corrections: MonitorCorrections = NO_CORRECTIONS,
        certificate: Certificate | None = None,
    ) -> None:
        route_energy = RouteEnergy.for_mission(airframe, flight.mission, REFERENCE_DENSITY_KGPM3)
        estimates = estimates or FlightEstimates(
            flight,
            airframe,
            route_energy,
            wind_process,
            monitor_corrections=monitor_corrections,
            certificate=certificate,
        )
        self.monitor_corrections = monitor_corrections
        self.certificate = certificate
        self._digest = flight_digest
        self._saved_s: float | None = None

        parts = PilotParts(obstacles=obstacles, requirements=requirements, policy=policy)
        self.parts = parts
        self.context: Final = FlightContext(
            flight,
            airframe,
            estimates,
            options or PilotOptions(),
            self,
            parts.part_of_class(CurrentPlan),
            parts.part_of_class(LatestAssessment),
        )
        self._flight_state = parts.part_of_class(FlightState)
        self._parcel_state = parts.part_of_class(ParcelState)
        self._promise = parts.part_of_class(PromisedStop)
        self._modes = parts.part_of_class(OrderedMode)
        self._authority = parts.part_of_class(ControlAuthority)
        self._ground = parts.part_of_class(GroundSequence)
        self.settings = parts.part_of_class(AutopilotSettings)
        self._item = parts.part_of_class(CurrentItem)
        self._progress = parts.part_of_class(MissionProgressMonitor)
        self._landing = parts.part_of_class(LandingController)
        self._setpoints = parts.part_of_class(SetpointController)
        self._sequence = parts.part_of_class(FlightSequence)
        self._resume = parts.part_of_class(FlightResumption)
        self._reports = parts.part_of_class(FlightReports)
        if checkpoint is not None and not checkpoint.finished:
            for keeper in parts.checkpoint_parts:
                keeper.restore(checkpoint)
            self._resume.restore(self.context, checkpoint)

    # --- events in, actions out ------------------------------------------------------------------

    def process_event(self, event: Event) -> list[Action]:
        """Process one event; return the actions. Orders are sent in commanding phases only."""
        context = self.context
        context.take_queued_actions()
        if isinstance(event, MissionProgress):
            event = self._setpoints.store_item_and_map_to_target(context, event)
        context.telemetry.store_event(event)
        self._dispatch_event(event)
        actions = [
            self._setpoints.map_jump_to_setpoint_item(context, action)
            for action in context.take_queued_actions()
        ]
        if context.phase not in COMMANDING_PHASES:
            actions = [action for action in actions if not isinstance(action, Order)]
        return actions

    def _dispatch_event(self, event: Event) -> None:
        match event:
            case Tick():
                self._update_estimates_and_controllers(is_backlog=event.is_backlog)
            case AutopilotDetected():
                self._start_or_resume_flight(event)
            case OrderRefused():
                self.context.queue_actions(LogNote(f"{event.order} refused: {event.reason}"))
            case FleetWindReceived():
                self.context.estimates.add_fleet_wind_reports(event.winds, event.t_s, event.age_s)
            case AutopilotText():
                self.context.queue_actions(LogNote(f"autopilot: {event.text}", in_check=True))
            case _:
                pass
        for part in self.parts.parts_receiving_event(event):
            part.on_event(self.context, event)

    def _start_or_resume_flight(self, event: AutopilotDetected) -> None:
        context = self.context
        context.queue_actions(
            LogNote(f"{event.autopilot_kind.value} autopilot, system {event.system_id}")
        )
        for text in self.monitor_corrections.findings:
            context.report_alert(Alert.MONITOR_DOUBT, finding=text)
        if self.certificate is not None:
            context.queue_actions(LogNote(f"certificate: {self.certificate.summary_text}"))
        self._modes.record_initial_ground_mode(context.telemetry.state)
        self._resume.start_or_resume_flight(context)

    def _update_estimates_and_controllers(self, *, is_backlog: bool) -> None:
        """Update estimates first, then the controllers in this order, then reports."""
        context = self.context
        telemetry = context.telemetry
        if telemetry.autopilot_kind is None:
            return
        context.queue_actions(
            *context.estimates.update_from_telemetry(telemetry, telemetry.autopilot_kind)
        )
        if is_backlog:
            return
        self._reports.report_fleet_wind_if_due(context)
        if context.phase is Phase.RECOGNISE:
            self._resume.tick(context)
        else:
            for part in self.parts.tick_parts:
                part.tick(context)
        self._reports.queue_due_reports(context)
        in_flight = context.phase in FLIGHT_PHASES or context.phase is Phase.SUSPENDED
        if in_flight and context.seconds_since(self._saved_s) >= CHECKPOINT_INTERVAL_S - 1e-6:
            self.queue_checkpoint(routine=True)

    def run_phase_entry_actions(self, previous_phase: Phase, reason: str) -> None:
        """Execute the entry actions of the new phase; called by the context at every transition."""
        context = self.context
        self._authority.record_phase_entry(context)
        match context.phase:
            case Phase.SUSPENDED:
                self._modes.clear_ordered_mode()
                self._progress.stop_monitoring_jump()
                context.queue_actions(CancelOrders())
                context.report_alert(Alert.CONTROL_RELEASED, reason=reason)
                context.record_decision("suspended", reason)
            case Phase.PASSIVE | Phase.FOREIGN_MISSION:
                context.queue_actions(CancelOrders())
                context.report_alert(Alert.PASSIVE, reason=reason)
                context.record_decision("passive", reason)
            case Phase.LINK_LOST:
                context.queue_actions(CancelOrders())
            case Phase.RECOGNISE:
                self._resume.request_state_for_resumption(context, reason)
            case Phase.DONE | Phase.GROUNDED:
                context.queue_actions(CancelOrders())
                self._landing.report_mission_outcome(context, reason)
            case _:
                self._ground.enter_ground_phase(context)
                self._sequence.enter_flight_phase(context, previous_phase)

    # --- checkpoints -----------------------------------------------------------------------------

    def queue_checkpoint(self, *, routine: bool = False) -> None:
        """Queue a checkpoint of the present state; none while only checking."""
        context = self.context
        if context.options.check_only:
            return
        self._saved_s = context.t_s
        context.queue_actions(SaveCheckpoint(checkpoint_to_dict(self.build_checkpoint()), routine))

    def build_checkpoint(self) -> Checkpoint:
        """Return the state for a restart: the context's part, and each controller's own."""
        context = self.context
        phase, flown = context.phase, context.flight_plan
        waiting = phase is Phase.LINK_LOST and context.interrupted_phase in FLIGHT_PHASES
        recognising = phase is Phase.RECOGNISE and self._flight_state.in_flight
        parts: dict[str, Any] = {}
        for keeper in self.parts.checkpoint_parts:
            parts |= keeper.to_dict()
        return Checkpoint(
            flight=self._digest,
            t_s=context.t_s,
            phase=phase.value,
            authority=phase in FLIGHT_PHASES or waiting or recognising,
            finished=phase in END_PHASES,
            plan=flown.plan if flown is not None else None,
            frame=flown.site.frame if flown is not None else None,
            asides=flown is not None and bool(flown.mission.setpoint_items),
            judgement=context.estimates.snapshot(),
            **parts,
        )

    # --- queries ---------------------------------------------------------------------------------

    @property
    def phase(self) -> Phase:
        """The phase of the mission."""
        return self.context.phase

    @property
    def control_since_ms(self) -> int | None:
        """Time since which this process has control of this flight, on the autopilot's clock."""
        return self._authority.control_since_ms

    @property
    def flight_plan(self) -> FlightPlan | None:
        """The current plan, `None` before one is made."""
        return self.context.flight_plan

    @property
    def is_delivered(self) -> bool:
        """Whether the parcel is delivered."""
        return self._parcel_state.delivered

    @property
    def current_home_stop_name(self) -> str | None:
        """The stop at which the flight ends without the companion; `None`: no stops."""
        return self._promise.current_home_stop_name(self.context)

    @property
    def is_on_setpoints(self) -> bool:
        """Whether set-points are flown near neighbours, or requested."""
        return self._setpoints.is_requesting_setpoints

    def preflight_report(self) -> PreflightReport:
        """Return the present pre-flight report."""
        return self._ground.preflight_report(self.context)
