"""Detects columns in wrong units by physics: a multirotor accelerates in the direction of its tilt.

Averaged over a second, a multirotor's horizontal acceleration is `g` times its tilt, within the
effect of drag. Angles in radians under a name in degrees change that ratio by 57, velocities in
cm/s by 100: far more than wind or a noisy log can.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.analysis.replay.recorded_flight import LogIssue
from companion.core.base.arrays import Floats
from companion.core.vehicle.power import GRAVITY_MPS2

Columns = dict[str, Floats]

_AVERAGING_S = 1.0
_WRONG_RATIO = 10.0
_MAX_TILT_RAD = 1.7
_MAX_ACCEL_MPS2 = 8.0
_MIN_CORRELATION_GAIN = 0.3
_LEAST_ROWS = 100
_MOST_ROWS = 20_000

TIME_UNITS = ((5e6, 1e-9, "nanoseconds"), (5e3, 1e-6, "microseconds"), (10.0, 1e-3, "milliseconds"))
"""Median step from which stamps are in this unit: flights are not logged once in ten seconds."""


@dataclass(frozen=True, slots=True)
class _Motion:
    """Accelerations (n, 2: north, east) and tilts as logged (n, 2: roll, pitch), smoothed."""

    accel_mps2: Floats
    tilt: Floats
    yaw: Floats


def convert_wrong_units_in_place(columns: Columns) -> list[LogIssue]:
    """Convert columns in place that are certainly in another unit; return the findings."""
    found = _convert_time_to_s_in_place(columns["t_s"])
    motion = _smoothed_motion(columns)
    if motion is not None:
        found += _convert_motion_units_in_place(columns, motion)
    found += _convert_in_place_if_median_too_high(columns, "voltage_v", 200.0, 1e-3, "millivolts")
    found += _convert_in_place_if_median_too_high(columns, "remaining_frac", 1.5, 1e-2, "per cent")
    return found


def _convert_time_to_s_in_place(t_s: Floats) -> list[LogIssue]:
    steps = np.diff(t_s[np.isfinite(t_s)])
    rising = steps[steps > 0.0]
    median_step = float(np.median(rising)) if rising.size else 0.0
    for least, factor, unit in TIME_UNITS:
        if median_step >= least:
            t_s *= factor
            description = f"usual step {median_step:.0f}: these are {unit}, seconds expected"
            return [LogIssue("column t_s", description, "converted")]
    return []


def _convert_in_place_if_median_too_high(
    columns: Columns, name: str, highest_plausible_median: float, factor: float, unit: str
) -> list[LogIssue]:
    values = columns.get(name)
    if (
        values is None
        or not np.isfinite(values).any()
        or np.nanmedian(values) <= highest_plausible_median
    ):
        return []
    description = f"usual value {np.nanmedian(values):g}: these are {unit}"
    values *= factor
    return [LogIssue(f"column {name}", description, "converted")]


def _convert_motion_units_in_place(columns: Columns, motion: _Motion) -> list[LogIssue]:
    found: list[LogIssue] = []
    accel = float(np.std(motion.accel_mps2))
    ratio = accel / (GRAVITY_MPS2 * math.radians(float(np.std(motion.tilt))))
    tilt = motion.tilt
    if ratio > _WRONG_RATIO:
        most = max(float(np.nanmax(np.abs(columns[name]))) for name in ("roll_deg", "pitch_deg"))
        in_radians = most < _MAX_TILT_RAD and accel < _MAX_ACCEL_MPS2
        if in_radians:
            tilt = np.degrees(tilt)
            found.append(
                _convert_columns_in_place(columns, ("roll_deg", "pitch_deg"), np.degrees, "radians")
            )
        else:
            names = ("vel_n_mps", "vel_e_mps", "vel_d_mps")
            found.append(_convert_columns_in_place(columns, names, lambda x: 0.01 * x, "cm/s"))
    if float(np.nanmax(np.abs(columns["yaw_deg"]))) <= 2.0 * math.pi + 0.01:
        right = _acceleration_tilt_correlation(motion.accel_mps2, tilt, motion.yaw)
        if (
            right
            > _acceleration_tilt_correlation(motion.accel_mps2, tilt, np.radians(motion.yaw))
            + _MIN_CORRELATION_GAIN
        ):
            found.append(_convert_columns_in_place(columns, ("yaw_deg",), np.degrees, "radians"))
    return found


def _convert_columns_in_place(
    columns: Columns, names: tuple[str, ...], convert: Callable[[Floats], Floats], unit: str
) -> LogIssue:
    for name in names:
        columns[name] = convert(columns[name])
    description = f"these are {unit}: tilt and acceleration are inconsistent otherwise"
    return LogIssue(f"columns {', '.join(names)}", description, "converted")


def _acceleration_tilt_correlation(accel_mps2: Floats, tilt: Floats, yaw_rad: Floats) -> float:
    """Return the correlation of the acceleration with the tilt's prediction for this heading."""
    forward, right = -tilt[:, 1], tilt[:, 0]
    north = forward * np.cos(yaw_rad) - right * np.sin(yaw_rad)
    east = forward * np.sin(yaw_rad) + right * np.cos(yaw_rad)
    predicted = np.concatenate([north - north.mean(), east - east.mean()])
    measured = np.concatenate([column - column.mean() for column in accel_mps2.T])
    return float(
        np.dot(predicted, measured)
        / max(np.linalg.norm(predicted) * np.linalg.norm(measured), 1e-12)
    )


def _smoothed_motion(columns: Columns) -> _Motion | None:
    """Return smoothed accelerations and tilts; `None` if the log has too few."""
    names = ("t_s", "vel_n_mps", "vel_e_mps", "roll_deg", "pitch_deg", "yaw_deg")
    if any(name not in columns for name in names):
        return None
    table = np.stack([columns[name] for name in names])
    table = table[:, np.isfinite(table).all(axis=0)][:, :_MOST_ROWS]
    if table.shape[1] < _LEAST_ROWS:
        return None
    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(table[0])) > 0.0])
    table = table[:, rising]
    if table.shape[1] < _LEAST_ROWS:
        return None
    t_s = table[0]
    later = np.searchsorted(t_s, t_s + _AVERAGING_S)
    near = (later < t_s.size) & (t_s[np.minimum(later, t_s.size - 1)] < t_s + 2.0 * _AVERAGING_S)
    first, last = np.flatnonzero(near), later[near]
    if first.size < _LEAST_ROWS:
        return None
    accel = (table[1:3, last] - table[1:3, first]) / (t_s[last] - t_s[first])
    total = np.concatenate([np.zeros((2, 1)), np.cumsum(table[3:5], axis=1)], axis=1)
    tilt = (total[:, last] - total[:, first]) / (last - first)
    if float(np.std(accel)) < 0.05 or float(np.std(tilt)) <= 0.0:
        return None
    return _Motion(accel.T, tilt.T, table[5, (first + last) // 2])
