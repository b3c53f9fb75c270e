"""Writes a run's folder: text log, decision log, MAVLink stream, checkpoint and result."""

import json
import logging
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from companion.adapters.files.checkpoint_file import write_checkpoint
from companion.adapters.logs.decision_log import (
    IDENTIFIED,
    DecisionLog,
    HeardRows,
    free_name,
    read_rows,
)
from companion.adapters.logs.tlog_writer import Tlog
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
from companion.core.pilot.telemetry_state import TelemetryState

RESULT = "result.json"
FORMAT = "companion-result/1"
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
        self, run_dir: Path, *, continues: bool = False, keep_checkpoints: bool = True
    ) -> None:
        run_dir.mkdir(parents=True, exist_ok=True)
        self._before = _earlier_rows(run_dir) if continues else {}
        self.run_dir = run_dir
        self._keep = keep_checkpoints
        self._log = logging.getLogger(f"companion.{run_dir}")
        self._log.setLevel(logging.INFO)
        self._log.propagate = False
        self._handler = logging.FileHandler(run_dir / "companion.log", encoding="utf-8")
        self._handler.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
        self._log.addHandler(self._handler)
        self.tlog = Tlog(run_dir / "stream.tlog")
        self._decisions = DecisionLog(free_name(run_dir / "decisions.mcap"))
        self._rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TOPIC}
        self._heard = HeardRows()
        self._autopilot_kind: AutopilotKind | None = None
        self._finished: Finished | None = None

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
            self._decisions.write(IDENTIFIED, row)
        for topic, row in self._heard.new(now):
            self._decisions.write(topic, row)

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
                    "n": action.n_mps,
                    "e": action.e_mps,
                    "nn": action.nn_m2ps2,
                    "ne": action.ne_m2ps2,
                    "ee": action.ee_m2ps2,
                }
                self._row("wind", _rounded(row))
            case EnergyReport():
                self._row("energy", _rounded(asdict(action)))
            case PhaseChanged():
                self._row("phases", _rounded(asdict(action)))
                self.note(t_s, f"{action.before} -> {action.now} ({action.why})")
            case Say():
                row = {"t_s": t_s, "severity": int(action.severity), "text": action.text}
                self._decisions.write("said", row)
                self.note(t_s, f"says: {action.text}")
            case Note():
                self.note(t_s, action.text)
            case SaveCheckpoint() if self._keep:
                write_checkpoint(self.run_dir, action.content, settle=not action.routine)
            case Finished():
                self._finished = action
            case _:
                return

    def note(self, t_s: float, text: str) -> None:
        """Write one line for people."""
        self._log.info("%9.2f  %s", t_s, text)

    def trouble(self, t_s: float, error: BaseException) -> None:
        """Write what broke the loop, with its traceback."""
        self._log.error("%9.2f  broken: %r", t_s, error, exc_info=error)

    def _row(self, name: str, row: dict[str, Any]) -> None:
        self._rows[name].append(row)
        self._decisions.write(TOPIC[name], row)

    def write_result(
        self,
        *,
        delivered: bool,
        flown: FlightPlan | None,
        phase: str,
        findings: Sequence[Finding] = (),
    ) -> None:
        """Write `result.json`, whole or not at all, with the rows of the run that we go on from."""
        rows = {name: self._before.get(name, []) + rows for name, rows in self._rows.items()}
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
            "plan": None if flown is None else plan_row(flown),
            **rows,
        }
        fresh = self.run_dir / f"{RESULT}.new"
        with fresh.open("w") as file:
            json.dump(result, file, allow_nan=False)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(self.run_dir / RESULT)

    def close(self) -> None:
        """End every file."""
        self.tlog.close()
        self._decisions.close()
        self._log.removeHandler(self._handler)
        self._handler.close()


def _earlier_rows(run_dir: Path) -> dict[str, list[dict[str, Any]]]:
    """Rows of the runs in this folder that were cut off before us, from their decision logs."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TOPIC}
    logs = sorted(run_dir.glob("decisions*.mcap"), key=lambda path: (len(path.name), path.name))
    for path in logs:
        for topic, row in read_rows(path):
            for name, own in TOPIC.items():
                if topic == own:
                    rows[name].append(row)
            if topic == "decision" and row["kind"] == "finished":  # an earlier flight
                rows = {name: [] for name in TOPIC}
    return rows


def _rounded(row: dict[str, Any]) -> dict[str, Any]:
    return {k: round(v, 5) if isinstance(v, float) else v for k, v in row.items()}
