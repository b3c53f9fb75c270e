"""Run one companion, from its options to its exit code."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.autopilots.link import Link, open_link
from companion.adapters.autopilots.operator_port import OperatorTrust
from companion.adapters.clock import unix_clock_from, wall_s
from companion.adapters.files.folder_lock import FolderLock
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions
from companion.app.flight.loop import Loop
from companion.app.flight.recorder import Recorder
from companion.app.flight.signing_monitor import SigningMonitor
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import Action, AlertReport
from companion.core.mission.alerts import Alert, AlertSink
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.telemetry_state import STATE_MAX_AGE_S
from companion.core.pilot.transitions import GROUND_PHASES, RELEASED_PHASES, Phase
from companion.fleet.service_manager import record_stop_signals

if TYPE_CHECKING:
    from companion.app.flight.fleet_port import FleetPort  # zenoh's: loaded for a fleet only

DONE, INTERNAL_ERROR, USAGE, GROUNDED, NO_LINK, INTERRUPTED, LINK_CLOSED = 0, 1, 2, 3, 4, 5, 6
"""Exit codes: mission ended; internal error; invalid input; no take-off possible (for `check`: a
requirement is not met); no autopilot, or link lost permanently; stopped by a signal; link could not
be opened (temporary)."""


def fly_mission(
    options: RunOptions,
    *,
    on_action: Callable[[Action], None] | None = None,
    port: "FleetPort | None" = None,
) -> tuple[int, Pilot]:
    """Fly (or check) until the mission, a signal or an error ends it; return the exit code.

    `port`: connection to a dispatcher's desk, which has the command rights of an operator.

    Raises LeewayError for invalid input, before the link is opened.
    """
    loaded = LoadedFlight.read_and_validate(options)
    flown = Run.begin(loaded, open_link, on_action=on_action, port=port)
    return run_until_exit_and_return_code(flown), flown.pilot


UNANSWERED_LIMIT_S = 30.0
"""Duration of waiting for requested telemetry until it is reported; a slow link takes seconds."""

UNCHECKABLE_PHASES = (Phase.RECOGNISE, *RELEASED_PHASES)
"""Phases that a check cannot leave: the vehicle flies, or another controller commands it."""


@dataclass(slots=True)
class Run:
    """One flight: call `run_cycle_and_get_exit_code` until it returns an exit code, then
    `write_result_and_close` with it.

    `check_only`: end also in phases in which no check is possible.
    """

    loop: Loop
    recorder: Recorder
    pilot: Pilot
    lock: FolderLock
    check_only: bool = False
    wall_clock_s: Callable[[], float] = wall_s
    unanswered_since_s: float | None = None

    @classmethod
    def begin(
        cls,
        loaded: LoadedFlight,
        open_link: Callable[[str], Link],
        *,
        on_action: Callable[[Action], None] | None = None,
        port: "FleetPort | None" = None,
        wall_clock_s: Callable[[], float] = wall_s,
    ) -> "Run":
        """Resume from the checkpoint, if any; open link and record.

        Raises LeewayError if another companion uses the folder, or the link cannot be opened.
        """
        options, settings = loaded.options, loaded.settings
        kept, checkpoint_error = loaded.read_checkpoint_or_error()
        monitor = loaded.read_service_monitor()
        pilot = (
            loaded.build_pilot(kept)
            if monitor is None
            else loaded.build_pilot(kept, monitor.corrections)
        )
        lock = FolderLock.acquire(options.run_dir)
        try:
            link = open_link(options.link)
        except LeewayError:
            lock.release()
            raise
        is_resumed = kept is not None and not kept.finished
        recorder = Recorder(
            options.run_dir,
            is_resumed=is_resumed,
            keep_checkpoints=not options.pilot.check_only,
            synchronous=options.record_synchronously,
            on_action=on_action,
            unix_clock_us=port.member.epoch_us if port else unix_clock_from(wall_clock_s),
        )
        codec, stamps = settings.build_codec(datagrams=link.datagrams)
        if options.system_id is not None:
            codec.set_source_system_id(options.system_id)
        signing = None
        if stamps is not None:
            signing = SigningMonitor(codec, recorder.submit_latest_write, stamps)
        recorded_monitor = None if options.pilot.check_only else monitor
        loop = Loop(
            link,
            codec,
            recorder,
            pilot,
            system_id=options.system_id,
            silence_limit_s=options.silence_limit_s,
            wall_clock_s=wall_clock_s,
            settings_folder=options.settings_folder,
            trust=OperatorTrust(frozenset(options.operators)),
            signing=signing,
            plan_synchronously=options.plan_synchronously,
            monitor=recorded_monitor,
            port=port,
        )
        if port is not None:
            port.member.link.set_request_callback(link.interrupt_receive)
            port.member.link.subscribe_fleets(loaded.flight.neighbours)
            port.monitor_text = "; ".join(pilot.monitor_corrections.prefixed_findings)
        for text in (
            loaded.summary_text,
            stamps.error_text if stamps is not None else "",
            checkpoint_error,
            monitor.error_text if monitor is not None else "",
            "" if options.pilot.gate_enabled else "GATE OFF: never turns back; for comparison only",
            f"resumed from checkpoint in phase {kept.phase}"
            if kept is not None and is_resumed
            else "",
        ):
            if text:
                recorder.submit_text_log_line(pilot.context.telemetry.t_s, text)
        if recorded_monitor is not None:
            recorded_monitor.replace_damaged_record(recorder.submit_monitor_write)
        return cls(loop, recorder, pilot, lock, options.pilot.check_only, wall_clock_s)

    def run_cycle_and_get_exit_code(self) -> int | None:
        """Run one loop step; return the exit code once the mission ends or the link is lost."""
        self.loop.step()
        if self.loop.finished is not None:
            return DONE if self.pilot.phase is Phase.DONE else GROUNDED
        if self.loop.silence_limit_exceeded:
            self.recorder.submit_text_log_line(
                self.loop.clock.t_s, "no autopilot message: link closed"
            )
            return NO_LINK
        if self.check_only and self.pilot.phase in UNCHECKABLE_PHASES:
            return GROUNDED
        return self._end_check_if_unanswered()

    def _end_check_if_unanswered(self) -> int | None:
        """Report an autopilot that grants no request of the companion; a check ends then."""
        now_s = self.wall_clock_s()
        if self.pilot.phase is not Phase.CONFIGURE or self.unanswered_since_s is None:
            self.unanswered_since_s = now_s
        if now_s - self.unanswered_since_s < UNANSWERED_LIMIT_S:
            return None
        self.unanswered_since_s = now_s
        messages = "what is requested; if it requires signed commands: --signing-key FILE"
        self.loop.report_alert(Alert.TELEMETRY_MISSING, messages=messages)
        return GROUNDED if self.check_only else None

    def write_result_and_close(self, exit_code: int) -> None:
        """Send pending messages, write the result, close all files and the link."""
        loop, recorder, pilot = self.loop, self.recorder, self.pilot
        loop.send_queue.send_queued_frames()
        recorder.submit_text_log_line(
            loop.clock.t_s, f"exit {exit_code} in phase {pilot.phase.value}"
        )
        recorder.write_result_and_wait(
            delivered=pilot.is_delivered,
            flown=pilot.flight_plan,
            phase=pilot.phase.value,
            findings=pilot.settings.unmet_setting_issues,
            settings=pilot.settings.setting_changes,
        )
        loop.link.close()
        recorder.close()
        self.lock.release()


def run_until_exit_and_return_code(flown: Run) -> int:
    """Run the loop until the flight ends, a signal arrives or an error occurs; return the code."""
    loop, recorder = flown.loop, flown.recorder
    with record_stop_signals() as received_signals:
        try:
            code = _step_until_exit_code(flown, received_signals)
        except Exception as error:  # noqa: BLE001 - the one broad except: nothing is commanded after it
            # Send no command: the autopilot holds a mission that ends at home.
            recorder.record_exception(loop.clock.t_s, error)
            reports = [AlertReport.create(Alert.COMPANION_FAILED)]
            if flown.pilot.settings.original_values_to_restore:
                reason = "companion failed"
                reports.append(AlertReport.create(Alert.SETTINGS_NOT_RESTORED, reason=reason))
            for report in reports:
                message = mavlink.MAVLink_statustext_message(report.severity, report.text.encode())
                loop.send_queue.queue_message(message)
            code = INTERNAL_ERROR
    flown.write_result_and_close(code)
    return code


def _step_until_exit_code(flown: Run, received_signals: list[int]) -> int:
    while (code := flown.run_cycle_and_get_exit_code()) is None:
        if received_signals:
            text = f"signal {received_signals[0]}: exiting; mission stays uploaded"
            flown.recorder.submit_text_log_line(flown.loop.clock.t_s, text)
            report_vehicle_state_at_stop(flown.pilot, flown.loop.report_alert)
            return INTERRUPTED
    return code


def report_vehicle_state_at_stop(pilot: Pilot, report_alert: AlertSink) -> None:
    """Report what the vehicle does without the companion; nothing about a vehicle never seen."""
    context, telemetry = pilot.context, pilot.context.telemetry
    state = telemetry.state
    not_started = pilot.phase in GROUND_PHASES and not telemetry.armed
    is_on_ground = not_started or not context.in_air_evidence_text()
    if state is not None and is_on_ground and telemetry.is_recent(state, STATE_MAX_AGE_S):
        armed_state = "STILL ARMED" if telemetry.armed else "disarmed"
        report_alert(Alert.COMPANION_STOPPED_ON_GROUND, armed_state=armed_state)
    elif state is not None and not not_started:
        report_alert(Alert.COMPANION_STOPPED, mode=state.mode_name)
    if pilot.settings.original_values_to_restore:
        report_alert(Alert.SETTINGS_NOT_RESTORED, reason="companion stopped")
