"""Output files of a replay: wind.csv and the JSON record (docs/reference/replay-json.md)."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.files.atomic_file import write_text_atomically
from companion.analysis.replay.autopilot_faults import autopilot_faults
from companion.analysis.replay.flight_replay import ReplayResult, ReplayState
from companion.analysis.replay.recorded_flight import RecordedFlight
from companion.analysis.replay.summary import WindScore, WindSummary
from companion.core.base.errors import LeewayError

FORMAT = "replay/1"
WIND_HEADER = "t_s,wind_to_n_mps,wind_to_e_mps,std_n_mps,std_e_mps"


def write_wind_csv(path: Path, result: ReplayResult) -> None:
    """Write the wind (direction TO) at every tick, with its standard deviations."""
    var = result.wind_cov_m2ps2
    table = np.column_stack(
        [result.wind_t_s, result.wind_to_ne_mps, np.sqrt(var[:, 0, 0]), np.sqrt(var[:, 1, 1])]
    )
    rows = (f"{t_s:.10g}," + ",".join(f"{x:.4f}" for x in row) for t_s, *row in table.tolist())
    _write_text(path, "\n".join((WIND_HEADER, *rows)) + "\n")


def write_replay_json(path: Path, record: dict[str, Any]) -> None:
    """Write the JSON record."""
    _write_text(path, json.dumps(record, indent=1, allow_nan=False) + "\n")


def build_replay_record(
    log_path: Path,
    log: RecordedFlight,
    airframe: str,
    result: ReplayResult,
    wind: WindSummary | None,
    score: WindScore | None,
    cpu_s: float,
) -> dict[str, Any]:
    """Return the whole replay as plain rows; docs/reference/replay-json.md explains each."""
    seen = [m.assessment for m in result.states if m.assessment is not None]
    energies = [m for m in result.states if m.energy_left_wh is not None]
    record = {
        "format": FORMAT,
        "log": {
            "path": str(log_path),
            "source": log.source,
            "vehicle": log.vehicle,
            "autopilot": None if log.autopilot_kind is None else log.autopilot_kind.value,
            "firmware": log.firmware,
            "start_s": log.start_s,
            "duration_s": log.duration_s,
            "flown_s": result.air_time_s,
        },
        "airframe": airframe,
        "findings": [asdict(log_issue) for log_issue in result.findings],
        "notes": [{"t_s": t_s, "text": text} for t_s, text in result.notes],
        "autopilot_faults": [{"t_s": t_s, "text": text} for t_s, text in autopilot_faults(log)],
        "wind": None if wind is None else {**asdict(wind), "mean_from_deg": wind.mean_from_deg},
        "reference": None if score is None else asdict(score),
        "energy": None
        if not energies
        else {
            "start_wh": energies[0].energy_left_wh,
            "end_wh": energies[-1].energy_left_wh,
            "used_wh": energies[-1].used_wh,
            "end_std_wh": energies[-1].energy_std_wh,
            "reserve_wh": result.reserve_wh,
        },
        "promise": None
        if not seen
        else {
            "p_home_min": min(s.p_home for s in seen),
            "p_home_stated_min": min(s.p_home_stated for s in seen),
            "p_home_now_min": min(s.p_home_now for s in seen),
            "margin_min_wh": min(s.margin_wh for s in seen),
            "turn_back_s": next((d.t_s for d in result.decisions if d.kind == "turn_back"), None),
        },
        "decisions": [asdict(decision) for decision in result.decisions],
        "timeline": _timeline_rows(result),
        "speed": {
            "cpu_s": cpu_s,
            "times_real_time": log.duration_s / cpu_s if cpu_s > 0.0 else None,
        },
    }
    return _round_floats_nonfinite_to_none(record)


def _timeline_rows(result: ReplayResult) -> list[dict[str, Any]]:
    at = np.searchsorted(result.wind_t_s, [m.t_s + 1e-6 for m in result.states]) - 1
    return [_timeline_row(m, result, int(i)) for m, i in zip(result.states, at, strict=True)]


def _timeline_row(
    replay_row: ReplayState, result: ReplayResult, wind_row_index: int
) -> dict[str, Any]:
    seen, known = replay_row.assessment, wind_row_index >= 0
    cov = result.wind_cov_m2ps2[wind_row_index] if known else None
    return {
        "t_s": replay_row.t_s,
        "airborne": replay_row.airborne,
        "height_m": replay_row.height_m,
        "home_m": replay_row.home_m,
        "wind_to_n_mps": float(result.wind_to_ne_mps[wind_row_index, 0]) if known else None,
        "wind_to_e_mps": float(result.wind_to_ne_mps[wind_row_index, 1]) if known else None,
        "std_n_mps": None if cov is None else math.sqrt(cov[0, 0]),
        "std_e_mps": None if cov is None else math.sqrt(cov[1, 1]),
        "energy_left_wh": replay_row.energy_left_wh,
        "energy_std_wh": replay_row.energy_std_wh,
        "energy_need_wh": None if seen is None else seen.energy_need_wh,
        "p_home": None if seen is None else seen.p_home,
        "p_home_stated": None if seen is None else seen.p_home_stated,
        "p_home_now": None if seen is None else seen.p_home_now,
        "p_success": None if seen is None else seen.p_success,
        "margin_wh": None if seen is None else seen.margin_wh,
    }


def _round_floats_nonfinite_to_none(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _round_floats_nonfinite_to_none(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_round_floats_nonfinite_to_none(item) for item in value]
    return value


def _write_text(path: Path, text: str) -> None:
    """Write atomically: a reader never finds half a file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text_atomically(path, text, sync_folder=False)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
