"""Read telemetry from CSV: `t_s, vel_n_mps, vel_e_mps, vel_d_mps, roll_deg, ...`
(docs/how-to/replay-a-log.md).

An empty cell is unknown, and so is a missing column but for time and velocities. Columns that we
do not know are left alone. `airspeed_mps` is a magnitude.
"""

from pathlib import Path

import numpy as np

from companion.adapters.logs.csv_table import CsvTable, column_names
from companion.adapters.logs.log_time import running_time
from companion.adapters.logs.log_units import Columns, mend_units
from companion.adapters.logs.m100_csv import is_m100_csv, read_m100_table
from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import moved_deg
from companion.core.mission.events import (
    Airspeed,
    Attitude,
    Battery,
    Event,
    Ground,
    GroundState,
    Mode,
    Position,
    VehicleState,
)
from companion.core.replay.airborne import airborne, summed_height_m
from companion.core.replay.recorded_flight import LogFinding, RecordedFlight, WindReference

REQUIRED = ("t_s", "vel_n_mps", "vel_e_mps", "vel_d_mps")
ATTITUDE = ("roll_deg", "pitch_deg", "yaw_deg")
POSITION = ("lat_deg", "lon_deg", "alt_m")
REFERENCE = ("wind_to_n_ref_mps", "wind_to_e_ref_mps")
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
"""Outside, a value is not what its name says: it is taken as unknown."""

KNOWN = ("t_s", *LIMITS)
UNSEEN_HEIGHT_M = 20.0
"""Height of a log that begins in the air: above what the estimators take for ground effect."""


def read_csv_log(path: Path) -> RecordedFlight:
    """Read CSV telemetry, ours or the M100 field flights' (`m100_csv`).

    LeewayError where there is nothing to begin with.
    """
    if is_m100_csv(column_names(path)):
        return _flight(path, read_m100_table(path), "m100 csv")
    table = CsvTable.read(path, REQUIRED, KNOWN)
    table.findings += mend_units(table.columns)
    return _flight(path, table, "csv")


def _flight(path: Path, table: CsvTable, source: str) -> RecordedFlight:
    if len(table.lines) < 2:
        raise LeewayError(f"{path}: line 2: {len(table.lines)} rows as wide as line 1")
    findings = table.findings + table.check_limits(LIMITS)
    time = running_time(table.columns["t_s"], table.where)
    findings += time.findings
    rows = {name: values[time.kept] for name, values in table.columns.items()}
    rows["t_s"] = time.t_s
    if time.t_s.size < 2:
        raise LeewayError(f"{path}: {time.t_s.size} rows with a time; a flight has more")
    events, measured = _events(rows, findings)
    findings += _missing(rows)
    return RecordedFlight(
        source=source,
        events=tuple(events),
        findings=tuple(findings),
        position_measured=measured,
        reference=_reference(rows),
    )


def _missing(rows: Columns) -> list[LogFinding]:
    """Say which columns of the attitude are missing; the replay says the rest."""
    missing = [name for name in ATTITUDE if not np.isfinite(_column(rows, name)).any()]
    if not missing:
        return []
    return [LogFinding("log", f"no {', '.join(missing)}", "no wind from the tilt")]


def _events(rows: Columns, findings: list[LogFinding]) -> tuple[list[Event], bool]:
    """Return the telemetry events in the order of time, and whether the position is measured."""
    t_s = rows["t_s"]
    place, measured = _places(rows)
    flying = _flying(rows, findings)
    drifts = not _known(rows, "alt_m")
    ground_m = _ground_level_m(place[2], flying, drifts=drifts, findings=findings)
    velocity = np.stack([rows[name] for name in REQUIRED[1:]])
    angles = np.radians(np.stack([_column(rows, name) for name in ATTITUDE]))
    airspeed = _column(rows, "airspeed_mps")
    battery = np.stack([_column(rows, name) for name in BATTERY])
    moves = np.atleast_1d(np.isfinite(np.concatenate([velocity, place])).all(axis=0))
    leans = np.atleast_1d(np.isfinite(angles).all(axis=0))
    powered = np.atleast_1d(np.isfinite(battery).any(axis=0))
    events: list[Event] = []
    told_flying: bool | None = None
    for i, now_s in enumerate(t_s.tolist()):
        if flying[i] != told_flying:
            told_flying = bool(flying[i])
            events.append(VehicleState(now_s, Mode.OTHER, "unknown", armed=told_flying))
            ground = Ground.IN_AIR if told_flying else Ground.ON_GROUND
            events.append(GroundState(now_s, ground))
        if leans[i]:
            events.append(Attitude(now_s, *angles[:, i].tolist()))
        if moves[i]:
            lat, lon, alt = place[:, i].tolist()
            height = alt - float(ground_m[i])
            events.append(Position(now_s, lat, lon, alt, height, *velocity[:, i].tolist()))
        if airspeed[i] == airspeed[i]:
            events.append(Airspeed(now_s, float(airspeed[i]), is_magnitude=True))
        if powered[i]:
            events.append(_battery(now_s, battery[:, i].tolist()))
    return events, measured


def _battery(t_s: float, values: list[float]) -> Battery:
    voltage, current, consumed_mah, remaining = (None if v != v else v for v in values)
    return Battery(
        t_s,
        voltage_v=voltage,
        current_a=current,
        consumed_ah=None if consumed_mah is None else consumed_mah / 1000.0,
        remaining_frac=remaining,
    )


def _places(rows: Columns) -> tuple[Floats, bool]:
    """Latitude, longitude (degrees) and height of each row (3, n); whether the log has them."""
    if all(name in rows and np.isfinite(rows[name]).any() for name in POSITION):
        return np.stack([rows[name] for name in POSITION]), True
    t_s = rows["t_s"]
    vel = np.nan_to_num(np.stack([rows[name] for name in REQUIRED[1:]]))
    north, east = (-summed_height_m(t_s, vel[k]) for k in (0, 1))
    height = rows["alt_m"] if _known(rows, "alt_m") else summed_height_m(t_s, vel[2])
    return np.stack([*moved_deg(0.0, 0.0, north, east), height]), False


def _ground_level_m(
    height_m: Floats, flying: Bools, *, drifts: bool, findings: list[LogFinding]
) -> Floats:
    """Height of the ground at each row, in terms of `height_m`.

    A height summed up from velocities drifts: it is laid on the ground before and after a flight.
    """
    if flying[0]:
        findings.append(
            LogFinding("log", "begins in the air", f"taken to be {UNSEEN_HEIGHT_M:.0f} m up")
        )
        return np.full(height_m.size, float(np.nanmin(height_m)) - UNSEEN_HEIGHT_M)
    rests = np.flatnonzero(~flying & np.isfinite(height_m))
    if not rests.size:
        return np.full(height_m.size, float(np.nanmin(height_m)))
    if drifts:
        return np.interp(np.arange(height_m.size), rests, height_m[rests])
    return np.full(height_m.size, height_m[rests[0]])


def _flying(rows: Columns, findings: list[LogFinding]) -> Bools:
    if _known(rows, "armed"):
        return np.nan_to_num(rows["armed"]) > 0.5
    t_s = rows["t_s"]
    vel = np.stack([rows[name] for name in REQUIRED[1:]], axis=1)
    tilt = np.radians(np.stack([_column(rows, name) for name in ATTITUDE[:2]], axis=1))
    flying = airborne(t_s, vel, tilt, rows["alt_m"] if _known(rows, "alt_m") else None)
    where = np.flatnonzero(flying)
    said = f"in the air from {t_s[where[0]]:.0f} s by its motion" if where.size else "never flies"
    findings.append(LogFinding("log", "no column armed", said))
    return flying


def _reference(rows: Columns) -> WindReference | None:
    if any(name not in rows for name in REFERENCE):
        return None
    wind = np.stack([rows[name] for name in REFERENCE], axis=1)
    known = np.isfinite(wind).all(axis=1)
    return WindReference(rows["t_s"][known], wind[known]) if known.any() else None


def _column(rows: Columns, name: str) -> Floats:
    return rows.get(name, np.full(rows["t_s"].size, np.nan))


def _known(rows: Columns, name: str) -> bool:
    return name in rows and bool(np.isfinite(rows[name]).mean() > 0.5)
