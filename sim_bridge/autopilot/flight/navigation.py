"""Position and velocity from accelerometers, delayed GNSS fixes and the barometer.

Frames: NED about the depot, SI, radians; velocities over ground.
"""

import math
from collections import deque

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.readings import Readings

GRAVITY_MPS2 = 9.80665


class Navigator:
    """Position and velocity from accelerometers, late GNSS fixes and the barometer.

    A fix is compared with the estimate of `gnss_delay_s` ago. Height follows the barometer from the
    GNSS height before take-off. Without GNSS it goes on by dead reckoning.
    """

    _POSITION_SHARE = 0.2  # of the innovation, per fix
    _VELOCITY_SHARE = 0.2
    _BARO_POSITION_PS = 2.0
    _BARO_VELOCITY_PS2 = 0.8
    _BARO_ZERO_PS = 0.3

    def __init__(self, gnss_delay_s: float) -> None:
        self._delay_s = gnss_delay_s
        self._past: deque[tuple[float, ...]] = deque()
        self._fix: Vec3 | None = None
        self._baro_zero_m = 0.0
        # the sum of all corrections; the past is stored without them
        self._added = [0.0] * 5
        self.north_m = self.east_m = self.down_m = 0.0
        self.north_mps = self.east_mps = self.down_mps = 0.0

    def update(self, readings: Readings, dt_s: float, *, on_ground: bool) -> None:
        """Take in one set of readings, `dt_s` after the last."""
        if self._fix is None:
            self._initialise_from_readings(readings)
            return
        self._integrate_accelerometers(readings, dt_s)
        self._correct_height_by_barometer(readings, dt_s, on_ground=on_ground)
        fix = readings.pos_ned_m
        if readings.gnss_ok and fix != self._fix:
            self._correct_by_delayed_gnss_fix(fix, readings.vel_ned_mps)
        self._fix = fix
        a = self._added
        self._past.append(
            (
                self.north_m - a[0],
                self.east_m - a[1],
                self.north_mps - a[2],
                self.east_mps - a[3],
                self.down_mps - a[4],
            )
        )
        while len(self._past) * dt_s > self._delay_s:
            self._past.popleft()

    def _initialise_from_readings(self, readings: Readings) -> None:
        self._fix = readings.pos_ned_m
        self.north_m, self.east_m, self.down_m = readings.pos_ned_m
        self.north_mps, self.east_mps, self.down_mps = readings.vel_ned_mps
        self._baro_zero_m = readings.alt_amsl_m + self.down_m

    def _integrate_accelerometers(self, readings: Readings, dt_s: float) -> None:
        fx, fy, fz = readings.accel_frd_mps2
        sr, cr = math.sin(readings.roll_rad), math.cos(readings.roll_rad)
        sp, cp = math.sin(readings.pitch_rad), math.cos(readings.pitch_rad)
        sy, cy = math.sin(readings.yaw_rad), math.cos(readings.yaw_rad)
        leaned = fy * sr + fz * cr
        level = fx * cp + leaned * sp
        across = fy * cr - fz * sr
        self.north_mps += (level * cy - across * sy) * dt_s
        self.east_mps += (level * sy + across * cy) * dt_s
        self.down_mps += (leaned * cp - fx * sp + GRAVITY_MPS2) * dt_s
        self.north_m += self.north_mps * dt_s
        self.east_m += self.east_mps * dt_s
        self.down_m += self.down_mps * dt_s

    def _correct_height_by_barometer(
        self, readings: Readings, dt_s: float, *, on_ground: bool
    ) -> None:
        baro_down = self._baro_zero_m - readings.alt_amsl_m
        if on_ground and readings.gnss_ok:
            self._baro_zero_m += (readings.pos_ned_m[2] - baro_down) * self._BARO_ZERO_PS * dt_s
        error = baro_down - self.down_m
        self.down_m += self._BARO_POSITION_PS * error * dt_s
        change = self._BARO_VELOCITY_PS2 * error * dt_s
        self.down_mps += change
        self._added[4] += change

    def _correct_by_delayed_gnss_fix(self, gnss_pos_ned_m: Vec3, gnss_vel_ned_mps: Vec3) -> None:
        if not self._past:
            return
        past, a = self._past[0], self._added
        north = self._POSITION_SHARE * (gnss_pos_ned_m[0] - past[0] - a[0])
        east = self._POSITION_SHARE * (gnss_pos_ned_m[1] - past[1] - a[1])
        north_v = self._VELOCITY_SHARE * (gnss_vel_ned_mps[0] - past[2] - a[2]) + 0.1 * north
        east_v = self._VELOCITY_SHARE * (gnss_vel_ned_mps[1] - past[3] - a[3]) + 0.1 * east
        down_v = 0.5 * self._VELOCITY_SHARE * (gnss_vel_ned_mps[2] - past[4] - a[4])
        for index, value in enumerate((north, east, north_v, east_v, down_v)):
            a[index] += value
        self.north_m += north
        self.east_m += east
        self.north_mps += north_v
        self.east_mps += east_v
        self.down_mps += down_v
