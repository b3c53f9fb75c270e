"""Read telemetry from CSV: `t_s, vel_n_mps, vel_e_mps, vel_d_mps, roll_deg, ...`
(docs/how-to/replay-a-log.md).

An empty cell is unknown, and so is a missing column except time and velocities. Other columns are
ignored. `airspeed_mps` is a magnitude.
"""

from pathlib import Path

import numpy as np

from companion.adapters.logs.csv_table import CsvTable, read_column_names
from companion.adapters.logs.log_time import make_time_monotonic
from companion.adapters.logs.log_units import Columns, convert_wrong_units_in_place
from companion.adapters.logs.m100_csv import is_m100_csv, read_m100_table
from companion.analysis.replay.airborne import (
    airborne_mask_by_motion,
    height_from_vertical_velocity_m,
)
from companion.analysis.replay.recorded_flight import LogIssue, RecordedFlight, WindReference
from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import offset_position_deg
from companion.core.mission.events import (
    Airspeed,
    Attitude,
    Battery,
    Event,
    GroundState,
    Mode,
    Position,
    VehicleLandedState,
    VehicleState,
)

REQUIRED = ("t_s", "vel_n_mps", "vel_e_mps", "vel_d_mps")
ATTITUDE = ("roll_deg", "pitch_deg", "yaw_deg")
POSITION = ("lat_deg", "lon_deg", "alt_m")
REFERENCE_WIND = ("wind_to_n_ref_mps", "wind_to_e_ref_mps")
BATTERY = ("voltage_v", "current_a", "consumed_mah", "remaining_frac")
LIMITS = {
    "vel_n_mps": (-100.0, 100.0),
    "vel_e_mps": (-100.0, 100.0),
    "vel_d_mps": (-50.0, 50.0),
    "roll_deg": (-180.0, 180.0),
    "pitch_deg": (-90.0, 90.0),
    "yaw_deg": (-360.0, 360.0),
    "airspeed_mps": (0.0, 100.0),
    "lat_deg": (-90.0, 90.0),
    "lon_deg": (-180.0, 180.0),
    "alt_m": (-500.0, 10_000.0),
    "voltage_v": (0.1, 1000.0),
    "current_a": (-20.0, 2000.0),
    "consumed_mah": (0.0, 1e7),
    "remaining_frac": (0.0, 1.0),
    "armed": (0.0, 1.0),
    "wind_to_n_ref_mps": (-100.0, 100.0),
    "wind_to_e_ref_mps": (-100.0, 100.0),
}
"""Values outside these limits are treated as unknown."""

KNOWN = ("t_s", *LIMITS)
ASSUMED_START_HEIGHT_M = 20.0
"""Assumed height of a log that starts in the air: above the estimators' ground effect."""


def read_csv_log(path: Path) -> RecordedFlight:
    """Read CSV telemetry, the project's or the M100 field flights' (`m100_csv`).

    Raises LeewayError for a file without a flight.
    """
    if is_m100_csv(read_column_names(path)):
        return _recorded_flight(path, read_m100_table(path), "m100 csv")
    table = CsvTable.read(path, REQUIRED, KNOWN)
    table.findings += convert_wrong_units_in_place(table.columns)
    return _recorded_flight(path, table, "csv")


def _recorded_flight(path: Path, table: CsvTable, source: str) -> RecordedFlight:
    if len(table.lines) < 2:
        raise LeewayError(f"{path}: line 2: {len(table.lines)} rows with the columns of line 1")
    findings = table.findings + table.replace_out_of_limits_by_nan(LIMITS)
    time = make_time_monotonic(table.columns["t_s"], table.line_text)
    findings += time.findings
    rows = {name: values[time.kept] for name, values in table.columns.items()}
    rows["t_s"] = time.t_s
    if time.t_s.size < 2:
        raise LeewayError(f"{path}: {time.t_s.size} rows with a time, expected 2 or more")
    events, measured = _events_and_is_position_measured(rows, findings)
    missing = [name for name in ATTITUDE if not np.isfinite(_column_or_nan(rows, name)).any()]
    if missing:  # the replay reports the other ones
        findings.append(LogIssue("log", f"no {', '.join(missing)}", "no wind from the tilt"))
    return RecordedFlight(
        source=source,
        events=tuple(events),
        findings=tuple(findings),
        position_measured=measured,
        reference=_wind_reference(rows),
    )


def _events_and_is_position_measured(
    rows: Columns, findings: list[LogIssue]
) -> tuple[list[Event], bool]:
    """Return the telemetry events in time order, and whether the position is measured."""
    t_s = rows["t_s"]
    position, measured = _positions_and_whether_measured(rows)
    is_airborne = _airborne_mask(rows, findings)
    drifts = not _is_column_usable(rows, "alt_m")
    ground_m = _ground_level_m(
        position[2], is_airborne, does_height_drift=drifts, findings=findings
    )
    velocity = np.stack([rows[name] for name in REQUIRED[1:]])
    angles = np.radians(np.stack([_column_or_nan(rows, name) for name in ATTITUDE]))
    airspeed = _column_or_nan(rows, "airspeed_mps")
    battery = np.stack([_column_or_nan(rows, name) for name in BATTERY])
    has_motion = np.atleast_1d(np.isfinite(np.concatenate([velocity, position])).all(axis=0))
    has_attitude = np.atleast_1d(np.isfinite(angles).all(axis=0))
    has_battery = np.atleast_1d(np.isfinite(battery).any(axis=0))
    events: list[Event] = []
    reported_airborne: bool | None = None
    for i, now_s in enumerate(t_s.tolist()):
        if is_airborne[i] != reported_airborne:
            reported_airborne = bool(is_airborne[i])
            events.append(VehicleState(now_s, Mode.OTHER, "unknown", armed=reported_airborne))
            ground = (
                VehicleLandedState.IN_AIR if reported_airborne else VehicleLandedState.ON_GROUND
            )
            events.append(GroundState(now_s, ground))
        if has_attitude[i]:
            events.append(Attitude(now_s, *angles[:, i].tolist()))
        if has_motion[i]:
            lat, lon, alt = position[:, i].tolist()
            height = alt - float(ground_m[i])
            events.append(Position(now_s, lat, lon, alt, height, *velocity[:, i].tolist()))
        if airspeed[i] == airspeed[i]:
            events.append(Airspeed(now_s, float(airspeed[i]), is_magnitude=True))
        if has_battery[i]:
            events.append(_battery_event(now_s, battery[:, i].tolist()))
    return events, measured


def _battery_event(t_s: float, values: list[float]) -> Battery:
    voltage, current, consumed_mah, remaining = (None if v != v else v for v in values)
    return Battery(
        t_s,
        voltage_v=voltage,
        current_a=current,
        consumed_ah=None if consumed_mah is None else consumed_mah / 1000.0,
        remaining_frac=remaining,
    )


def _positions_and_whether_measured(rows: Columns) -> tuple[Floats, bool]:
    """Return latitude, longitude (degrees), height of each row (3, n); whether measured."""
    if all(name in rows and np.isfinite(rows[name]).any() for name in POSITION):
        return np.stack([rows[name] for name in POSITION]), True
    t_s = rows["t_s"]
    vel = np.nan_to_num(np.stack([rows[name] for name in REQUIRED[1:]]))
    north, east = (-height_from_vertical_velocity_m(t_s, vel[k]) for k in (0, 1))
    height = (
        rows["alt_m"]
        if _is_column_usable(rows, "alt_m")
        else height_from_vertical_velocity_m(t_s, vel[2])
    )
    return np.stack([*offset_position_deg(0.0, 0.0, north, east), height]), False


def _ground_level_m(
    height_m: Floats, is_airborne: Bools, *, does_height_drift: bool, findings: list[LogIssue]
) -> Floats:
    """Return the ground height at each row, in the datum of `height_m`.

    A height integrated from velocities drifts: it is matched to the ground around a flight.
    """
    if is_airborne[0]:
        findings.append(
            LogIssue("log", "starts in the air", f"assumed height {ASSUMED_START_HEIGHT_M:.0f} m")
        )
        return np.full(height_m.size, float(np.nanmin(height_m)) - ASSUMED_START_HEIGHT_M)
    ground_rows = np.flatnonzero(~is_airborne & np.isfinite(height_m))
    if not ground_rows.size:
        return np.full(height_m.size, float(np.nanmin(height_m)))
    if does_height_drift:
        return np.interp(np.arange(height_m.size), ground_rows, height_m[ground_rows])
    return np.full(height_m.size, height_m[ground_rows[0]])


def _airborne_mask(rows: Columns, findings: list[LogIssue]) -> Bools:
    if _is_column_usable(rows, "armed"):
        return np.nan_to_num(rows["armed"]) > 0.5
    t_s = rows["t_s"]
    vel = np.stack([rows[name] for name in REQUIRED[1:]], axis=1)
    tilt = np.radians(np.stack([_column_or_nan(rows, name) for name in ATTITUDE[:2]], axis=1))
    is_airborne = airborne_mask_by_motion(
        t_s, vel, tilt, rows["alt_m"] if _is_column_usable(rows, "alt_m") else None
    )
    where = np.flatnonzero(is_airborne)
    description = (
        f"airborne from {t_s[where[0]]:.0f} s by its motion" if where.size else "never airborne"
    )
    findings.append(LogIssue("log", "no column armed", description))
    return is_airborne


def _wind_reference(rows: Columns) -> WindReference | None:
    if any(name not in rows for name in REFERENCE_WIND):
        return None
    wind = np.stack([rows[name] for name in REFERENCE_WIND], axis=1)
    known = np.isfinite(wind).all(axis=1)
    return WindReference(rows["t_s"][known], wind[known]) if known.any() else None


def _column_or_nan(rows: Columns, name: str) -> Floats:
    return rows.get(name, np.full(rows["t_s"].size, np.nan))


def _is_column_usable(rows: Columns, name: str) -> bool:
    return name in rows and bool(np.isfinite(rows[name]).mean() > 0.5)
