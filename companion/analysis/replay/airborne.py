"""Detection of flight from motion, for logs without an armed or landed state."""

import math

import numpy as np

from companion.core.base.arrays import Bools, Floats

_BIN_S = 1.0
_MAX_REST_SPEED_MPS = 0.25  # estimators' velocity noise at rest is under 0.15 m/s
_MAX_REST_TILT_STD_RAD = math.radians(
    0.15
)  # a hovering vehicle rocks more within a second or three
_MIN_REST_S = 4.0
_MIN_CLIMB_M = 1.0
_MAX_LANDED_HEIGHT_M = 3.0
_MIN_FLIGHT_SPEED_MPS = 4.0  # faster than a carried vehicle
_LONG_REST_S = 20.0
_MAX_MOTORS_OFF_TILT_STD_RAD = math.radians(0.05)


def airborne_mask_by_motion(
    t_s: Floats,
    vel_ned_mps: Floats,
    tilt_rad: Floats,
    height_m: Floats | None = None,
) -> Bools:
    """Return for each row whether the vehicle was in the air.

    `vel_ned_mps` (n, 3) and `tilt_rad` (n, 2: roll, pitch) may contain NaN; without a height,
    `height_m` is integrated from the vertical velocity. Take-off: motion a metre above the last
    position at rest, or high speed. Landing: rest near that height, or a long rest at any height. A
    log that starts in motion starts in flight.
    """
    bins = _Bins(t_s, vel_ned_mps, tilt_rad, height_m)
    is_airborne = not bins.is_at_rest(0, 3.0 * _BIN_S)
    ground_m, takeoff_height_m = bins.height_m[0], bins.height_m[0]
    out = np.zeros(bins.count, np.bool_)
    for i in range(bins.count):
        if not is_airborne:
            if bins.at_rest[i]:
                ground_m = bins.height_m[i]
            elif (
                bins.height_m[i] > ground_m + _MIN_CLIMB_M
                or bins.speed_mps[i] > _MIN_FLIGHT_SPEED_MPS
            ):
                is_airborne, takeoff_height_m = True, ground_m
        elif (
            bins.is_at_rest(i, _MIN_REST_S)
            and bins.height_m[i] < takeoff_height_m + _MAX_LANDED_HEIGHT_M
        ) or bins.has_motors_off(i, _LONG_REST_S):
            is_airborne, ground_m = False, bins.height_m[i]
        out[i] = is_airborne
    return out[bins.of_row]


class _Bins:
    """The flight in bins of one second: speed, tilt variation and height."""

    def __init__(
        self,
        t_s: Floats,
        vel_ned_mps: Floats,
        tilt_rad: Floats,
        height_m: Floats | None,
    ) -> None:
        self.of_row = ((t_s - t_s[0]) / _BIN_S).astype(int)
        # Bins without rows (gaps in the log) are skipped: number only the others.
        _, self.of_row = np.unique(self.of_row, return_inverse=True)
        self.count = int(self.of_row[-1]) + 1
        vel = np.nan_to_num(vel_ned_mps)
        self.speed_mps = self._mean_per_bin(np.linalg.norm(vel, axis=1))
        rocking = np.stack([self._std_per_bin(np.nan_to_num(tilt_rad[:, k])) for k in (0, 1)])
        self.tilt_std_rad = rocking.max(axis=0)
        height = height_from_vertical_velocity_m(t_s, vel[:, 2]) if height_m is None else height_m
        self.height_m = self._mean_per_bin(np.nan_to_num(height, nan=float(np.nanmean(height))))
        self.at_rest = (self.speed_mps < _MAX_REST_SPEED_MPS) & (
            self.tilt_std_rad < _MAX_REST_TILT_STD_RAD
        )

    def _mean_per_bin(self, values: Floats) -> Floats:
        rows = np.bincount(self.of_row, minlength=self.count)
        return np.bincount(self.of_row, values, self.count) / np.maximum(rows, 1)

    def _std_per_bin(self, values: Floats) -> Floats:
        mean = self._mean_per_bin(values)
        return np.sqrt(self._mean_per_bin((values - mean[self.of_row]) ** 2))

    def is_at_rest(self, first_bin: int, duration_s: float) -> bool:
        """Return whether the vehicle rests from this bin for `duration_s`, or to the log's end."""
        return bool(self.at_rest[first_bin : first_bin + max(1, round(duration_s / _BIN_S))].all())

    def has_motors_off(self, first_bin: int, duration_s: float) -> bool:
        """Return whether it also lacks the tilt variation of a hover in calm air."""
        bins = slice(first_bin, first_bin + max(1, round(duration_s / _BIN_S)))
        whole = first_bin + round(duration_s / _BIN_S) <= self.count
        quiet = bool((self.tilt_std_rad[bins] < _MAX_MOTORS_OFF_TILT_STD_RAD).all())
        return whole and quiet and self.is_at_rest(first_bin, duration_s)


def height_from_vertical_velocity_m(t_s: Floats, vel_d_mps: Floats) -> Floats:
    """Integrate the vertical velocity (down) to height above the first row (trapezoids)."""
    climb = -0.5 * (vel_d_mps[1:] + vel_d_mps[:-1])
    return np.concatenate([[0.0], np.cumsum(climb * np.diff(t_s))])
