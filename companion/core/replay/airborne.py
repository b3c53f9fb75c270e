"""When a vehicle flew, from its motion alone: for logs that do not say armed or landed."""

import math

import numpy as np

from companion.core.base.arrays import Bools, Floats

_BIN_S = 1.0
_STILL_MPS = 0.25  # estimators' velocity noise at rest is under 0.15 m/s
_STILL_TILT_RAD = math.radians(0.15)  # a hovering vehicle rocks more within a second or three
_REST_S = 4.0
_CLIMB_M = 1.0
_BACK_DOWN_M = 3.0
_FAST_MPS = 4.0  # nobody carries it at that speed
_LONG_REST_S = 20.0
_DEAD_TILT_RAD = math.radians(0.05)


def airborne(
    t_s: Floats,
    vel_ned_mps: Floats,
    tilt_rad: Floats,
    height_m: Floats | None = None,
) -> Bools:
    """Tell for each row whether the vehicle was in the air.

    `vel_ned_mps` (n, 3) and `tilt_rad` (n, 2: roll, pitch) may hold NaN; `height_m` is summed up
    from the vertical velocity where the log has none. It took off when it moves and is a metre
    above where it last rested (or is fast); it landed when it rests near that height, or anywhere
    for long. A log that begins in motion begins in the air.
    """
    bins = _Bins(t_s, vel_ned_mps, tilt_rad, height_m)
    flying = not bins.rests(0, 3.0 * _BIN_S)
    ground_m, took_off_m = bins.height_m[0], bins.height_m[0]
    out = np.zeros(bins.count, np.bool_)
    for i in range(bins.count):
        if not flying:
            if bins.still[i]:
                ground_m = bins.height_m[i]
            elif bins.height_m[i] > ground_m + _CLIMB_M or bins.speed_mps[i] > _FAST_MPS:
                flying, took_off_m = True, ground_m
        elif (bins.rests(i, _REST_S) and bins.height_m[i] < took_off_m + _BACK_DOWN_M) or bins.dead(
            i, _LONG_REST_S
        ):
            flying, ground_m = False, bins.height_m[i]
        out[i] = flying
    return out[bins.of_row]


class _Bins:
    """The flight in bins of a second: motion, rocking and height of each."""

    def __init__(
        self,
        t_s: Floats,
        vel_ned_mps: Floats,
        tilt_rad: Floats,
        height_m: Floats | None,
    ) -> None:
        self.of_row = ((t_s - t_s[0]) / _BIN_S).astype(int)
        # Bins without rows (gaps in the log) take no part: number only those that have some.
        _, self.of_row = np.unique(self.of_row, return_inverse=True)
        self.count = int(self.of_row[-1]) + 1
        vel = np.nan_to_num(vel_ned_mps)
        self.speed_mps = self._mean(np.linalg.norm(vel, axis=1))
        rocking = np.stack([self._spread(np.nan_to_num(tilt_rad[:, k])) for k in (0, 1)])
        self.rocking_rad = rocking.max(axis=0)
        height = summed_height_m(t_s, vel[:, 2]) if height_m is None else height_m
        self.height_m = self._mean(np.nan_to_num(height, nan=float(np.nanmean(height))))
        self.still = (self.speed_mps < _STILL_MPS) & (self.rocking_rad < _STILL_TILT_RAD)

    def _mean(self, values: Floats) -> Floats:
        rows = np.bincount(self.of_row, minlength=self.count)
        return np.bincount(self.of_row, values, self.count) / np.maximum(rows, 1)

    def _spread(self, values: Floats) -> Floats:
        mean = self._mean(values)
        return np.sqrt(self._mean((values - mean[self.of_row]) ** 2))

    def rests(self, first: int, for_s: float) -> bool:
        """Tell whether it is still from this bin on, for so long or to the end of the log."""
        return bool(self.still[first : first + max(1, round(for_s / _BIN_S))].all())

    def dead(self, first: int, for_s: float) -> bool:
        """The same without even the rocking that a hover in calm air has."""
        bins = slice(first, first + max(1, round(for_s / _BIN_S)))
        whole = first + round(for_s / _BIN_S) <= self.count
        quiet = bool((self.rocking_rad[bins] < _DEAD_TILT_RAD).all())
        return whole and quiet and self.rests(first, for_s)


def summed_height_m(t_s: Floats, vel_d_mps: Floats) -> Floats:
    """Height above the first row from the vertical velocity (down), by trapezoids."""
    climb = -0.5 * (vel_d_mps[1:] + vel_d_mps[:-1])
    return np.concatenate([[0.0], np.cumsum(climb * np.diff(t_s))])
