"""CSV telemetry of the M100 field flights (Rodrigues et al., Scientific Data 8, 155, 2021).

One file per flight, `time, wind_speed, wind_angle, battery_voltage, ..., linear_acceleration_z`, at
5 to 10 Hz. Properties measured on 132 of them:

- **Axes.** The quaternion rotates body axes RIGHT, FORWARD, UP into EAST, NORTH, UP; heading 0 is
  north. `velocity_*` is in the tilted body axes; rotated by the quaternion it agrees within
  0.2 m/s with the position's derivative. `angular_*` and `linear_acceleration_*` are in other
  axes (forward, right, down; specific force) and are not used.
- **Position.** `position_x` is the longitude, `position_y` the latitude, `position_z` height above
  sea level. Height drifts by some metres over a flight.
- **Clock.** `time` is s from the log's start; position and velocity agree within 0.05 s. The
  anemometer lags the ground speed by 0.7 s; this lag is removed.
- **Anemometer.** `wind_speed` is the magnitude of the relative air speed. On the ground it is in
  the rotor wash and discarded. `wind_angle` errs by up to 32 degrees with heading: not used.
- **Power.** Voltage and current jump for single samples. Such samples are unknown.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

from companion.adapters.logs.csv_table import CsvTable
from companion.adapters.logs.log_time import summarise_rows_as_issue
from companion.adapters.logs.log_units import Columns
from companion.analysis.replay.recorded_flight import LogIssue
from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError

QUATERNION = ("orientation_x", "orientation_y", "orientation_z", "orientation_w")
VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
POSITION = ("position_y", "position_x", "position_z")
POWER = ("battery_voltage", "battery_current")
REQUIRED = ("time", *POSITION, *VELOCITY, *QUATERNION)
KNOWN = (*REQUIRED, *POWER, "wind_speed")

ANEMOMETER_LAG_S = 0.7
"""Median over the flights of the lag with the best correlation of wind_speed to ground speed."""
_LEAST_NORM, _MOST_NORM = 0.98, 1.02
_JUMP_A, _JUMP_V = 8.0, 1.0
"""Maximum deviation from the median of five samples: gusts change power over several samples."""
_MEDIAN_OF = 5
_AIRBORNE_A = 8.0
"""The vehicle hovers at 17 A or more and idles below 2 A; in descent it draws over 10 A."""
_PAUSE_S = 3.0
_LIFTED_M = 0.5
_TAKE_OFF_S, _TAKE_OFF_M = 10.0, 5.0
_MAX_READING_AGE_S = 1.0


def is_m100_csv(header: tuple[str, ...]) -> bool:
    """Return True if the columns are those of this layout."""
    return all(name in header for name in (*QUATERNION, "velocity_x", "time"))


def read_m100_table(path: Path) -> CsvTable:
    """Return the file in the columns of the project's CSV (docs/how-to/replay-a-log.md).

    Raises LeewayError if columns or rows are missing.
    """
    table = CsvTable.read(path, REQUIRED, KNOWN)
    raw = table.columns
    if np.count_nonzero(np.isfinite(raw["time"])) < 2:
        raise LeewayError(f"{path}: line 2: {len(table.lines)} rows with a time, expected 2")
    for name, most in zip(POWER, (_JUMP_V, _JUMP_A), strict=True):
        table.findings += _replace_jumps_by_nan(table, name, most)
    columns = {"t_s": raw["time"], **_ned_velocity_and_euler_deg(raw)}
    for name, own in (("battery_voltage", "voltage_v"), ("battery_current", "current_a")):
        if name in raw:
            columns[own] = raw[name]
    for name, own in zip(POSITION, ("lat_deg", "lon_deg", "alt_m"), strict=True):
        columns[own] = raw[name]
    if "battery_current" in raw:
        columns["armed"] = _airborne_mask(raw).astype(float)
    if "wind_speed" in raw:
        columns["airspeed_mps"] = _lag_corrected_airspeed_mps(raw, columns.get("armed"))
    bad = _invalid_quaternion_mask(raw)
    if bad.any():
        description = "the quaternion's length is not 1"
        table.findings.append(
            summarise_rows_as_issue(
                np.flatnonzero(bad).tolist(), table.line_text, description, "discarded"
            )
        )
    is_airborne, air = columns.get("armed"), columns.get("airspeed_mps")
    if is_airborne is not None and air is not None and not is_airborne.all():
        description = "wind_speed on the ground is the rotor wash or the wind at 1 m"
        table.findings.append(LogIssue("log", description, "discarded"))
    return CsvTable(columns, table.lines, table.findings)


def _replace_jumps_by_nan(table: CsvTable, name: str, max_deviation: float) -> list[LogIssue]:
    """Set single samples to unknown that differ strongly from their neighbours."""
    values = table.columns.get(name)
    if values is None or len(values) < _MEDIAN_OF:
        return []
    middle = median_filter(_interpolate_unknown(values), _MEDIAN_OF, mode="nearest")
    wrong = np.flatnonzero(np.abs(values - middle) > max_deviation)
    if not wrong.size:
        return []
    values[wrong] = np.nan
    description = f"{name} jumps by more than {max_deviation:g} from its neighbours"
    return [
        summarise_rows_as_issue(wrong.tolist(), table.line_text, description, "treated as unknown")
    ]


def _ned_velocity_and_euler_deg(raw: Columns) -> Columns:
    """Return velocity in NED and Euler angles of forward-right-down axes."""
    rotation = _body_to_enu_rotation(raw)
    body = np.stack([raw[name] for name in VELOCITY])
    east, north, up = np.einsum("ijn,jn->in", rotation, body)
    return {
        "vel_n_mps": north,
        "vel_e_mps": east,
        "vel_d_mps": -up,
        "roll_deg": np.degrees(np.arctan2(-rotation[2, 0], rotation[2, 2])),
        "pitch_deg": np.degrees(np.arcsin(np.clip(rotation[2, 1], -1.0, 1.0))),
        "yaw_deg": np.degrees(np.arctan2(rotation[0, 1], rotation[1, 1])),
    }


def _body_to_enu_rotation(raw: Columns) -> Floats:
    """Return (3, 3, n) from body (right, forward, up) to ENU; NaN for a bad quaternion."""
    quaternion = np.stack([raw[name] for name in QUATERNION])
    norm = np.linalg.norm(quaternion, axis=0)
    norm[_invalid_quaternion_mask(raw)] = np.nan
    x, y, z, w = quaternion / norm
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _invalid_quaternion_mask(raw: Columns) -> Bools:
    norm = np.linalg.norm(np.stack([raw[name] for name in QUATERNION]), axis=0)
    return (norm < _LEAST_NORM) | (norm > _MOST_NORM)


def _airborne_mask(raw: Columns) -> Bools:
    """Return rows from the first lift-off to the last under power, ignoring short pauses of data.

    Power on the ground before lift-off is not flight.
    """
    current = median_filter(
        _interpolate_unknown(raw["battery_current"]), _MEDIAN_OF, mode="nearest"
    )
    powered = _bridge_power_pauses(raw["time"], current > _AIRBORNE_A)
    height = _interpolate_unknown(raw["position_z"])
    lifted = np.abs(height - height[0]) > _LIFTED_M
    is_airborne = np.zeros_like(powered)
    t_s = raw["time"]
    initial = t_s <= t_s[np.isfinite(t_s)][0] + _TAKE_OFF_S
    begins_in_flight = not np.ptp(height[initial]) > _TAKE_OFF_M  # in a hover, not a take-off
    for first, last in _true_intervals(powered):
        off = np.flatnonzero(lifted[first : last + 1])
        if first == 0 and begins_in_flight:
            off = np.array([0])
        if off.size:
            is_airborne[first + off[0] : last + 1] = True
    return is_airborne


def _bridge_power_pauses(t_s: Floats, powered: Bools) -> Bools:
    """Bridge power pauses up to _PAUSE_S; discard shorter periods of power."""
    out = powered.copy()
    intervals = _true_intervals(powered)
    for (_, end), (begin, _) in pairwise(intervals):
        if t_s[begin] - t_s[end] <= _PAUSE_S:
            out[end:begin] = True
    for first, last in _true_intervals(out):
        if t_s[last] - t_s[first] < _PAUSE_S:
            out[first : last + 1] = False
    return out


def _true_intervals(mask: Bools) -> list[tuple[int, int]]:
    """Return first and last index of each true interval."""
    steps = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(int)))
    return [(int(a), int(b) - 1) for a, b in zip(steps[::2], steps[1::2], strict=True)]


def _lag_corrected_airspeed_mps(raw: Columns, airborne: Floats | None) -> Floats:
    """Return the anemometer's magnitude with its lag removed; unknown on the ground."""
    t_s, reading = raw["time"], raw["wind_speed"]
    known = np.isfinite(reading) & np.isfinite(t_s)
    if not known.any():
        return np.full_like(t_s, np.nan)
    measured_s = np.maximum.accumulate(t_s[known])
    later = t_s + ANEMOMETER_LAG_S
    speed = np.interp(later, measured_s, reading[known], right=np.nan)
    after = np.searchsorted(measured_s, later)
    before_s = measured_s[np.maximum(after - 1, 0)]
    stale = later - before_s > _MAX_READING_AGE_S
    speed[stale | (airborne is not None and airborne < 0.5)] = np.nan
    return speed


def _interpolate_unknown(values: Floats) -> Floats:
    """Interpolate unknown samples over rows; zeros if none is known."""
    rows, known = np.arange(len(values)), np.isfinite(values)
    return np.interp(rows, rows[known], values[known]) if known.any() else np.zeros(len(values))
