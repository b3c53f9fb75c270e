"""Columns in wrong units, found out by physics: a multirotor accelerates where it leans.

Over a second or so the horizontal acceleration of a multirotor is `g` times its tilt, give or take
what the drag does. Angles in radians under a name that says degrees make that ratio 57, velocities
in cm/s make it 100: far from anything that a wind or a noisy log does.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.replay.recorded_flight import LogFinding
from companion.core.vehicle.power import GRAVITY_MPS2

Columns = dict[str, Floats]

_BASE_S = 1.0
_WRONG_RATIO = 10.0
_LEAST_TILT_RAD = 1.7
_MOST_ACCEL_MPS2 = 8.0
_CLEARLY_BETTER = 0.3
_LEAST_ROWS = 100
_MOST_ROWS = 20_000

TIME_UNITS = ((5e6, 1e-9, "nanoseconds"), (5e3, 1e-6, "microseconds"), (10.0, 1e-3, "milliseconds"))
"""Usual step from which stamps are in this unit: nobody logs a flight once in ten seconds."""


@dataclass(frozen=True, slots=True)
class _Motion:
    """Accelerations (n, 2: north, east) and tilts as logged (n, 2: roll, pitch), smoothed."""

    accel_mps2: Floats
    tilt: Floats
    yaw: Floats


def mend_units(columns: Columns) -> list[LogFinding]:
    """Set right in place what is certainly in another unit; returns what was found, in words."""
    found = _mend_time(columns["t_s"])
    motion = _motion(columns)
    if motion is not None:
        found += _mend_motion(columns, motion)
    found += _mend_simple(columns, "voltage_v", 200.0, 1e-3, "millivolts")
    found += _mend_simple(columns, "remaining_frac", 1.5, 1e-2, "per cent")
    return found


def _mend_time(t_s: Floats) -> list[LogFinding]:
    steps = np.diff(t_s[np.isfinite(t_s)])
    rising = steps[steps > 0.0]
    usual = float(np.median(rising)) if rising.size else 0.0
    for least, factor, unit in TIME_UNITS:
        if usual >= least:
            t_s *= factor
            what = f"usual step {usual:.0f}: these are {unit}, seconds expected"
            return [LogFinding("column t_s", what, "converted")]
    return []


def _mend_simple(
    columns: Columns, name: str, most: float, factor: float, unit: str
) -> list[LogFinding]:
    values = columns.get(name)
    if values is None or not np.isfinite(values).any() or np.nanmedian(values) <= most:
        return []
    what = f"usual value {np.nanmedian(values):g}: these are {unit}"
    values *= factor
    return [LogFinding(f"column {name}", what, "converted")]


def _mend_motion(columns: Columns, motion: _Motion) -> list[LogFinding]:
    found: list[LogFinding] = []
    accel = float(np.std(motion.accel_mps2))
    ratio = accel / (GRAVITY_MPS2 * math.radians(float(np.std(motion.tilt))))
    tilt = motion.tilt
    if ratio > _WRONG_RATIO:
        most = max(float(np.nanmax(np.abs(columns[name]))) for name in ("roll_deg", "pitch_deg"))
        in_radians = most < _LEAST_TILT_RAD and accel < _MOST_ACCEL_MPS2
        if in_radians:
            tilt = np.degrees(tilt)
            found.append(_convert(columns, ("roll_deg", "pitch_deg"), np.degrees, "radians"))
        else:
            names = ("vel_n_mps", "vel_e_mps", "vel_d_mps")
            found.append(_convert(columns, names, lambda x: 0.01 * x, "cm/s"))
    if float(np.nanmax(np.abs(columns["yaw_deg"]))) <= 2.0 * math.pi + 0.01:
        right = _agreement(motion.accel_mps2, tilt, motion.yaw)
        if right > _agreement(motion.accel_mps2, tilt, np.radians(motion.yaw)) + _CLEARLY_BETTER:
            found.append(_convert(columns, ("yaw_deg",), np.degrees, "radians"))
    return found


def _convert(
    columns: Columns, names: tuple[str, ...], convert: Callable[[Floats], Floats], unit: str
) -> LogFinding:
    for name in names:
        columns[name] = convert(columns[name])
    what = f"these are {unit}: leaning and accelerating do not go together otherwise"
    return LogFinding(f"columns {', '.join(names)}", what, "converted")


def _agreement(accel_mps2: Floats, tilt: Floats, yaw_rad: Floats) -> float:
    """Correlation of the acceleration with what the tilt (any unit) says on this heading."""
    forward, right = -tilt[:, 1], tilt[:, 0]
    north = forward * np.cos(yaw_rad) - right * np.sin(yaw_rad)
    east = forward * np.sin(yaw_rad) + right * np.cos(yaw_rad)
    said = np.concatenate([north - north.mean(), east - east.mean()])
    seen = np.concatenate([column - column.mean() for column in accel_mps2.T])
    return float(np.dot(said, seen) / max(np.linalg.norm(said) * np.linalg.norm(seen), 1e-12))


def _motion(columns: Columns) -> _Motion | None:
    """Return what the checks look at; `None` where the log has too little of it."""
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
    later = np.searchsorted(t_s, t_s + _BASE_S)
    near = (later < t_s.size) & (t_s[np.minimum(later, t_s.size - 1)] < t_s + 2.0 * _BASE_S)
    first, last = np.flatnonzero(near), later[near]
    if first.size < _LEAST_ROWS:
        return None
    accel = (table[1:3, last] - table[1:3, first]) / (t_s[last] - t_s[first])
    total = np.concatenate([np.zeros((2, 1)), np.cumsum(table[3:5], axis=1)], axis=1)
    tilt = (total[:, last] - total[:, first]) / (last - first)
    if float(np.std(accel)) < 0.05 or float(np.std(tilt)) <= 0.0:
        return None
    return _Motion(accel.T, tilt.T, table[5, (first + last) // 2])
