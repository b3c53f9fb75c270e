"""What the autopilot believes about itself: an inertial solution held by GNSS and barometer.

A fixed-gain complementary filter: accelerometers carry position and velocity from one GNSS fix to
the next, each fix pulls them back, compared with the solution of the moment at which it was taken.
It stands in for EKF3 and EKF2: it lags, it drifts without GNSS, and it knows nothing of the truth.
"""

import math
from collections import deque
from typing import Protocol

GRAVITY_MPS2 = 9.80665
_NAN_POS = (math.nan, math.nan, math.nan)


class Readings(Protocol):
    """What the sensors say; see ARCHITECTURE.md, `SensorReadings`."""

    @property
    def t_s(self) -> float: ...
    @property
    def roll_rad(self) -> float: ...
    @property
    def pitch_rad(self) -> float: ...
    @property
    def yaw_rad(self) -> float: ...
    @property
    def rollspeed_rps(self) -> float: ...
    @property
    def pitchspeed_rps(self) -> float: ...
    @property
    def yawspeed_rps(self) -> float: ...
    @property
    def accel_frd_mps2(self) -> tuple[float, float, float]: ...
    @property
    def gnss_ok(self) -> bool: ...
    @property
    def pos_ned_m(self) -> tuple[float, float, float]: ...
    @property
    def vel_ned_mps(self) -> tuple[float, float, float]: ...
    @property
    def alt_amsl_m(self) -> float: ...
    @property
    def airspeed_mps(self) -> float | None: ...
    @property
    def voltage_v(self) -> float | None: ...
    @property
    def current_a(self) -> float | None: ...
    @property
    def temperature_c(self) -> float: ...
    @property
    def touching_ground(self) -> bool: ...


class Estimator:
    """The navigation solution, NED about the site's origin, SI.

    `gnss_delay_s` is what the autopilot is told of its receiver (PX4 EKF2_GPS_DELAY 110 ms).
    """

    POSITION_GAIN = 0.15
    VELOCITY_GAIN = 0.25
    BARO_POSITION_RATE_HZ = 1.2
    BARO_VELOCITY_RATE_HZ2 = 0.5

    def __init__(self, origin_alt_amsl_m: float, gnss_delay_s: float = 0.12) -> None:
        self._origin_alt_m = origin_alt_amsl_m
        self._delay_s = gnss_delay_s
        self.reset()

    def reset(self) -> None:
        """Start again, as a reboot does."""
        self.north_m = self.east_m = self.down_m = 0.0
        self.north_mps = self.east_mps = self.down_mps = 0.0
        self.roll_rad = self.pitch_rad = self.yaw_rad = 0.0
        self.rollspeed_rps = self.pitchspeed_rps = self.yawspeed_rps = 0.0
        self.accel_frd_mps2 = (0.0, 0.0, -GRAVITY_MPS2)
        self.alt_amsl_m = self._origin_alt_m
        self.gnss_ok = False
        self.gnss_lost_s = math.inf
        self.fix_ned_m = _NAN_POS
        self.fix_vel_ned_mps = (0.0, 0.0, 0.0)
        self._last_fix: object = None
        self._started = False
        self._history: deque[tuple[float, float, float, float, float, float]] = deque()

    @property
    def pos_ned_m(self) -> tuple[float, float, float]:
        """Estimated position."""
        return self.north_m, self.east_m, self.down_m

    @property
    def vel_ned_mps(self) -> tuple[float, float, float]:
        """Estimated velocity over ground."""
        return self.north_mps, self.east_mps, self.down_mps

    @property
    def groundspeed_mps(self) -> float:
        """Horizontal speed over ground."""
        return math.hypot(self.north_mps, self.east_mps)

    def step(self, readings: Readings, dt_s: float, *, at_rest: bool) -> None:
        """Take one set of readings; `at_rest` is the landing detector's word."""
        self.roll_rad = readings.roll_rad
        self.pitch_rad = readings.pitch_rad
        self.yaw_rad = readings.yaw_rad
        self.rollspeed_rps = readings.rollspeed_rps
        self.pitchspeed_rps = readings.pitchspeed_rps
        self.yawspeed_rps = readings.yawspeed_rps
        self.accel_frd_mps2 = readings.accel_frd_mps2
        if not self._started:
            self._start(readings)
        self._carry(dt_s)
        if at_rest:
            self.north_mps *= 0.98
            self.east_mps *= 0.98
            self.down_mps *= 0.98
        self._hold_height(readings.alt_amsl_m, dt_s)
        self._hold_gnss(readings, dt_s)

    def _start(self, readings: Readings) -> None:
        self._started = True
        self.alt_amsl_m = readings.alt_amsl_m
        self.down_m = self._origin_alt_m - readings.alt_amsl_m
        if readings.gnss_ok:
            self.north_m, self.east_m, _ = readings.pos_ned_m
            self.north_mps, self.east_mps, self.down_mps = readings.vel_ned_mps

    def _carry(self, dt_s: float) -> None:
        """Integrate the specific force, turned to NED."""
        fx, fy, fz = self.accel_frd_mps2
        sr, cr = math.sin(self.roll_rad), math.cos(self.roll_rad)
        sp, cp = math.sin(self.pitch_rad), math.cos(self.pitch_rad)
        sy, cy = math.sin(self.yaw_rad), math.cos(self.yaw_rad)
        across = fy * cr - fz * sr
        lifted = fy * sr + fz * cr
        ahead = fx * cp + lifted * sp
        down = -fx * sp + lifted * cp + GRAVITY_MPS2
        north = ahead * cy - across * sy
        east = ahead * sy + across * cy
        half = 0.5 * dt_s
        self.north_m += (self.north_mps + north * half) * dt_s
        self.east_m += (self.east_mps + east * half) * dt_s
        self.down_m += (self.down_mps + down * half) * dt_s
        self.north_mps += north * dt_s
        self.east_mps += east * dt_s
        self.down_mps += down * dt_s

    def _hold_height(self, baro_amsl_m: float, dt_s: float) -> None:
        error = self._origin_alt_m - baro_amsl_m - self.down_m
        self.down_m += self.BARO_POSITION_RATE_HZ * error * dt_s
        self.down_mps += self.BARO_VELOCITY_RATE_HZ2 * error * dt_s
        self.alt_amsl_m = self._origin_alt_m - self.down_m

    def _hold_gnss(self, readings: Readings, dt_s: float) -> None:
        history = self._history
        history.append(
            (
                readings.t_s,
                self.north_m,
                self.east_m,
                self.north_mps,
                self.east_mps,
                self.down_mps,
            )
        )
        since = readings.t_s - self._delay_s + 1e-6
        while len(history) > 1 and history[1][0] <= since:
            history.popleft()
        self.gnss_ok = readings.gnss_ok
        if not readings.gnss_ok:
            self.gnss_lost_s += dt_s
            return
        pos = readings.pos_ned_m
        if pos == self._last_fix:
            return
        was_lost_s, self.gnss_lost_s = self.gnss_lost_s, 0.0
        self._last_fix = pos
        self.fix_ned_m, self.fix_vel_ned_mps = pos, readings.vel_ned_mps
        _, north, east, north_mps, east_mps, down_mps = history[0]
        vel = readings.vel_ned_mps
        if was_lost_s > 2.0:
            gain_p = gain_v = 1.0
            history.clear()
        else:
            gain_p, gain_v = self.POSITION_GAIN, self.VELOCITY_GAIN
        self.north_m += gain_p * (pos[0] - north)
        self.east_m += gain_p * (pos[1] - east)
        self.north_mps += gain_v * (vel[0] - north_mps)
        self.east_mps += gain_v * (vel[1] - east_mps)
        self.down_mps += 0.2 * gain_v * (vel[2] - down_mps)
