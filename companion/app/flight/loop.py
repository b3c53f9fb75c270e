"""The flight loop: bytes to events, the pilot, actions to bytes; one thread, the autopilot's clock.

If the autopilot sends TIMESYNC requests (the simulator's lockstep, and real PX4), each request is
a tick: earlier messages are processed, outputs are sent, and the response is sent last. Without
them, received telemetry triggers about ten ticks a second.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from companion.adapters.autopilots.codec import (
    AUTOPILOT,
    COMPONENT,
    MavlinkCodec,
    timesync_response_message,
)
from companion.adapters.autopilots.link import Link
from companion.adapters.autopilots.operator_port import OperatorPort, OperatorTrust
from companion.adapters.autopilots.port import AutopilotPort
from companion.adapters.autopilots.telemetry import vehicle_kind
from companion.adapters.clock import AutopilotClock, TickTimer, wall_s
from companion.app.flight.monitor_keeper import MonitorKeeper
from companion.app.flight.planning import PlanningExecutor
from companion.app.flight.receive_backlog import ReceiveBacklog
from companion.app.flight.recorder import Recorder
from companion.app.flight.send_queue import SendQueue
from companion.app.flight.settings_keeper import SettingsKeeper
from companion.app.flight.signing_monitor import SigningMonitor
from companion.app.flight.status_sender import StatusSender
from companion.core.mission.actions import (
    Action,
    AlertReport,
    CancelOrders,
    Finished,
    OperatorResponse,
    Order,
    PhaseChanged,
    PublishValues,
    ResponseStatus,
    SaveCheckpoint,
    WindReport,
)
from companion.core.mission.alerts import Alert, AlertParameter
from companion.core.mission.events import (
    BoardIdReceived,
    Event,
    LinkRecovered,
    LinkSilent,
    OperatorMessageReceived,
    Tick,
    UnrestoredSettings,
)
from companion.core.mission.find_plan import FindPlan, PlanFound
from companion.core.pilot.pilot import Pilot
from companion.fleet.service_manager import Watchdog

if TYPE_CHECKING:
    from companion.app.flight.fleet_port import FleetPort  # zenoh's: loaded for a fleet only

WAIT_S = 0.1


class Loop:
    """Connects link, codec, autopilot, pilot and recorder; `step` runs one receive cycle.

    Each event is processed, and its actions executed, before the next one. `finished` is set once
    and ends the processing of events. A lost record and a flooded port are reported once.
    """

    def __init__(
        self,
        link: Link,
        codec: MavlinkCodec,
        recorder: Recorder,
        pilot: Pilot,
        *,
        system_id: int | None,
        silence_limit_s: float,
        wall_clock_s: Callable[[], float] = wall_s,
        settings_folder: Path | None = None,
        trust: OperatorTrust | None = None,
        signing: SigningMonitor | None = None,
        plan_synchronously: bool = False,
        monitor: MonitorKeeper | None = None,
        port: "FleetPort | None" = None,
    ) -> None:
        """`wall_clock_s` measures stalls and link silence. `port`: None without a desk."""
        self.link = link
        self.pilot = pilot
        self.silence_limit_exceeded = False
        self.finished: Finished | None = None
        self.clock = AutopilotClock()
        self.clock.set_minimum_start_time(pilot.context.telemetry.t_s)
        self.backlog = ReceiveBacklog(link, wall_clock_s)
        self.send_queue = SendQueue(link, codec, recorder.buffer_frame, self.backlog, self.clock)
        queue_message = self.send_queue.queue_message
        self.autopilot = AutopilotPort(
            self.send_queue.queue_order_unless_backlog,
            self.clock,
            system_id,
            self.send_queue.discard_orders,
        )
        self._codec = codec
        self._recorder = recorder
        self._silence_limit_s = silence_limit_s
        self._wall_clock_s = wall_clock_s
        self._status = StatusSender(queue_message, self.clock, wall_clock_s, pilot, self.autopilot)
        self._operator = OperatorPort(
            queue_message,
            self.submit_event,
            lambda: pilot.context.estimates.limits,
            self.report_alert,
            trust,
        )
        self._settings = SettingsKeeper(
            settings_folder,
            self.autopilot,
            recorder.submit_settings_write,
            lambda error_text: recorder.submit_text_log_line(self.clock.t_s, error_text),
        )
        self._signing = signing
        self._planning = PlanningExecutor(synchronous=plan_synchronously)
        self._monitor = monitor
        self._port = port
        self._ticks = TickTimer(self.clock)
        self._reported_alerts: set[Alert] = set()
        self._response = OperatorResponse(ResponseStatus.DENIED)
        self._watchdog = Watchdog()

    # --- in ------------------------------------------------------------------------------------

    def step(self) -> None:
        """Receive one datagram or time out, then process it."""
        self._watchdog.notify_systemd_if_due(self._wall_clock_s())
        if self.backlog.is_link_lost or self.autopilot.system_id is None:
            self._status.queue_heartbeat_if_due_unconnected()
        incoming = self.link.receive(WAIT_S)
        if incoming is not None:
            self.backlog.record_received_datagram()
        self.backlog.register_cycle()
        if self.autopilot.system_id is not None and self.backlog.detect_link_loss():
            self._pass_events_to_pilot([LinkSilent(self.clock.t_s)])
        if self.backlog.link_silence_s > self._silence_limit_s:
            self.silence_limit_exceeded = True
        if self._signing is not None:
            self.execute_actions([*self._signing.update(self._wall_clock_s())])
        if self.link.rejected_packets:  # foreign senders flood the port; the vehicle's link works
            self._report_alert_once(Alert.STRANGERS_FLOOD)
        if incoming is not None:
            for message in self._codec.parse_valid_messages(incoming.data):
                self._on_message(message, incoming.peer)
                if self.finished is not None:
                    break
        if self._port is not None:
            self._exchange_with_desk(self._port)
        self.send_queue.send_queued_frames()
        self._recorder.submit_buffered_frames()

    def _exchange_with_desk(self, port: "FleetPort") -> None:
        if self.finished is None:
            port.process_mission_commands(self.pilot, self.clock.t_s, self.submit_event)
            if port.member.link.do_all_clients_read_wind_cov():  # a desk requested states recently
                self._pass_events_to_pilot([OperatorMessageReceived(self.clock.t_s)])
        port.publish_state_if_due(self.pilot.phase.value, self.pilot.context.telemetry, self.pilot)

    def _on_message(self, message: Any, peer: Any) -> None:
        system, frame = self.autopilot.system_id, bytes(message.get_msgbuf())
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source[1] == COMPONENT and self.send_queue.is_echo(frame):
            return
        if system is None or source[0] == system:
            self._recorder.buffer_frame(frame, self.clock.t_s)
        if system is not None and self._process_operator_message(message, system, peer):
            self._recorder.buffer_frame(frame, self.clock.t_s)
            return
        from_autopilot = source == (system, AUTOPILOT)
        if self.autopilot.is_intruding_heartbeat(message):
            sender = vehicle_kind(message.type) or "generic"
            self._report_alert_once(Alert.HEARTBEAT_INTRUDER, sender=sender)
            return
        if from_autopilot:
            self._record_autopilot_contact(peer)
            if message.get_type() == "HEARTBEAT" and self.backlog.record_heartbeat_ends_delay():
                self.report_alert(Alert.PROCESS_STALLED, duration_s=self.backlog.stall_duration_s)
        if message.get_type() == "TIMESYNC":
            if message.tc1 != 0:
                self.autopilot.update_clock_from_timesync_response(message)
                if self._ticks.is_tick_due_by_telemetry():
                    self._record_telemetry_and_run_decision_tick()
            elif from_autopilot or (system is None and source[1] == AUTOPILOT):
                self.link.set_reply_peer(peer)
                if from_autopilot and self._ticks.register_request_and_is_tick_due(message.ts1):
                    self._record_telemetry_and_run_decision_tick()
                response = timesync_response_message(self.clock.t_s, message.ts1)
                self.send_queue.queue_message(response)  # after all other outputs
            return
        if system is None and self.autopilot.is_candidate_vehicle(message):
            self.link.set_reply_peer(peer)  # without a peer a listening link cannot send requests
        events = self.autopilot.on_message(message)
        if systems := self.autopilot.ambiguous_systems:
            text = ", ".join(map(str, systems))
            self._report_alert_once(Alert.VEHICLES_AMBIGUOUS, systems=text)
        if system is None and self.autopilot.system_id is not None:
            self._operator.trust.record_first_autopilot_peer(peer)
            self._codec.set_source_system_id(self.autopilot.system_id)
            self._record_autopilot_contact(peer)
        self._pass_events_to_pilot(events)
        if self._ticks.is_tick_due_by_telemetry():
            self._record_telemetry_and_run_decision_tick()

    def _record_autopilot_contact(self, peer: Any) -> None:
        self.link.set_reply_peer(peer)
        if self.backlog.record_autopilot_contact():
            self._recorder.submit_text_log_line(self.clock.t_s, "autopilot link restored")
            # The gap is known after the clock synchronises; a short silence shows none.
            self._pass_events_to_pilot([LinkRecovered(self.clock.t_s, 0.0)])

    def _process_operator_message(self, message: Any, system: int, peer: Any) -> bool:
        """Process a ground station's message; return True if it was for the companion only."""
        operator, is_signed = self._operator, self._codec.is_signing
        if operator.is_trusted_ground_station_heartbeat(message, system, peer, signed=is_signed):
            self._pass_events_to_pilot([OperatorMessageReceived(self.clock.t_s)])
        return operator.process_if_addressed_to_companion(
            message, system, self.clock.t_s, peer, signed=is_signed
        )

    def _record_telemetry_and_run_decision_tick(self) -> None:
        t_s, pilot, recorder = self.clock.t_s, self.pilot, self._recorder
        telemetry = pilot.context.telemetry
        recorder.record_new_telemetry(telemetry, self.autopilot.system_id)
        recorder.record_plan_if_new(t_s, pilot.flight_plan, telemetry.autopilot_kind)
        record_error_text = recorder.take_next_error_text()
        if record_error_text is not None:  # the flight continues
            self._report_alert_once(Alert.RECORD_LOST, reason=record_error_text)
        if not self.backlog.update_backlog_and_permits_decision():
            self._pass_events_to_pilot([Tick(t_s, is_backlog=True)])
        else:
            self._status.queue_next_named_value()
            self._pass_events_to_pilot(self.autopilot.tick(t_s))
            if self._port is not None:
                self._pass_events_to_pilot(self._port.take_received_tracks(t_s))
                self._pass_events_to_pilot(self._port.take_received_winds(t_s))
            self._pass_events_to_pilot([Tick(t_s)])
        self._status.queue_heartbeat_if_due_at_tick()

    def _pass_events_to_pilot(self, events: list[Event]) -> None:
        for event in events:
            if self.finished is None:
                self.execute_actions(self.pilot.process_event(event))
                if isinstance(event, BoardIdReceived):
                    left = self._settings.read_unrestored_settings(event.board_id)
                    if left:
                        self._pass_events_to_pilot([UnrestoredSettings(event.t_s, left)])
        found = self._planning.take_next_result()
        if found is not None and self.finished is None:
            self.execute_actions(self.pilot.process_event(PlanFound(self.clock.t_s, *found)))

    def submit_event(self, event: Event) -> OperatorResponse:
        """Pass an operator's command to the pilot and return the reply."""
        self._response = OperatorResponse(ResponseStatus.ACCEPTED)
        self._pass_events_to_pilot([event])
        return self._response

    # --- out -----------------------------------------------------------------------------------

    def report_alert(self, alert: Alert, **parameters: AlertParameter) -> None:
        """Report an alert to the operator, the log and the desk."""
        self.execute_actions([AlertReport.create(alert, **parameters)])

    def _report_alert_once(self, alert: Alert, **parameters: AlertParameter) -> None:
        if alert not in self._reported_alerts:
            self._reported_alerts.add(alert)
            self.report_alert(alert, **parameters)

    def execute_actions(self, actions: list[Action]) -> None:
        """Execute the actions of the pilot."""
        t_s = self.clock.t_s
        for action in actions:
            if isinstance(action, Finished):
                action = self._record_flight_in_monitor(action)
            self._recorder.record_action(action, t_s)
            if self._port is not None:
                self._port.report_action_to_desk(action)
            match action:
                case Order():
                    self.autopilot.execute(action, t_s)
                case CancelOrders():
                    self.autopilot.discard_all_pending_requests()
                    self.send_queue.discard_orders()
                case AlertReport():
                    self._status.queue_text(action)
                case PublishValues() | WindReport():
                    self._status.add_report(action)
                case OperatorResponse():
                    self._response = action
                case PhaseChanged():
                    self._status.queue_heartbeat()
                case SaveCheckpoint():
                    self._settings.store_original_values_if_changed(
                        self.pilot.settings.original_values_to_restore
                    )
                case FindPlan():
                    self._planning.start_planning(action)
                case Finished():
                    self.finished = action

    def _record_flight_in_monitor(self, finished: Finished) -> Finished:
        """Count the flight in the service monitor and alert the operator to new findings."""
        monitor, recorder = self._monitor, self._recorder
        if monitor is None:
            return finished
        finished, new_findings = monitor.record_flight_and_get_new_findings(
            finished, recorder.submit_monitor_write
        )
        recorder.submit_text_log_line(self.clock.t_s, monitor.format_log_line(finished))
        for finding in new_findings:
            self.report_alert(Alert.MONITOR_DOUBT, finding=finding)
        if self._port is not None:
            self._port.monitor_text = "; ".join(monitor.corrections.prefixed_findings)
        return finished
