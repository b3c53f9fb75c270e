"""Synthetic flight with known wind, written into log files to test their readers.

Squares in local metres, attitude from Newton's law and drag, seeded sensor noise.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

G_MPS2 = 9.80665
LAT_DEG, LON_DEG, ALT_M = 55.47, 8.45, 12.0
M_PER_DEG_LAT = 111_350.0  # at 55 degrees north, WGS 84
M_PER_DEG_LON = 63_180.0

MASS_KG = 3.65
DRAG_LINEAR = (0.30, 0.33)
DRAG_QUADRATIC = (0.041, 0.045)
"""The M100 of params/airframes/m100.toml; copied, so that truth is independent of that file."""

VOLTAGE_V, CURRENT_A, CHARGE_FRAC = 24.1, 20.0, 0.9


@dataclass
class SyntheticFlight:
    """Samples of a flight, (n,) each: 8 s on the ground, climb, squares, landing."""

    t_s: np.ndarray
    vel_ned_mps: np.ndarray
    pos_ned_m: np.ndarray
    roll_rad: np.ndarray
    pitch_rad: np.ndarray
    yaw_rad: np.ndarray
    airspeed_mps: np.ndarray
    flying: np.ndarray
    wind_to_ne_mps: tuple[float, float]
    powered: bool = True

    @property
    def attitude_rad(self) -> np.ndarray:
        """Roll, pitch and yaw, (n, 3)."""
        return np.column_stack([self.roll_rad, self.pitch_rad, self.yaw_rad])

    @property
    def lat_deg(self) -> np.ndarray:
        return LAT_DEG + self.pos_ned_m[:, 0] / M_PER_DEG_LAT

    @property
    def lon_deg(self) -> np.ndarray:
        return LON_DEG + self.pos_ned_m[:, 1] / M_PER_DEG_LON

    @property
    def consumed_charge_ah(self) -> np.ndarray:
        steps = np.diff(self.t_s, prepend=self.t_s[0]) * self.flying
        return np.cumsum(steps) * CURRENT_A / 3600.0

    @property
    def current_a(self) -> np.ndarray:
        """The measured current; it varies by its resolution, as a constant one counts as frozen."""
        return np.where(self.flying, CURRENT_A + 0.01 * self._least_variation, 0.0)

    @property
    def voltage_v(self) -> np.ndarray:
        """The measured voltage, which varies by its resolution in flight."""
        loaded_v = VOLTAGE_V - 0.9 + 0.001 * self._least_variation
        return np.where(self.flying, loaded_v, VOLTAGE_V)

    @property
    def _least_variation(self) -> np.ndarray:
        return np.round(10.0 * self.t_s) % 3 - 1.0

    def select_rows(self, selection: Any) -> "SyntheticFlight":
        """Return the flight reduced to these rows."""
        names = ("t_s", "vel_ned_mps", "pos_ned_m", "roll_rad", "pitch_rad", "yaw_rad",
                 "airspeed_mps", "flying")  # fmt: skip
        return replace(self, **{name: getattr(self, name)[selection] for name in names})


def drag_force_ne_n(air_velocity_ned_mps: np.ndarray, yaw_rad: np.ndarray) -> np.ndarray:
    """Return the drag on the vehicle (n, 2: north, east), computed in body axes."""
    forward, right = _rotate(air_velocity_ned_mps[:, :2], yaw_rad)
    speed = np.hypot(forward, right)
    drag_forward_n = -(DRAG_LINEAR[0] + DRAG_QUADRATIC[0] * speed) * forward
    drag_right_n = -(DRAG_LINEAR[1] + DRAG_QUADRATIC[1] * speed) * right
    drag_n = np.column_stack([drag_forward_n, drag_right_n])
    return np.column_stack(_rotate(drag_n, -yaw_rad))


def _rotate(vectors: np.ndarray, angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the components of vectors (n, 2) along axes that are turned by the angles (n,)."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    first, second = vectors.T
    return first * cos + second * sin, -first * sin + second * cos


def build_square_flight(
    wind_to_ne_mps: tuple[float, float] = (-4.0, 3.0), rate_hz: float = 10.0
) -> SyntheticFlight:
    """Return 160 s of squares, 15 s per side at 6 and 10 m/s, at 30 m, in steady wind."""
    t_s = np.arange(0.0, 160.0, 1.0 / rate_hz)
    leg_table = ((20, 6, 20), (35, 6, 110), (50, 6, 200), (65, 6, 290), (80, 10, 20), (95, 10, 110),
            (110, 10, 200), (125, 10, 290), (140, 0, 290))  # fmt: skip
    speed, course = np.zeros(t_s.size), np.full(t_s.size, math.radians(20.0))
    for start_s, mps, deg in leg_table:
        speed[t_s >= start_s], course[t_s >= start_s] = mps, math.radians(deg)
    velocity_ne_mps = np.stack([speed * np.cos(course), speed * np.sin(course)], axis=1)
    down = np.where((t_s > 8.0) & (t_s <= 18.0), -3.0, 0.0)
    down = np.where((t_s > 143.0) & (t_s <= 153.0), 3.0, down)
    smooth = np.ones(round(3.0 * rate_hz)) / round(3.0 * rate_hz)
    velocity_ned_mps = np.column_stack([velocity_ne_mps, down])
    vel = np.stack([np.convolve(velocity_ned_mps[:, k], smooth, "same") for k in range(3)], axis=1)
    airborne = (t_s > 8.0) & (t_s <= 153.0)
    yaw = np.unwrap(np.arctan2(velocity_ne_mps[:, 1], velocity_ne_mps[:, 0]))
    yaw = np.where(speed > 0.0, yaw, np.where(t_s < 60.0, math.radians(20.0), math.radians(290.0)))
    return _build_flight_with_noisy_attitude(t_s, vel, yaw, airborne, wind_to_ne_mps)


def build_outbound_flight(
    wind_to_ne_mps: tuple[float, float], speed_mps: float, duration_s: float
) -> SyntheticFlight:
    """Return a flight to the south without a return, after 8 s on the ground."""
    t_s = np.arange(0.0, duration_s, 0.1)
    vel = np.zeros((t_s.size, 3))
    vel[:, 0] = -np.clip(0.8 * (t_s - 20.0), 0.0, speed_mps)
    vel[:, 2] = -np.clip(2.0 * np.minimum(t_s - 8.0, 19.5 - t_s), 0.0, 3.0)
    yaw = np.full(t_s.size, math.pi)
    return _build_flight_with_noisy_attitude(t_s, vel, yaw, t_s > 8.0, wind_to_ne_mps)


def _build_flight_with_noisy_attitude(
    t_s: np.ndarray,
    vel_ned_mps: np.ndarray,
    yaw_rad: np.ndarray,
    airborne: np.ndarray,
    wind_to_ne_mps: tuple[float, float],
) -> SyntheticFlight:
    """Compute the attitude for which thrust, drag and weight give the acceleration; add noise."""
    rng = np.random.default_rng(7)
    accel = np.gradient(vel_ned_mps, t_s, axis=0)
    air = vel_ned_mps[:, :2] - np.array(wind_to_ne_mps)
    horizontal = MASS_KG * accel[:, :2] - drag_force_ne_n(air, yaw_rad)
    lift = MASS_KG * (G_MPS2 - accel[:, 2])
    forward, right = _rotate(horizontal, yaw_rad)
    # Thrust along body up, in NED after yaw, pitch, roll: (-sin p cos r, sin r, -cos p cos r) T.
    pitch = np.arctan2(-forward, lift)
    roll = np.arctan2(right, np.hypot(forward, lift))
    noise = np.radians(0.2) * rng.standard_normal((2, t_s.size))
    roll, pitch = (
        np.where(airborne, a + n, 0.0) for a, n in zip((roll, pitch), noise, strict=True)
    )
    steps = np.diff(t_s, prepend=t_s[0])[:, None]
    return SyntheticFlight(
        t_s,
        vel_ned_mps
        + np.where(airborne, 0.02, 0.002)[:, None] * rng.standard_normal(vel_ned_mps.shape),
        np.cumsum(vel_ned_mps * steps, axis=0),
        roll,
        pitch,
        (yaw_rad + math.pi) % (2.0 * math.pi) - math.pi,
        np.hypot(air[:, 0], air[:, 1]),
        airborne,
        wind_to_ne_mps,
    )
