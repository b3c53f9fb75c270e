"""Writes a run's folder: text log, decision log, MAVLink stream, checkpoint and result.

Disk delays and errors do not affect the flight: see `companion.adapters.files.disk`.
"""

import traceback
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from companion.adapters.clock import unix_time_us
from companion.adapters.files.atomic_file import write_text_atomically
from companion.adapters.files.checkpoint_file import CHECKPOINT_NAME as CHECKPOINT
from companion.adapters.files.checkpoint_file import checkpoint_write_job
from companion.adapters.files.disk import ImmediateRecordWriter, RecordWriter, ThreadedRecordWriter
from companion.adapters.logs.decision_log import AUTOPILOT_TOPIC, TelemetryRows
from companion.adapters.logs.text_log import format_log_entry
from companion.app.flight.run_files import (
    DECISIONS,
    LIST_BY_TOPIC,
    RESULT,
    STREAM,
    TEXT,
    RunFiles,
)
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import MissionExport, build_mission_export
from companion.core.exports.formats import mission_document_text
from companion.core.exports.geojson import mission_geojson
from companion.core.mission.actions import (
    Action,
    AlertReport,
    AssessmentReport,
    Decision,
    EnergyReport,
    Finished,
    LogNote,
    PhaseChanged,
    SaveCheckpoint,
    WindReport,
)
from companion.core.mission.events import AutopilotKind
from companion.core.mission.flight_plan import FlightPlan, plan_to_record_dict
from companion.core.mission.preflight_checks import PreflightIssue
from companion.core.pilot.ground.autopilot_settings import SettingChange
from companion.core.pilot.telemetry_state import TelemetryState

MISSION = "mission.plan"
SETTINGS_RECORD = "settings of the vehicle"
MONITOR_RECORD = "record of the monitor"
SCREEN_RECORD = "screen"
FORMAT = "companion-result/2"
TOPIC_BY_ACTION: dict[type[Action], str] = {
    Decision: "decision",
    AssessmentReport: "assessment",
    WindReport: "wind",
    EnergyReport: "energy",
    PhaseChanged: "phase",
}
"""Actions of which each is a row of the decision log and of the result."""

WIND_KEYS = {"n_mps": "to_n_mps", "e_mps": "to_e_mps"}


class Recorder:
    """Submits the records of a flight to the disk, in call order, from the flight's thread.

    `write_result_and_wait` can be called more than once; nothing is recorded after `close`.
    """

    def __init__(
        self,
        run_dir: Path,
        *,
        is_resumed: bool = False,
        keep_checkpoints: bool = True,
        synchronous: bool = False,
        on_action: Callable[[Action], None] | None = None,
        unix_clock_us: Callable[[], int] = unix_time_us,
    ) -> None:
        """`synchronous`: for simulation. `on_action` displays an action off the flight thread.
        `unix_clock_us`: clock that joins the record with the desk's events.
        """
        self._on_action, self._unix_clock_us = on_action, unix_clock_us
        self.run_dir = run_dir
        self._checkpoints_enabled = keep_checkpoints
        self._lists = defaultdict[str, list[dict[str, Any]]](list)
        self._telemetry_rows = TelemetryRows()
        self._autopilot_kind: AutopilotKind | None = None
        self._plan: FlightPlan | None = None
        self._finished: Finished | None = None
        self._frames: list[tuple[bytes, float]] = []
        self._synchronous = synchronous
        files = self._files = RunFiles(run_dir)
        self._disk: RecordWriter = (ImmediateRecordWriter if synchronous else ThreadedRecordWriter)(
            files.queue_and_print_error
        )
        self._disk.submit_write_job(TEXT, files.open_text)
        self._disk.submit_write_job(STREAM, files.open_stream)
        self._disk.submit_write_job(DECISIONS, lambda: files.open_decisions(is_resumed=is_resumed))

    def take_next_error_text(self) -> str | None:
        """Return the next record error since the last call."""
        error_texts = self._files.error_texts
        return error_texts.popleft() if error_texts else None

    def buffer_frame(self, frame: bytes, t_s: float) -> None:
        """Record one MAVLink frame, received or sent."""
        self._frames.append((frame, t_s))
        if self._synchronous:
            self.submit_buffered_frames()

    def submit_buffered_frames(self) -> None:
        """Pass the frames of a cycle to the disk in one job: each job wakes its thread."""
        if self._frames:
            frames, self._frames = self._frames, []
            self._disk.submit_write_job(STREAM, lambda: self._files.write_frames(frames))

    def submit_settings_write(self, job: Callable[[], None]) -> None:
        """Write the vehicle settings to restore, in call order."""
        self._disk.submit_write_job(SETTINGS_RECORD, job, is_replaced_at_each_write=True)

    def submit_monitor_write(self, job: Callable[[], None]) -> None:
        """Write the vehicle's service record, in call order."""
        self._disk.submit_write_job(MONITOR_RECORD, job, is_replaced_at_each_write=True)

    def wait_until_stored(self) -> None:
        """Block until all records are on disk."""
        self.submit_buffered_frames()
        self._disk.wait_until_done()

    def record_new_telemetry(self, telemetry: TelemetryState, system_id: int | None) -> None:
        """Record new telemetry at a tick: the input of `companion replay`."""
        kind = telemetry.autopilot_kind
        if kind is not None and system_id is not None and kind is not self._autopilot_kind:
            self._autopilot_kind = kind
            row = {"t_s": telemetry.t_s, "flavour": kind.value, "system_id": system_id}
            self._submit_decision_log_row(AUTOPILOT_TOPIC, row)
        for topic, row in self._telemetry_rows.take_new_rows(telemetry):
            self._submit_decision_log_row(topic, row)

    def record_plan_if_new(
        self, t_s: float, flown: FlightPlan | None, autopilot_kind: AutopilotKind | None
    ) -> None:
        """Record the mission of a new plan for QGroundControl and for the map in Foxglove."""
        if flown is None or autopilot_kind is None or flown is self._plan:
            return
        self._plan = flown
        mission, now_us = build_mission_export(flown, self.run_dir.name), self._unix_clock_us()
        self._disk.submit_write_job(
            MISSION,
            lambda: self._write_mission(mission, autopilot_kind),
            is_replaced_at_each_write=True,
        )
        self._disk.submit_write_job(
            DECISIONS,
            lambda: self._files.open_files[DECISIONS].write_route_geojson(
                t_s, mission_geojson(mission), now_us
            ),
        )

    def _write_mission(self, mission: MissionExport, autopilot_kind: AutopilotKind) -> None:
        text = mission_document_text(mission, ExportFormat.PLAN, autopilot_kind.value)
        write_text_atomically(self.run_dir / MISSION, text, sync_folder=False)

    def record_action(self, action: Action, t_s: float) -> None:
        """Record one action."""
        if (on_action := self._on_action) is not None:
            self._disk.submit_write_job(SCREEN_RECORD, lambda: on_action(action))
        if (topic := TOPIC_BY_ACTION.get(type(action))) is not None:
            row = _row_with_rounded_floats(action)
            self._lists[LIST_BY_TOPIC[topic]].append(row)
            self._submit_decision_log_row(topic, row)
        match action:
            case Decision():
                sites = ", ".join(f"{s.landing} {s.margin_now_wh:+.1f}" for s in action.sites)
                promise = (
                    f" [P(home): {action.p_home_text}, margin {action.margin_wh:+.1f} Wh;"
                    f" now {sites}]"
                    if action.p_home_text is not None and action.margin_wh is not None
                    else ""
                )
                self.submit_text_log_line(t_s, f"{action.kind}: {action.reason}{promise}")
            case PhaseChanged():
                self.submit_text_log_line(t_s, f"{action.before} -> {action.now} ({action.why})")
            case AlertReport():
                row = {
                    "t_s": t_s,
                    "severity": int(action.severity),
                    "text": action.text,
                    "alert": action.alert.identifier,
                }
                self._submit_decision_log_row("said", row)
                self.submit_text_log_line(t_s, f"alert: {action.text}")
            case LogNote():
                self.submit_text_log_line(t_s, action.text)
            case SaveCheckpoint() if self._checkpoints_enabled:
                self._write_checkpoint(action)
            case Finished():
                self._finished = action

    def _write_checkpoint(self, action: SaveCheckpoint) -> None:
        self._disk.submit_write_job(
            CHECKPOINT,
            checkpoint_write_job(self.run_dir, action.content, sync_folder=not action.routine),
            is_replaced_at_each_write=True,
            replace_queued_job=action.routine,
        )

    def submit_text_log_line(self, t_s: float, text: str) -> None:
        """Write one line to the text log."""
        line = format_log_entry(t_s, text)
        self._disk.submit_write_job(TEXT, lambda: self._files.open_files[TEXT].write(line))

    def submit_latest_write(self, record: str, job: Callable[[], None]) -> None:
        """Write a file of another component; of several waiting writes, only the latest."""
        self._disk.submit_write_job(record, job, replace_queued_job=True)

    def record_exception(self, t_s: float, error: BaseException) -> None:
        """Show the exception that ended the loop, and write it with its traceback."""
        if (on_action := self._on_action) is not None:
            shown = LogNote(f"internal error: {error}", in_run=True, in_check=True)
            self._disk.submit_write_job(SCREEN_RECORD, lambda: on_action(shown))
        self.submit_text_log_line(
            t_s, f"internal error: {error!r}\n{''.join(traceback.format_exception(error))}"
        )

    def _submit_decision_log_row(self, topic: str, row: dict[str, Any]) -> None:
        now_us = self._unix_clock_us()
        self._disk.submit_write_job(
            DECISIONS, lambda: self._files.open_files[DECISIONS].write(topic, row, now_us)
        )

    def write_result_and_wait(
        self,
        *,
        delivered: bool,
        flown: FlightPlan | None,
        phase: str,
        findings: Sequence[PreflightIssue] = (),
        settings: Sequence[SettingChange] = (),
    ) -> None:
        """Write `result.json` atomically, including rows of the interrupted runs."""
        done = self._finished
        result = {
            "format": FORMAT,
            "outcome": done.outcome if done is not None else None,
            "reason": done.reason if done is not None else f"ended in phase {phase}",
            "delivered": delivered,
            "home": done.home if done is not None else None,
            "margin_wh": done.margin_wh if done is not None else None,
            "phase": phase,
            "findings": [asdict(issue) for issue in findings],
            "settings": [
                {
                    "name": s.name,
                    "before": s.original_value,
                    "set": s.value_set,
                    "restored": s.restored,
                }
                for s in settings
            ],
            "plan": None if flown is None else plan_to_record_dict(flown),
        }
        self._disk.submit_write_job(
            RESULT,
            lambda: self._files.write_result(result, self._lists),
            is_replaced_at_each_write=True,
        )
        self.wait_until_stored()

    def close(self) -> None:
        """Close all files."""
        self.submit_buffered_frames()
        self._disk.submit_write_job("end of the records", self._files.close)
        self._disk.close()


def _row_with_rounded_floats(action: Any) -> dict[str, Any]:
    return {
        WIND_KEYS.get(name, name): round(value, 5) if isinstance(value, float) else value
        for name, value in asdict(action).items()
    }
