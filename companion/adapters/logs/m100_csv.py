"""CSV telemetry of the M100 field flights (Rodrigues et al., Scientific Data 8, 155, 2021).

One file a flight, `time, wind_speed, wind_angle, battery_voltage, ..., linear_acceleration_z`, at 5
to 10 Hz. What was found on 132 of them:

- **Axes.** The quaternion turns body axes RIGHT, FORWARD, UP into EAST, NORTH, UP; heading 0 is
  north. `velocity_*` lies along those tilted body axes, and the quaternion's rotation brings it
  within 0.2 m/s of the position's derivative. `angular_*` and `linear_acceleration_*` are in other
  axes (forward, right, down; specific force) and are not needed.
- **Places.** `position_x` is the longitude, `position_y` the latitude, `position_z` height above
  sea level. Height wanders by some metres over a flight.
- **Clock.** `time` is s from the log's start, position and velocity agree within 0.05 s. The
  anemometer's reading follows the ground speed 0.7 s late: it is set back by that.
- **Anemometer.** `wind_speed` is the magnitude of the air past the vehicle. On the ground it is in
  the rotors' wash and left out. `wind_angle` errs by up to 32 degrees with heading: not used.
- **Power.** Voltage and current jump for single samples. Such samples are unknown.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

from companion.adapters.logs.csv_table import CsvTable
from companion.adapters.logs.log_time import told
from companion.adapters.logs.log_units import Columns
from companion.core.base.arrays import Bools, Floats
from companion.core.base.errors import LeewayError
from companion.core.replay.recorded_flight import LogFinding

QUATERNION = ("orientation_x", "orientation_y", "orientation_z", "orientation_w")
VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
POSITION = ("position_y", "position_x", "position_z")
POWER = ("battery_voltage", "battery_current")
REQUIRED = ("time", *POSITION, *VELOCITY, *QUATERNION)
KNOWN = (*REQUIRED, *POWER, "wind_speed")

ANEMOMETER_LATE_S = 0.7
"""Median over the flights of the lag at which wind_speed follows ground speed best."""
_LEAST_NORM, _MOST_NORM = 0.98, 1.02
_JUMP_A, _JUMP_V = 8.0, 1.0
"""Off the median of the five samples about it: gusts move power over several samples."""
_MEDIAN_OF = 5
_FLYING_A = 8.0
"""The vehicle hovers at 17 A or more, and stands at less than 2 A; in descent it draws over 10."""
_PAUSE_S = 3.0
_LIFTED_M = 0.5
_TAKE_OFF_S, _TAKE_OFF_M = 10.0, 5.0
_FRESH_S = 1.0


def is_m100_csv(header: tuple[str, ...]) -> bool:
    """Tell this layout by its columns."""
    return all(name in header for name in (*QUATERNION, "velocity_x", "time"))


def read_m100_table(path: Path) -> CsvTable:
    """The file in the columns of our own CSV (docs/how-to/replay-a-log.md).

    LeewayError where columns or rows are missing.
    """
    table = CsvTable.read(path, REQUIRED, KNOWN)
    raw = table.columns
    if np.count_nonzero(np.isfinite(raw["time"])) < 2:
        raise LeewayError(f"{path}: line 2: {len(table.lines)} rows with a time; a flight has more")
    for name, most in zip(POWER, (_JUMP_V, _JUMP_A), strict=True):
        table.findings += _leave_jumps_out(table, name, most)
    columns = {"t_s": raw["time"], **_motion(raw)}
    for name, own in (("battery_voltage", "voltage_v"), ("battery_current", "current_a")):
        if name in raw:
            columns[own] = raw[name]
    for name, own in zip(POSITION, ("lat_deg", "lon_deg", "alt_m"), strict=True):
        columns[own] = raw[name]
    if "battery_current" in raw:
        columns["armed"] = _in_the_air(raw).astype(float)
    if "wind_speed" in raw:
        columns["airspeed_mps"] = _airspeed_mps(raw, columns.get("armed"))
    bad = _bad_attitudes(raw)
    if bad.any():
        what = "the quaternion's length is not 1"
        table.findings.append(told(np.flatnonzero(bad).tolist(), table.where, what, "left out"))
    table.findings += _ground_wash(columns)
    return CsvTable(columns, table.lines, table.findings)


def _leave_jumps_out(table: CsvTable, name: str, most: float) -> list[LogFinding]:
    """Make single samples unknown that stand far off their neighbours."""
    values = table.columns.get(name)
    if values is None or len(values) < _MEDIAN_OF:
        return []
    middle = median_filter(_filled(values), _MEDIAN_OF, mode="nearest")
    wrong = np.flatnonzero(np.abs(values - middle) > most)
    if not wrong.size:
        return []
    values[wrong] = np.nan
    what = f"{name} jumps by more than {most:g} from its neighbours"
    return [told(wrong.tolist(), table.where, what, "taken as unknown")]


def _motion(raw: Columns) -> Columns:
    """Velocity in NED and Euler angles of forward-right-down axes, from the layout's own."""
    turn = _rotation(raw)
    body = np.stack([raw[name] for name in VELOCITY])
    east, north, up = np.einsum("ijn,jn->in", turn, body)
    return {
        "vel_n_mps": north,
        "vel_e_mps": east,
        "vel_d_mps": -up,
        "roll_deg": np.degrees(np.arctan2(-turn[2, 0], turn[2, 2])),
        "pitch_deg": np.degrees(np.arcsin(np.clip(turn[2, 1], -1.0, 1.0))),
        "yaw_deg": np.degrees(np.arctan2(turn[0, 1], turn[1, 1])),
    }


def _rotation(raw: Columns) -> Floats:
    """(3, 3, n) from body (right, forward, up) to east, north, up; NaN for a bad quaternion."""
    quaternion = np.stack([raw[name] for name in QUATERNION])
    norm = np.linalg.norm(quaternion, axis=0)
    norm[_bad_attitudes(raw)] = np.nan
    x, y, z, w = quaternion / norm
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _bad_attitudes(raw: Columns) -> Bools:
    norm = np.linalg.norm(np.stack([raw[name] for name in QUATERNION]), axis=0)
    return (norm < _LEAST_NORM) | (norm > _MOST_NORM)


def _in_the_air(raw: Columns) -> Bools:
    """Rows from the first lift to the last under power; pauses of telemetry or power are bridged.

    Under power on the ground before it rises does not count.
    """
    current = median_filter(_filled(raw["battery_current"]), _MEDIAN_OF, mode="nearest")
    powered = _bridged(raw["time"], current > _FLYING_A)
    height = _filled(raw["position_z"])
    lifted = np.abs(height - height[0]) > _LIFTED_M
    flying = np.zeros_like(powered)
    for first, last in _runs(powered):
        off = np.flatnonzero(lifted[first : last + 1])
        if first == 0 and not _climbs_at_once(raw["time"], height):
            off = np.array([0])
        if off.size:
            flying[first + off[0] : last + 1] = True
    return flying


def _climbs_at_once(t_s: Floats, height_m: Floats) -> bool:
    """Tell a log that begins with the take-off from one that begins in a hover."""
    soon = t_s <= t_s[np.isfinite(t_s)][0] + _TAKE_OFF_S
    return bool(np.ptp(height_m[soon]) > _TAKE_OFF_M)


def _bridged(t_s: Floats, powered: Bools) -> Bools:
    """Power that comes back within _PAUSE_S had not gone; less than that of power is none."""
    out = powered.copy()
    runs = _runs(powered)
    for (_, end), (begin, _) in pairwise(runs):
        if t_s[begin] - t_s[end] <= _PAUSE_S:
            out[end:begin] = True
    for first, last in _runs(out):
        if t_s[last] - t_s[first] < _PAUSE_S:
            out[first : last + 1] = False
    return out


def _runs(mask: Bools) -> list[tuple[int, int]]:
    """First and last index of each stretch that is true."""
    steps = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(int)))
    return [(int(a), int(b) - 1) for a, b in zip(steps[::2], steps[1::2], strict=True)]


def _airspeed_mps(raw: Columns, flying: Floats | None) -> Floats:
    """The anemometer's magnitude at the time that it belongs to; unknown on the ground."""
    t_s, reading = raw["time"], raw["wind_speed"]
    known = np.isfinite(reading) & np.isfinite(t_s)
    if not known.any():
        return np.full_like(t_s, np.nan)
    measured_s = np.maximum.accumulate(t_s[known])
    later = t_s + ANEMOMETER_LATE_S
    speed = np.interp(later, measured_s, reading[known], right=np.nan)
    after = np.searchsorted(measured_s, later)
    before_s = measured_s[np.maximum(after - 1, 0)]
    stale = later - before_s > _FRESH_S
    speed[stale | (flying is not None and flying < 0.5)] = np.nan
    return speed


def _ground_wash(columns: Columns) -> list[LogFinding]:
    flying, air = columns.get("armed"), columns.get("airspeed_mps")
    if flying is None or air is None or flying.all():
        return []
    what = "wind_speed on the ground is the rotors' wash or the wind at 1 m"
    return [LogFinding("log", what, "left out")]


def _filled(values: Floats) -> Floats:
    """Unknown samples by interpolation over rows; zeros where nothing is known."""
    rows, known = np.arange(len(values)), np.isfinite(values)
    return np.interp(rows, rows[known], values[known]) if known.any() else np.zeros(len(values))
