"""Writes a run's folder: text log, decision log, MAVLink stream, checkpoint and result.

No flight waits for it, and none ends because of it: see `companion.adapters.files.disk`.
"""

import contextlib
import json
import sys
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from companion.adapters.files.atomic_file import sealed, write_text_whole
from companion.adapters.files.checkpoint_file import NAME as CHECKPOINT
from companion.adapters.files.disk import Disk, DiskAtOnce, DiskThread
from companion.adapters.logs.decision_log import (
    IDENTIFIED,
    DecisionLog,
    HeardRows,
    aside_name,
    free_name,
    read_log,
)
from companion.adapters.logs.text_log import TextLog, dated
from companion.adapters.logs.tlog_writer import Tlog
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import MissionExport, mission_export
from companion.core.exports.formats import mission_text
from companion.core.exports.geojson import mission_geojson
from companion.core.mission.actions import (
    Action,
    Assessed,
    Decision,
    EnergyReport,
    Finished,
    Note,
    PhaseChanged,
    SaveCheckpoint,
    Say,
    WindReport,
)
from companion.core.mission.events import AutopilotKind
from companion.core.mission.flight_plan import FlightPlan, plan_row
from companion.core.mission.preflight_checks import Finding
from companion.core.pilot.ground_sequence import SettingChange
from companion.core.pilot.telemetry_state import TelemetryState

TEXT, STREAM, DECISIONS = "companion.log", "stream.tlog", "decisions.mcap"
RESULT, MISSION = "result.json", "mission.plan"
SETTINGS = "settings of the vehicle"
MONITOR = "record of the monitor"
SCREEN = "screen"
FORMAT = "companion-result/2"
TOPIC = {
    "decisions": "decision",
    "assessments": "assessment",
    "wind": "wind",
    "energy": "energy",
    "phases": "phase",
}
"""Lists of the result, and the decision log's topic of each."""


class Recorder:
    """Writes as things happen; `write_result` may be called at any end, more than once."""

    def __init__(
        self,
        run_dir: Path,
        *,
        continues: bool = False,
        keep_checkpoints: bool = True,
        at_once: bool = False,
    ) -> None:
        """`at_once`: the flight waits for the disk, in a world that waits for the flight."""
        self.run_dir = run_dir
        self._keep = keep_checkpoints
        self._continues = continues
        self._before: dict[str, list[dict[str, Any]]] = {}
        self._rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TOPIC}
        self._heard = HeardRows()
        self._autopilot_kind: AutopilotKind | None = None
        self._plan: FlightPlan | None = None
        self._finished: Finished | None = None
        self._troubles: deque[str] = deque()
        self._ends = contextlib.ExitStack()
        self._text: TextLog | None = None
        self._stream: Tlog | None = None
        self._decisions: DecisionLog | None = None
        self._frames: list[tuple[bytes, float]] = []
        self._at_once = at_once
        self._disk: Disk = (DiskAtOnce if at_once else DiskThread)(self._on_trouble)
        self._disk.do(TEXT, self._open_text)
        self._disk.do(STREAM, self._open_stream)
        self._disk.do(DECISIONS, self._open_decisions)

    # --- on the disk's thread ------------------------------------------------------------------

    def _open_text(self) -> None:
        self.run_dir.mkdir(parents=True, exist_ok=True)
        self._text = TextLog(self.run_dir / TEXT)
        self._ends.callback(self._text.close)

    def _open_stream(self) -> None:
        self._stream = Tlog(self.run_dir / STREAM)
        self._ends.callback(self._stream.close)

    def _open_decisions(self) -> None:
        if self._continues:
            self._before = self._earlier_rows()
        self._decisions = DecisionLog(free_name(self.run_dir / DECISIONS))
        self._ends.callback(self._decisions.close)

    def _earlier_rows(self) -> dict[str, list[dict[str, Any]]]:
        """Rows of the runs in this folder that were cut off before us, from their decision logs."""
        rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TOPIC}
        logs = sorted(
            self.run_dir.glob("decisions*.mcap"), key=lambda path: (len(path.name), path.name)
        )
        for path in logs:
            found = read_log(path)
            for topic, row in found.rows:
                for name, own in TOPIC.items():
                    if topic == own:
                        rows[name].append(row)
                if topic == "decision" and row.get("kind") == "finished":  # an earlier flight
                    rows = {name: [] for name in TOPIC}
            if found.damage:
                self._on_trouble(f"{path.name}: {found.damage}: moved aside")
                path.replace(aside_name(path))
        return rows

    def _write_row(self, topic: str, row: dict[str, Any]) -> None:
        assert self._decisions is not None
        self._decisions.write(topic, row)

    def _write_frames(self, frames: list[tuple[bytes, float]]) -> None:
        assert self._stream is not None
        for frame, t_s in frames:
            self._stream.write(frame, t_s)

    def _write_text(self, line: str) -> None:
        assert self._text is not None
        self._text.write(line)

    def _on_trouble(self, words: str) -> None:
        """Keep it for the operator; the log and the screen hear it where they still can."""
        self._troubles.append(words)
        if self._text is not None:
            with contextlib.suppress(OSError, ValueError):
                self._text.write(f"record given up: {words}")
        with contextlib.suppress(OSError, ValueError):
            print(f"record given up: {words}", file=sys.stderr, flush=True)

    # --- on the flight's -----------------------------------------------------------------------

    def new_trouble(self) -> str | None:
        """What befell a record since this was asked last."""
        return self._troubles.popleft() if self._troubles else None

    def stream(self, frame: bytes, t_s: float) -> None:
        """Record one MAVLink frame that came or went."""
        self._frames.append((frame, t_s))
        if self._at_once:
            self.hand_over()

    def hand_over(self) -> None:
        """Give the frames of a turn to the disk, together: each deed wakes its thread."""
        if self._frames:
            frames, self._frames = self._frames, []
            self._disk.do(STREAM, lambda: self._write_frames(frames))

    def show(self, on_action: Callable[[Action], None], action: Action) -> None:
        """Give an action to who prints it; a screen can be a full disk or a pipe that blocks."""
        self._disk.do(SCREEN, lambda: on_action(action))

    def keep_settings(self, deed: Callable[[], None]) -> None:
        """Write what is to be put back on the vehicle, in the order of these calls."""
        self._disk.do(SETTINGS, deed, whole=True)

    def keep_monitor(self, deed: Callable[[], None]) -> None:
        """Write the record of the vehicle's service, in the order of these calls."""
        self._disk.do(MONITOR, deed, whole=True)

    def settle(self) -> None:
        """Return once all that was recorded is on the disk."""
        self.hand_over()
        self._disk.settle()

    def heard(
        self, now: TelemetryState, autopilot_kind: AutopilotKind | None, system_id: int | None
    ) -> None:
        """Record what is new in the situation at a tick: `companion replay` starts from it."""
        if (
            autopilot_kind is not None
            and system_id is not None
            and autopilot_kind is not self._autopilot_kind
        ):
            self._autopilot_kind = autopilot_kind
            row = {"t_s": now.t_s, "flavour": autopilot_kind.value, "system_id": system_id}
            self._topic(IDENTIFIED, row)
        for topic, row in self._heard.new(now):
            self._topic(topic, row)

    def planned(self, t_s: float, flown: FlightPlan, autopilot_kind: AutopilotKind) -> None:
        """Record the mission of a new plan, as QGroundControl opens it and for Foxglove's map."""
        if flown is self._plan:
            return
        self._plan = flown
        mission = mission_export(flown, self.run_dir.name)
        self._disk.do(MISSION, lambda: self._write_mission(mission, autopilot_kind), whole=True)
        self._disk.do(DECISIONS, lambda: self._write_route(t_s, mission))

    def _write_mission(self, mission: MissionExport, autopilot_kind: AutopilotKind) -> None:
        text = mission_text(mission, ExportFormat.PLAN, autopilot_kind.value)
        write_text_whole(self.run_dir / MISSION, text, settle=False)

    def _write_route(self, t_s: float, mission: MissionExport) -> None:
        assert self._decisions is not None
        self._decisions.write_route(t_s, mission_geojson(mission))

    def take(self, action: Action, t_s: float) -> None:
        """Record one action."""
        match action:
            case Decision():
                self._row("decisions", _rounded(asdict(action)))
                promise = (
                    f" [p_home {action.p_home:.4f}, margin {action.margin_wh:.1f} Wh]"
                    if action.p_home is not None and action.margin_wh is not None
                    else ""
                )
                self.note(t_s, f"{action.kind}: {action.reason}{promise}")
            case Assessed():
                self._row("assessments", _rounded(asdict(action)))
            case WindReport():
                row = {
                    "t_s": action.t_s,
                    "to_n_mps": action.n_mps,
                    "to_e_mps": action.e_mps,
                    "nn_m2ps2": action.nn_m2ps2,
                    "ne_m2ps2": action.ne_m2ps2,
                    "ee_m2ps2": action.ee_m2ps2,
                }
                self._row("wind", _rounded(row))
            case EnergyReport():
                self._row("energy", _rounded(asdict(action)))
            case PhaseChanged():
                self._row("phases", _rounded(asdict(action)))
                self.note(t_s, f"{action.before} -> {action.now} ({action.why})")
            case Say():
                row = {"t_s": t_s, "severity": int(action.severity), "text": action.text}
                self._topic("said", row)
                self.note(t_s, f"says: {action.text}")
            case Note():
                self.note(t_s, action.text)
            case SaveCheckpoint() if self._keep:
                self._checkpoint(action)
            case Finished():
                self._finished = action
            case _:
                return

    def _checkpoint(self, action: SaveCheckpoint) -> None:
        path, text, routine = self.run_dir / CHECKPOINT, sealed(action.content), action.routine
        self._disk.do(
            CHECKPOINT,
            lambda: write_text_whole(path, text, settle=not routine),
            whole=True,
            newest_only=routine,
        )

    def note(self, t_s: float, text: str) -> None:
        """Write one line for people."""
        line = dated(t_s, text)
        self._disk.do(TEXT, lambda: self._write_text(line))

    def keep(self, record: str, deed: Callable[[], None]) -> None:
        """Write a record of somebody else's beside ours; of several that wait, the newest."""
        self._disk.do(record, deed, newest_only=True)

    def trouble(self, t_s: float, error: BaseException) -> None:
        """Write what broke the loop, with its traceback."""
        self.note(t_s, f"broken: {error!r}\n{''.join(traceback.format_exception(error))}")

    def _topic(self, topic: str, row: dict[str, Any]) -> None:
        self._disk.do(DECISIONS, lambda: self._write_row(topic, row))

    def _row(self, name: str, row: dict[str, Any]) -> None:
        self._rows[name].append(row)
        self._topic(TOPIC[name], row)

    def write_result(
        self,
        *,
        delivered: bool,
        flown: FlightPlan | None,
        phase: str,
        findings: Sequence[Finding] = (),
        settings: Sequence[SettingChange] = (),
    ) -> None:
        """Write `result.json`, whole or not at all, with the rows of the run that we go on from."""
        done = self._finished
        result = {
            "format": FORMAT,
            "outcome": done.outcome if done is not None else None,
            "reason": done.reason if done is not None else f"ended in phase {phase}",
            "delivered": delivered,
            "home": done.home if done is not None else None,
            "margin_wh": done.margin_wh if done is not None else None,
            "phase": phase,
            "findings": [asdict(finding) for finding in findings],
            "settings": [
                {"name": s.name, "before": s.before, "set": s.value_set, "restored": s.restored}
                for s in settings
            ],
            "plan": None if flown is None else plan_row(flown),
        }
        self._disk.do(RESULT, lambda: self._write_result(result), whole=True)
        self.settle()

    def _write_result(self, result: dict[str, Any]) -> None:
        rows = {name: self._before.get(name, []) + rows for name, rows in self._rows.items()}
        text = json.dumps(result | rows, allow_nan=False)
        write_text_whole(self.run_dir / RESULT, text, settle=False)

    def close(self) -> None:
        """End every file."""
        self.hand_over()
        self._disk.do("end of the records", self._ends.close)
        self._disk.close()


def _rounded(row: dict[str, Any]) -> dict[str, Any]:
    return {k: round(v, 5) if isinstance(v, float) else v for k, v in row.items()}
