"""Read a PX4 ULog (.ulg) with pyulog: topics become the events of PX4's telemetry."""

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
from companion.adapters.logs.log_time import (
    GAP_S,
    longest_non_decreasing_row_indices,
    make_time_monotonic,
    stamp_outlier_issue,
)
from companion.adapters.logs.ulog_faults import ARMED, FAULT_TOPICS, TopicRows, fault_starts
from companion.adapters.logs.ulog_filter import extract_topics_at_min_interval
from companion.analysis.replay.recorded_flight import LogIssue, RecordedFlight
from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import offset_position_deg
from companion.core.base.safe_text import safe_text
from companion.core.mission.events import (
    Airspeed,
    Attitude,
    AutopilotKind,
    AutopilotWind,
    Battery,
    Event,
    GnssFix,
    GroundState,
    Home,
    MissionProgress,
    Mode,
    Position,
    VehicleLandedState,
    VehicleState,
)
from companion.core.vehicle.airframe import MULTIROTOR

TOPICS = (
    "vehicle_attitude",
    "vehicle_local_position",
    "vehicle_global_position",
    "home_position",
    "mission_result",
    "vehicle_status",
    *FAULT_TOPICS,
    "vehicle_land_detected",
    "vehicle_gps_position",
    "battery_status",
    "airspeed_validated",
    "wind",
    "wind_estimate",
)
INFREQUENT_TOPICS = ("home_position", "mission_result")
"""Logged as last published, possibly long before the log's start."""

MIN_INTERVAL_S = {
    "vehicle_attitude": 0.045,
    "vehicle_local_position": 0.09,
    "vehicle_global_position": 0.09,
    "vehicle_gps_position": 0.19,
    "battery_status": 0.19,
    "airspeed_validated": 0.09,
    "wind": 0.4,
    "wind_estimate": 0.4,
}
"""Minimum interval between messages of a topic: about the stream rates requested in flight."""

MODES = {
    3: (Mode.MISSION, "AUTO.MISSION"),
    4: (Mode.HOLD, "AUTO.HOLD"),
    5: (Mode.RTL, "AUTO.RTL"),
    14: (Mode.GUIDED, "OFFBOARD"),
    17: (Mode.TAKEOFF, "AUTO.TAKEOFF"),
    18: (Mode.LAND, "AUTO.LAND"),
}
"""Mode by vehicle_status.nav_state."""

SENSORS = (1, 2, 3)
"""airspeed_validated from a sensor: 0 is ground speed less wind, 4 synthetic, -1 disabled."""

AIRFRAMES = {
    0: MULTIROTOR,
    1: "fixed wing",
    2: "VTOL",
    3: "VTOL",
    4: "VTOL",
    5: "rover",
    6: "rover",
}
"""Vehicle by CA_AIRFRAME, used if MAV_TYPE is not in the log."""


DATA_HEADER = struct.Struct("<HBHQ")
"""A data message: size, kind, subscription, and the time stamp that begins every topic."""

MAX_OUTLIER_FRAC, MAX_OUTLIERS = 0.05, 3.0
"""Limits for outliers in a topic's stamps; if more are out of order, its clock stepped back."""

TAIL_BYTES, MIN_LOST_TAIL_S, DAY_S = 4096, 2.0, 86_400.0
MAX_READS_PER_BYTE = 8


def read_ulog(path: Path) -> RecordedFlight:
    """Read a .ulg; LeewayError for another format, or if pyulog is not installed."""
    log, findings = _read_ulog_and_issues(path)
    topics = _rows_by_topic(log, path, findings)
    values: dict[str, Any] = dict(log.initial_parameters)
    for _, name, value in log.changed_parameters:
        values[name] = value
    vehicle = vehicle_kind(values.get("MAV_TYPE", -1)) or AIRFRAMES.get(
        values.get("CA_AIRFRAME", -1)
    )
    converters = dict(_CONVERTERS)
    if values.get("EKF2_DRAG_CTRL") or vehicle not in (MULTIROTOR, None):
        converters |= {"wind": _wind_events, "wind_estimate": _wind_events}
    events = _events_of_topic(topics, "vehicle_attitude", _attitude_events, findings)
    events += _convert_or_report("position", lambda: _position_events(topics, findings), findings)
    for name, convert in converters.items():
        events += _events_of_topic(topics, name, convert, findings)
    events.sort(key=lambda event: event.t_s)
    if not events:
        raise LeewayError(f"{path}: none of {', '.join(TOPICS[:5])} in this ULog")
    return RecordedFlight(
        source="ulog",
        events=tuple(events),
        findings=tuple(findings),
        autopilot_kind=AutopilotKind.PX4,
        vehicle=vehicle,
        firmware=_firmware_version(log),
        autopilot_faults=fault_starts(topics),
    )


def _events_of_topic(
    topics: dict[str, list[TopicRows]],
    name: str,
    convert: Callable[[TopicRows], list[Event]],
    findings: list[LogIssue],
) -> list[Event]:
    """Return the events of a topic's first instance; for batteries, of each instance."""
    used = topics.get(name, [])[: None if name == "battery_status" else 1]
    return [
        e
        for rows in used
        for e in _convert_or_report(name, lambda rows=rows: convert(rows), findings)
    ]


def _convert_or_report(
    name: str, convert: Callable[[], list[Event]], findings: list[LogIssue]
) -> list[Event]:
    """Return a topic's events; none if its damaged definition lacks a field."""
    try:
        return convert()
    except KeyError as missing:
        findings.append(LogIssue("log", f"{name}: no field {missing}", "discarded"))
        return []


class _BoundedReader(io.BytesIO):
    """Bytes that stop a reader in an endless loop, which pyulog enters on some damaged files."""

    def __init__(self, raw: bytes) -> None:
        super().__init__(raw)
        self._left = MAX_READS_PER_BYTE * (len(raw) + 4096)

    def read(self, size: int | None = -1, /) -> bytes:
        """Read, unless several times the file's size was read already."""
        self._left -= 1 + (size or 0)
        if self._left < 0:
            raise RuntimeError("damaged definitions")
        return super().read(size)


def _read_ulog_and_issues(path: Path) -> tuple[Any, list[LogIssue]]:
    try:
        from pyulog import ULog
    except ImportError as error:
        raise LeewayError(
            f"{path}: reading ULog needs pyulog: pip install 'leeway-uas[replay]'"
        ) from error
    captured_output = io.StringIO()
    try:
        steps_s = {name: MIN_INTERVAL_S.get(name, 0.0) for name in TOPICS}
        filtered = extract_topics_at_min_interval(path.read_bytes(), steps_s)
        with contextlib.redirect_stdout(captured_output), _BoundedReader(filtered) as file:
            log = ULog(file, list(TOPICS))
    except Exception as error:
        raise LeewayError(f"{path}: damaged definitions, expected a ULog of PX4") from error
    findings: list[LogIssue] = []
    for line in dict.fromkeys(captured_output.getvalue().splitlines()):
        findings.append(LogIssue("file", line.strip(), "whole messages are used"))
    if log.file_corruption and not findings:
        findings.append(LogIssue("file", "damaged bytes", "whole messages are used"))
    end_s, tail_s = log.last_timestamp / 1e6, _last_message_time_s(path, log.start_timestamp / 1e6)
    if tail_s is not None and tail_s > end_s + MIN_LOST_TAIL_S:
        description = f"damaged after this; the file continues for {tail_s - end_s:.1f} s"
        findings.append(LogIssue.at_time(end_s, description, "data before this are used"))
    if log.dropouts:
        lost_s = sum(drop.duration for drop in log.dropouts) / 1000.0
        first_s = log.dropouts[0].timestamp / 1e6
        description = f"{len(log.dropouts)} dropouts, {lost_s:.1f} s in total"
        findings.append(LogIssue.at_time(first_s, description, "estimates age during the gap"))
    return log, findings


def _last_message_time_s(path: Path, start_s: float) -> float | None:
    """Return the time of the last data messages by their headers; `None` if none is whole.

    pyulog ends without an error at a header with a damaged size.
    """
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - TAIL_BYTES))
        raw = file.read()
    times: list[float] = []
    for at in range(len(raw) - DATA_HEADER.size):
        size, kind, number, stamp_us = DATA_HEADER.unpack_from(raw, at)
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


def _rows_by_topic(log: Any, path: Path, findings: list[LogIssue]) -> dict[str, list[TopicRows]]:
    """Return the rows of each topic, one entry per instance, with increasing times in seconds."""
    found: dict[str, list[TopicRows]] = {}
    stamped: list[tuple[Any, Floats, NDArray[np.intp]]] = []
    for data in log.data_list:
        if "timestamp" in data.data:
            stamped.append((data, *_ordered_times_and_rows(data, findings)))
        else:
            findings.append(LogIssue("log", f"{data.name}: no field 'timestamp'", "discarded"))
    start_s = log.start_timestamp / 1e6 - 1.0
    end_s = _log_end_s([t_s[rows] for _, t_s, rows in stamped])
    for data, t_s, rows in stamped:
        least_s = MIN_INTERVAL_S.get(data.name, 0.0)
        valid_rows = rows[(t_s[rows] >= start_s) & (t_s[rows] <= end_s)]
        reported = np.isfinite(t_s)
        if data.name in INFREQUENT_TOPICS:
            reported[rows[t_s[rows] < start_s]] = False
        reported[valid_rows] = False
        if reported.any():
            findings.append(
                _topic_outlier_issue(data, path, t_s, valid_rows, np.flatnonzero(reported))
            )
        kept = valid_rows[_row_indices_at_min_step(t_s[valid_rows], least_s)]
        columns = {name: _as_doubles(values[kept]) for name, values in data.data.items()}
        columns["instance"] = np.full(kept.size, data.multi_id)
        found.setdefault(data.name, []).append(columns | {"t_s": t_s[kept]})
    return found


def _ordered_times_and_rows(data: Any, findings: list[LogIssue]) -> tuple[Floats, NDArray[np.intp]]:
    """Return a topic's times (s) and its increasing rows; a step back is compensated."""
    t_s = data.data["timestamp"].astype(float) / 1e6
    rows = longest_non_decreasing_row_indices(t_s)
    if t_s.size - rows.size > max(MAX_OUTLIERS, MAX_OUTLIER_FRAC * t_s.size):
        time = make_time_monotonic(t_s, lambda row: f"{data.name}: row {row}")
        findings += time.findings
        rows = time.kept
        t_s = np.full(t_s.size, math.nan)
        t_s[rows] = time.t_s
    return t_s, rows


def _log_end_s(times_by_topic_s: list[Floats]) -> float:
    """Return the log's end; isolated stamps after a gap (about one per topic) are excluded."""
    merged = np.sort(np.concatenate([*times_by_topic_s, [-math.inf]]))
    for last in np.flatnonzero(np.diff(merged) > GAP_S)[::-1]:
        if merged.size - 1 - last > len(times_by_topic_s):
            break
        merged = merged[: last + 1]
    return float(merged[-1])


def _topic_outlier_issue(
    data: Any, path: Path, t_s: Floats, valid_rows: NDArray[np.intp], outlier_rows: NDArray[np.intp]
) -> LogIssue:
    """Return one finding for a topic's outliers. The row is counted in the unfiltered file."""
    first = int(outlier_rows[0])
    before = valid_rows[valid_rows < first][-1:]
    raw, row, at = path.read_bytes(), -1, 0
    for near in (*before.tolist(), first):
        stamp_us = int(data.data["timestamp"][near])
        at = max(raw.find(DATA_HEADER.pack(0, ord("D"), data.msg_id, stamp_us)[2:], at) - 2, 0)
        row = raw.count(raw[at : at + 5], 0, at)
    when_s = float(t_s[before[0] if before.size else valid_rows[0]]) if valid_rows.size else 0.0
    return stamp_outlier_issue(when_s, data.name, row, float(t_s[first]), outlier_rows.size)


def _as_doubles(values: NDArray[Any]) -> NDArray[Any]:
    """Convert floats to doubles; signalling NaN from damaged bytes become NaN."""
    with np.errstate(invalid="ignore"):
        return values.astype(float) if values.dtype.kind == "f" else values


def _row_indices_at_min_step(t_s: Floats, least_step_s: float) -> list[int]:
    """Return the rows to use: no repeated time, and `least_step_s` or more between them."""
    kept: list[int] = []
    last_s = -math.inf
    for row, now_s in enumerate(t_s.tolist()):
        if now_s - last_s >= least_step_s and now_s > last_s:
            kept.append(row)
            last_s = now_s
    return kept


def _attitude_events(rows: TopicRows) -> list[Event]:
    w, x, y, z = (rows[f"q[{k}]"].astype(float) for k in range(4))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    unit = np.abs(w * w + x * x + y * y + z * z - 1.0) < 0.01
    return [
        Attitude(*values)
        for values, good in zip(
            _rows_of_python_floats(rows["t_s"], roll, pitch, yaw), unit.tolist(), strict=True
        )
        if good
    ]


def _position_events(topics: dict[str, list[TopicRows]], findings: list[LogIssue]) -> list[Event]:
    """Return velocities of the local position with the global position (or the local frame's)."""
    local = topics.get("vehicle_local_position", [])
    if not local:
        findings.append(LogIssue("log", "no vehicle_local_position", "no velocity, so no wind"))
        return []
    rows = local[0]
    position = _global_positions(rows, topics.get("vehicle_global_position", []))
    if position is None:
        description = "no vehicle_global_position and no reference of the local one"
        findings.append(LogIssue("log", description, "no position, so no wind"))
        return []
    lat, lon, alt = position
    rel = alt - _home_alt_amsl_m(topics, alt)
    good = np.isfinite(lat + lon + alt)
    for name in ("v_xy_valid", "v_z_valid"):
        good &= rows.get(name, np.ones(good.size)) > 0
    velocity = [rows[name].astype(float) for name in ("vx", "vy", "vz")]
    good &= np.isfinite(velocity).all(axis=0)
    columns = _rows_of_python_floats(rows["t_s"], lat, lon, alt, rel, *velocity)
    return [Position(*row) for row, use in zip(columns, good.tolist(), strict=True) if use]


def _global_positions(
    local: TopicRows, global_position_topics: list[TopicRows]
) -> tuple[Floats, Floats, Floats] | None:
    """Return latitude, longitude (degrees) and height AMSL (m) at the local position's times."""
    if global_position_topics and global_position_topics[0]["t_s"].size > 1:
        rows = global_position_topics[0]
        lat, lon = rows["lat"].astype(float), rows["lon"].astype(float)
        if np.nanmax(np.abs(lat)) > 90.0:  # before PX4 1.9 the unit was 1e-7 degrees
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
    lat, lon = offset_position_deg(lat_0, lon_0, local["x"].astype(float), local["y"].astype(float))
    return np.where(known, lat, np.nan), lon, alt_0 - local["z"]


def _home_alt_amsl_m(topics: dict[str, list[TopicRows]], alt_m: Floats) -> float:
    """Return the height AMSL of home: as set, else the first position in the log."""
    for rows in topics.get("home_position", [])[:1]:
        if rows["alt"].size and np.isfinite(rows["alt"][-1]):
            return float(rows["alt"][-1])
    known = alt_m[np.isfinite(alt_m)]
    return float(known[0]) if known.size else 0.0


def _state_events(rows: TopicRows) -> list[Event]:
    failsafe = rows.get("failsafe", np.zeros(rows["t_s"].size))
    events: list[Event] = []
    columns = _rows_of_python_floats(rows["t_s"], rows["arming_state"], rows["nav_state"], failsafe)
    for t_s, arming, nav, failing in columns:
        mode, name = MODES.get(int(nav), (Mode.OTHER, f"nav_state {int(nav)}"))
        armed = int(arming) == ARMED
        events.append(VehicleState(t_s, mode, name, armed=armed, failsafe=bool(failing)))
    return events


def _ground_events(rows: TopicRows) -> list[Event]:
    return [
        GroundState(t_s, VehicleLandedState.ON_GROUND if landed else VehicleLandedState.IN_AIR)
        for t_s, landed in _rows_of_python_floats(rows["t_s"], rows["landed"])
    ]


def _gnss_events(rows: TopicRows) -> list[Event]:
    used = rows.get("satellites_used", np.full(rows["t_s"].size, 255))
    return [
        GnssFix(t_s, fix >= 3, None if count >= 255 else int(count))
        for t_s, fix, count in _rows_of_python_floats(rows["t_s"], rows["fix_type"], used)
    ]


def _battery_events(rows: TopicRows) -> list[Event]:
    """Read batteries: 0 V, -1 A, -1 mAh, -1 and NaN are unknown, as are counts without current."""
    unknown = np.full(rows["t_s"].size, np.nan)
    names = ("instance", "voltage_v", "current_a", "discharged_mah", "remaining", "temperature")
    events: list[Event] = []
    for t_s, instance, voltage, current, used, remaining, temperature_c in _rows_of_python_floats(
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
                temperature_c=temperature_c
                if math.isfinite(temperature_c) and temperature_c != 0.0
                else None,
                pack=int(instance),
            )
        )
    return events


def _airspeed_events(rows: TopicRows) -> list[Event]:
    source = rows.get("airspeed_source", rows.get("selected_airspeed_index"))
    if source is None:
        return []
    return [
        Airspeed(t_s, speed)
        for t_s, speed, index in _rows_of_python_floats(
            rows["t_s"], rows["true_airspeed_m_s"], source
        )
        if int(index) in SENSORS and math.isfinite(speed) and speed >= 0.0
    ]


def _wind_events(rows: TopicRows) -> list[Event]:
    """Read EKF2's wind (direction TO); it is valid while its variance is above 0."""
    events: list[Event] = []
    names = ("windspeed_north", "windspeed_east", "variance_north", "variance_east")
    for t_s, north, east, var_n, var_e in _rows_of_python_floats(
        rows["t_s"], *(rows[name] for name in names)
    ):
        if math.isfinite(north + east) and var_n > 0.0 and var_e > 0.0:
            events.append(AutopilotWind(t_s, north, east, math.sqrt(0.5 * (var_n + var_e))))
    return events


def _home_events(rows: TopicRows) -> list[Event]:
    columns = _rows_of_python_floats(rows["t_s"], rows["lat"], rows["lon"], rows["alt"])
    return [Home(*row) for row in columns if all(map(math.isfinite, row))]


def _progress_events(rows: TopicRows) -> list[Event]:
    return [
        MissionProgress(t_s, int(index), int(total))
        for t_s, index, total in _rows_of_python_floats(
            rows["t_s"], rows["seq_current"], rows["seq_total"]
        )
        if total > 0
    ]


_CONVERTERS: dict[str, Callable[[TopicRows], list[Event]]] = {
    "vehicle_status": _state_events,
    "vehicle_land_detected": _ground_events,
    "vehicle_gps_position": _gnss_events,
    "battery_status": _battery_events,
    "airspeed_validated": _airspeed_events,
    "home_position": _home_events,
    "mission_result": _progress_events,
}


def _rows_of_python_floats(*columns: NDArray[Any]) -> list[tuple[float, ...]]:
    """Return rows of plain floats."""
    return list(zip(*(column.astype(float).tolist() for column in columns), strict=True))


def _firmware_version(log: Any) -> str | None:
    raw = log.msg_info_dict.get("ver_sw_release")
    if isinstance(raw, int):
        return f"{raw >> 24 & 255}.{raw >> 16 & 255}.{raw >> 8 & 255}"
    version = log.msg_info_dict.get("ver_sw")
    return safe_text(version) if isinstance(version, str) else None
