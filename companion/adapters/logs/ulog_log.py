"""Read a PX4 ULog (.ulg) by pyulog: topics become the events that PX4's telemetry gives."""

import contextlib
import io
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.adapters.autopilots.telemetry import vehicle_kind
from companion.adapters.logs.log_time import LEAP_S, rising_rows, running_time, stray_stamps
from companion.adapters.logs.ulog_filter import wanted_part
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import moved_deg
from companion.core.base.safe_text import safe_text
from companion.core.mission.events import (
    Airspeed,
    Attitude,
    AutopilotKind,
    AutopilotWind,
    Battery,
    Event,
    GnssFix,
    Ground,
    GroundState,
    Home,
    MissionProgress,
    Mode,
    Position,
    VehicleState,
)
from companion.core.replay.recorded_flight import LogFinding, RecordedFlight
from companion.core.vehicle.airframe import MULTIROTOR

Rows = dict[str, NDArray[Any]]

TOPICS = (
    "vehicle_attitude",
    "vehicle_local_position",
    "vehicle_global_position",
    "home_position",
    "mission_result",
    "vehicle_status",
    "vehicle_land_detected",
    "vehicle_gps_position",
    "battery_status",
    "airspeed_validated",
    "wind",
    "wind_estimate",
)
SELDOM = ("home_position", "mission_result")
"""Logged as last published, which may be long before the log's start."""

LEAST_STEP_S = {
    "vehicle_attitude": 0.045,
    "vehicle_local_position": 0.09,
    "vehicle_global_position": 0.09,
    "vehicle_gps_position": 0.19,
    "battery_status": 0.19,
    "airspeed_validated": 0.09,
    "wind": 0.4,
    "wind_estimate": 0.4,
}
"""Least time between two of a kind: about what we ask for in flight."""

MODES = {
    3: (Mode.MISSION, "AUTO.MISSION"),
    4: (Mode.HOLD, "AUTO.HOLD"),
    5: (Mode.RTL, "AUTO.RTL"),
    14: (Mode.GUIDED, "OFFBOARD"),
    17: (Mode.TAKEOFF, "AUTO.TAKEOFF"),
    18: (Mode.LAND, "AUTO.LAND"),
}
"""vehicle_status.nav_state."""

ARMED = 2
SENSORS = (1, 2, 3)
"""airspeed_validated: 0 is ground speed less wind, 4 is synthetic, -1 switched off: no sensor."""

AIRFRAMES = {
    0: MULTIROTOR,
    1: "fixed wing",
    2: "VTOL",
    3: "VTOL",
    4: "VTOL",
    5: "rover",
    6: "rover",
}
"""CA_AIRFRAME, where MAV_TYPE is not in the log."""


DATA = struct.Struct("<HBHQ")
"""A data message: size, kind, subscription, and the time stamp that every topic begins with."""

MOST_STRAY_FRAC, MOST_STRAY = 0.05, 3.0
"""Of a topic's stamps; where more are out of order, its clock was set back."""

TAIL_BYTES, LOST_S, DAY_S = 4096, 2.0, 86_400.0
ROUNDS = 8


def read_ulog(path: Path) -> RecordedFlight:
    """Read a .ulg; LeewayError where it is none, or pyulog is not installed."""
    log, findings = _opened(path)
    topics = _topics(log, path, findings)
    values: dict[str, Any] = dict(log.initial_parameters)
    for _, name, value in log.changed_parameters:
        values[name] = value
    vehicle = vehicle_kind(values.get("MAV_TYPE", -1)) or AIRFRAMES.get(
        values.get("CA_AIRFRAME", -1)
    )
    takers = dict(_TAKERS)
    if values.get("EKF2_DRAG_CTRL") or vehicle not in (MULTIROTOR, None):
        takers |= {"wind": _winds, "wind_estimate": _winds}
    events = _first(topics, "vehicle_attitude", _attitudes, findings)
    events += _taken("position", lambda: _positions(topics, findings), findings)
    for name, take in takers.items():
        events += _first(topics, name, take, findings)
    events.sort(key=lambda event: event.t_s)
    if not events:
        raise LeewayError(f"{path}: none of {', '.join(TOPICS[:5])} in this ULog")
    return RecordedFlight(
        source="ulog",
        events=tuple(events),
        findings=tuple(findings),
        autopilot_kind=AutopilotKind.PX4,
        vehicle=vehicle,
        firmware=_firmware(log),
    )


def _first(
    topics: dict[str, list[Rows]],
    name: str,
    take: Callable[[Rows], list[Event]],
    findings: list[LogFinding],
) -> list[Event]:
    """What a topic's first instance tells; of batteries, what each does."""
    used = topics.get(name, [])[: None if name == "battery_status" else 1]
    return [e for rows in used for e in _taken(name, lambda rows=rows: take(rows), findings)]


def _taken(name: str, take: Callable[[], list[Event]], findings: list[LogFinding]) -> list[Event]:
    """What a topic tells: nothing where its definition is damaged, so that it lacks a field."""
    try:
        return take()
    except KeyError as missing:
        findings.append(LogFinding("log", f"{name}: no field {missing}", "left out"))
        return []


class _Bounded(io.BytesIO):
    """Bytes that end a reader which goes round in circles, as pyulog does on some damage."""

    def __init__(self, raw: bytes) -> None:
        super().__init__(raw)
        self._left = ROUNDS * (len(raw) + 4096)

    def read(self, size: int | None = -1, /) -> bytes:
        """Read, unless as much as several files were read already."""
        self._left -= 1 + (size or 0)
        if self._left < 0:
            raise RuntimeError("its definitions are damaged")
        return super().read(size)


def _opened(path: Path) -> tuple[Any, list[LogFinding]]:
    try:
        from pyulog import ULog
    except ImportError as error:
        raise LeewayError(
            f"{path}: reading ULog needs pyulog: pip install 'leeway-uas[replay]'"
        ) from error
    said = io.StringIO()
    try:
        steps_s = {name: LEAST_STEP_S.get(name, 0.0) for name in TOPICS}
        wanted = wanted_part(path.read_bytes(), steps_s)
        with contextlib.redirect_stdout(said), _Bounded(wanted) as file:
            log = ULog(file, list(TOPICS))
    except Exception as error:
        raise LeewayError(f"{path}: pyulog cannot read this file: {error!r}") from error
    findings: list[LogFinding] = []
    for line in dict.fromkeys(said.getvalue().splitlines()):
        findings.append(LogFinding("file", line.strip(), "whole messages are used"))
    if log.file_corruption and not findings:
        findings.append(LogFinding("file", "damaged bytes", "whole messages are used"))
    end_s, tail_s = log.last_timestamp / 1e6, _tail_s(path, log.start_timestamp / 1e6)
    if tail_s is not None and tail_s > end_s + LOST_S:
        what = f"damaged from here on; the file goes on for {tail_s - end_s:.1f} s"
        findings.append(LogFinding.at(end_s, what, "what came before is used"))
    if log.dropouts:
        lost_s = sum(drop.duration for drop in log.dropouts) / 1000.0
        first_s = log.dropouts[0].timestamp / 1e6
        what = f"{len(log.dropouts)} dropouts, {lost_s:.1f} s in all"
        findings.append(LogFinding.at(first_s, what, "what was believed ages meanwhile"))
    return log, findings


def _tail_s(path: Path, start_s: float) -> float | None:
    """Time of the last data messages in the file, by their headers; `None` where none is whole.

    pyulog ends without a word at a header whose size was damaged.
    """
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - TAIL_BYTES))
        raw = file.read()
    times: list[float] = []
    for at in range(len(raw) - DATA.size):
        size, kind, number, stamp_us = DATA.unpack_from(raw, at)
        t_s = stamp_us / 1e6
        if (
            kind == ord("D")
            and 10 <= size < 4096
            and number < 1024
            and 0.0 <= t_s - start_s < DAY_S
        ):
            times.append(t_s)
    middle = sorted(times)[len(times) // 2] if times else None
    return middle if len(times) >= 3 else None


def _topics(log: Any, path: Path, findings: list[LogFinding]) -> dict[str, list[Rows]]:
    """Return the rows of each topic, one entry an instance, with times in seconds that rise."""
    found: dict[str, list[Rows]] = {}
    stamped: list[tuple[Any, Floats, NDArray[np.intp]]] = []
    for data in log.data_list:
        if "timestamp" in data.data:
            stamped.append((data, *_in_order(data, findings)))
        else:
            findings.append(LogFinding("log", f"{data.name}: no field 'timestamp'", "left out"))
    start_s = log.start_timestamp / 1e6 - 1.0
    end_s = _end_s([t_s[rows] for _, t_s, rows in stamped])
    for data, t_s, rows in stamped:
        least_s = LEAST_STEP_S.get(data.name, 0.0)
        sound = rows[(t_s[rows] >= start_s) & (t_s[rows] <= end_s)]
        reported = np.isfinite(t_s)
        if data.name in SELDOM:
            reported[rows[t_s[rows] < start_s]] = False
        reported[sound] = False
        if reported.any():
            findings.append(_strays(data, path, t_s, sound, np.flatnonzero(reported)))
        kept = sound[_apart(t_s[sound], least_s)]
        columns = {name: _numbers(values[kept]) for name, values in data.data.items()}
        columns["instance"] = np.full(kept.size, data.multi_id)
        found.setdefault(data.name, []).append(columns | {"t_s": t_s[kept]})
    return found


def _in_order(data: Any, findings: list[LogFinding]) -> tuple[Floats, NDArray[np.intp]]:
    """Times (s) of a topic's rows, and which rows rise; a clock that was set back is laid on."""
    t_s = data.data["timestamp"].astype(float) / 1e6
    rows = rising_rows(t_s)
    if t_s.size - rows.size > max(MOST_STRAY, MOST_STRAY_FRAC * t_s.size):
        time = running_time(t_s, lambda row: f"{data.name}: row {row}")
        findings += time.findings
        rows = time.kept
        t_s = np.full(t_s.size, math.nan)
        t_s[rows] = time.t_s
    return t_s, rows


def _end_s(times: list[Floats]) -> float:
    """When the log ends; a stamp or so of each topic, alone behind a gap, is no part of it."""
    merged = np.sort(np.concatenate([*times, [-math.inf]]))
    for last in np.flatnonzero(np.diff(merged) > LEAP_S)[::-1]:
        if merged.size - 1 - last > len(times):
            break
        merged = merged[: last + 1]
    return float(merged[-1])


def _strays(
    data: Any, path: Path, t_s: Floats, sound: NDArray[np.intp], strays: NDArray[np.intp]
) -> LogFinding:
    """One finding for a topic's stray stamps. The row is counted in the file, without thinning."""
    first = int(strays[0])
    before = sound[sound < first][-1:]
    raw, row, at = path.read_bytes(), -1, 0
    for near in (*before.tolist(), first):
        stamp_us = int(data.data["timestamp"][near])
        at = max(raw.find(DATA.pack(0, ord("D"), data.msg_id, stamp_us)[2:], at) - 2, 0)
        row = raw.count(raw[at : at + 5], 0, at)
    when_s = float(t_s[before[0] if before.size else sound[0]]) if sound.size else 0.0
    return stray_stamps(when_s, data.name, row, float(t_s[first]), strays.size)


def _numbers(values: NDArray[Any]) -> NDArray[Any]:
    """The column with its floats as doubles; damaged bytes make signalling NaN, which is NaN."""
    with np.errstate(invalid="ignore"):
        return values.astype(float) if values.dtype.kind == "f" else values


def _apart(t_s: Floats, least_step_s: float) -> list[int]:
    """Of rows in order, those to use: none repeated, and no nearer than `least_step_s`."""
    kept: list[int] = []
    last_s = -math.inf
    for row, now_s in enumerate(t_s.tolist()):
        if now_s - last_s >= least_step_s and now_s > last_s:
            kept.append(row)
            last_s = now_s
    return kept


def _attitudes(rows: Rows) -> list[Event]:
    w, x, y, z = (rows[f"q[{k}]"].astype(float) for k in range(4))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    unit = np.abs(w * w + x * x + y * y + z * z - 1.0) < 0.01
    return [
        Attitude(*values)
        for values, good in zip(_lists(rows["t_s"], roll, pitch, yaw), unit.tolist(), strict=True)
        if good
    ]


def _positions(topics: dict[str, list[Rows]], findings: list[LogFinding]) -> list[Event]:
    """Velocities of the local position with the place of the global one (or the local frame's)."""
    local = topics.get("vehicle_local_position", [])
    if not local:
        findings.append(LogFinding("log", "no vehicle_local_position", "no velocity, so no wind"))
        return []
    rows = local[0]
    place = _places(rows, topics.get("vehicle_global_position", []))
    if place is None:
        what = "no vehicle_global_position and no reference of the local one"
        findings.append(LogFinding("log", what, "no position, so no wind"))
        return []
    lat, lon, alt = place
    rel = alt - _home_m(topics, alt)
    good = np.isfinite(lat + lon + alt)
    for name in ("v_xy_valid", "v_z_valid"):
        good &= rows.get(name, np.ones(good.size)) > 0
    velocity = [rows[name].astype(float) for name in ("vx", "vy", "vz")]
    good &= np.isfinite(velocity).all(axis=0)
    columns = _lists(rows["t_s"], lat, lon, alt, rel, *velocity)
    return [Position(*row) for row, use in zip(columns, good.tolist(), strict=True) if use]


def _places(local: Rows, fused: list[Rows]) -> tuple[Floats, Floats, Floats] | None:
    """Latitude, longitude (degrees) and height AMSL (m) at the local position's times."""
    if fused and fused[0]["t_s"].size > 1:
        rows = fused[0]
        lat, lon = rows["lat"].astype(float), rows["lon"].astype(float)
        if np.nanmax(np.abs(lat)) > 90.0:  # before 1.9 they were 1e-7 degrees
            lat, lon = 1e-7 * lat, 1e-7 * lon
        t_s = local["t_s"]
        columns = (lat, lon, rows["alt"].astype(float))
        lat_deg, lon_deg, alt_m = (np.interp(t_s, rows["t_s"], column) for column in columns)
        known = (t_s >= rows["t_s"][0]) & (t_s <= rows["t_s"][-1] + 1.0)
        return np.where(known, lat_deg, np.nan), lon_deg, alt_m
    reference = np.stack([local[name].astype(float) for name in ("ref_lat", "ref_lon", "ref_alt")])
    known = np.isfinite(reference).all(axis=0) & (np.abs(reference[:2]).sum(axis=0) > 0.0)
    if not known.any():
        return None
    lat_0, lon_0, alt_0 = reference
    lat, lon = moved_deg(lat_0, lon_0, local["x"].astype(float), local["y"].astype(float))
    return np.where(known, lat, np.nan), lon, alt_0 - local["z"]


def _home_m(topics: dict[str, list[Rows]], alt_m: Floats) -> float:
    """Height AMSL of home: as set, else where the log's position begins."""
    for rows in topics.get("home_position", [])[:1]:
        if rows["alt"].size and np.isfinite(rows["alt"][-1]):
            return float(rows["alt"][-1])
    known = alt_m[np.isfinite(alt_m)]
    return float(known[0]) if known.size else 0.0


def _states(rows: Rows) -> list[Event]:
    failsafe = rows.get("failsafe", np.zeros(rows["t_s"].size))
    events: list[Event] = []
    columns = _lists(rows["t_s"], rows["arming_state"], rows["nav_state"], failsafe)
    for t_s, arming, nav, failing in columns:
        mode, name = MODES.get(int(nav), (Mode.OTHER, f"nav_state {int(nav)}"))
        armed = int(arming) == ARMED
        events.append(VehicleState(t_s, mode, name, armed=armed, failsafe=bool(failing)))
    return events


def _grounds(rows: Rows) -> list[Event]:
    return [
        GroundState(t_s, Ground.ON_GROUND if landed else Ground.IN_AIR)
        for t_s, landed in _lists(rows["t_s"], rows["landed"])
    ]


def _fixes(rows: Rows) -> list[Event]:
    used = rows.get("satellites_used", np.full(rows["t_s"].size, 255))
    return [
        GnssFix(t_s, fix >= 3, None if count >= 255 else int(count))
        for t_s, fix, count in _lists(rows["t_s"], rows["fix_type"], used)
    ]


def _batteries(rows: Rows) -> list[Event]:
    """0 V, -1 A, -1 mAh, -1 and NaN are unknown; without a current a count of 0 says nothing."""
    unknown = np.full(rows["t_s"].size, np.nan)
    names = ("instance", "voltage_v", "current_a", "discharged_mah", "remaining", "temperature")
    events: list[Event] = []
    for t_s, instance, voltage, current, used, remaining, warm in _lists(
        rows["t_s"], *(rows.get(name, unknown) for name in names)
    ):
        measured = math.isfinite(current) and current >= 0.0
        events.append(
            Battery(
                t_s,
                voltage_v=voltage if math.isfinite(voltage) and voltage > 0.0 else None,
                current_a=current if measured else None,
                consumed_ah=used / 1000.0 if measured and used >= 0.0 else None,
                remaining_frac=remaining if 0.0 <= remaining <= 1.0 else None,
                temperature_c=warm if math.isfinite(warm) and warm != 0.0 else None,
                pack=int(instance),
            )
        )
    return events


def _airspeeds(rows: Rows) -> list[Event]:
    source = rows.get("airspeed_source", rows.get("selected_airspeed_index"))
    if source is None:
        return []
    return [
        Airspeed(t_s, speed)
        for t_s, speed, index in _lists(rows["t_s"], rows["true_airspeed_m_s"], source)
        if int(index) in SENSORS and math.isfinite(speed) and speed >= 0.0
    ]


def _winds(rows: Rows) -> list[Event]:
    """EKF2's own wind, where it moves to; it is estimated while its variance is above 0."""
    events: list[Event] = []
    names = ("windspeed_north", "windspeed_east", "variance_north", "variance_east")
    for t_s, north, east, var_n, var_e in _lists(rows["t_s"], *(rows[name] for name in names)):
        if math.isfinite(north + east) and var_n > 0.0 and var_e > 0.0:
            events.append(AutopilotWind(t_s, north, east, math.sqrt(0.5 * (var_n + var_e))))
    return events


def _homes(rows: Rows) -> list[Event]:
    columns = _lists(rows["t_s"], rows["lat"], rows["lon"], rows["alt"])
    return [Home(*row) for row in columns if all(map(math.isfinite, row))]


def _progress(rows: Rows) -> list[Event]:
    return [
        MissionProgress(t_s, int(index), int(total))
        for t_s, index, total in _lists(rows["t_s"], rows["seq_current"], rows["seq_total"])
        if total > 0
    ]


_TAKERS: dict[str, Callable[[Rows], list[Event]]] = {
    "vehicle_status": _states,
    "vehicle_land_detected": _grounds,
    "vehicle_gps_position": _fixes,
    "battery_status": _batteries,
    "airspeed_validated": _airspeeds,
    "home_position": _homes,
    "mission_result": _progress,
}


def _lists(*columns: NDArray[Any]) -> list[tuple[float, ...]]:
    """Rows of plain floats."""
    return list(zip(*(column.astype(float).tolist() for column in columns), strict=True))


def _firmware(log: Any) -> str | None:
    raw = log.msg_info_dict.get("ver_sw_release")
    if isinstance(raw, int):
        return f"{raw >> 24 & 255}.{raw >> 16 & 255}.{raw >> 8 & 255}"
    version = log.msg_info_dict.get("ver_sw")
    return safe_text(version) if isinstance(version, str) else None
