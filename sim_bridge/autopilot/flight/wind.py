"""The autopilot's own wind estimate, when its drag-fusion parameters switch it on.

Both EKF3 and EKF2 explain the horizontal specific force of a multirotor by
`a = -rho/2 v|v| / BCOEF - MCOEF v` along each body axis (v: airspeed along it; PX4,
src/modules/ekf2/EKF/aid_sources/drag; ArduPilot, EK3_DRAG_*), and so get wind without a sensor.
Here the formula is inverted and smoothed, with the coefficients of the parameters. Wrong
coefficients give a wrong wind, as in the real autopilots.
"""

import math
from dataclasses import dataclass

_AIR_KGPM3 = 1.225


@dataclass(frozen=True, slots=True)
class DragCoefficients:
    """Ballistic coefficients (kg/m2; 0 switches an axis off) and momentum drag (1/s)."""

    bcoef_x_kgpm2: float
    bcoef_y_kgpm2: float
    mcoef_hz: float

    @property
    def has_drag_on_both_axes(self) -> bool:
        """Return True if both axes have a coefficient."""
        has_forward_axis = self.bcoef_x_kgpm2 > 0.0 or self.mcoef_hz > 0.0
        across = self.bcoef_y_kgpm2 > 0.0 or self.mcoef_hz > 0.0
        return has_forward_axis and across


def axis_airspeed_from_drag_mps(
    specific_force_mps2: float, bcoef_kgpm2: float, mcoef_hz: float
) -> float:
    """Airspeed along one body axis that explains the specific force along it."""
    size = abs(specific_force_mps2)
    if bcoef_kgpm2 <= 0.0:
        speed = size / mcoef_hz
    else:
        quadratic = 0.5 * _AIR_KGPM3 / bcoef_kgpm2
        root = math.sqrt(mcoef_hz * mcoef_hz + 4.0 * quadratic * size)
        speed = (root - mcoef_hz) / (2.0 * quadratic)
    return -math.copysign(speed, specific_force_mps2)


class WindEstimator:
    """Estimates horizontal wind (direction that it blows TO) from drag, within about 15 s."""

    TIME_CONSTANT_S = 5.0
    ACCEL_FILTER_S = 0.5

    def __init__(self, drag: DragCoefficients) -> None:
        self.drag = drag
        self.reset()

    def reset(self) -> None:
        """Start without an estimate, as after a reboot."""
        self.north_mps = 0.0
        self.east_mps = 0.0
        self.variance_m2ps2 = 25.0
        self.flown_s = 0.0
        self._accel_x = 0.0
        self._accel_y = 0.0

    def update_wind_estimate(
        self,
        accel_frd_mps2: tuple[float, float, float],
        attitude_rad: tuple[float, float, float],
        vel_ned_mps: tuple[float, float, float],
        dt_s: float,
    ) -> None:
        """Take one step in flight (not on the ground, where the landing gear carries forces)."""
        share = dt_s / self.ACCEL_FILTER_S
        self._accel_x += share * (accel_frd_mps2[0] - self._accel_x)
        self._accel_y += share * (accel_frd_mps2[1] - self._accel_y)
        self.flown_s += dt_s
        drag = self.drag
        air_x = axis_airspeed_from_drag_mps(self._accel_x, drag.bcoef_x_kgpm2, drag.mcoef_hz)
        air_y = axis_airspeed_from_drag_mps(self._accel_y, drag.bcoef_y_kgpm2, drag.mcoef_hz)
        roll, pitch, yaw = attitude_rad
        sink = vel_ned_mps[2]  # vertical wind is assumed to be zero
        forward = (air_x + sink * math.sin(pitch)) / max(math.cos(pitch), 0.3)
        across = (air_y - sink * math.sin(roll)) / max(math.cos(roll), 0.3)
        sin_yaw, cos_yaw = math.sin(yaw), math.cos(yaw)
        wind_north = vel_ned_mps[0] - (forward * cos_yaw - across * sin_yaw)
        wind_east = vel_ned_mps[1] - (forward * sin_yaw + across * cos_yaw)
        share = dt_s / max(min(self.TIME_CONSTANT_S, self.flown_s), dt_s)
        self.north_mps += share * (wind_north - self.north_mps)
        self.east_mps += share * (wind_east - self.east_mps)
        self.variance_m2ps2 += dt_s / self.TIME_CONSTANT_S * (0.5 - self.variance_m2ps2)


class WindFusion:
    """The estimator of the current boot; None while drag fusion is off."""

    def __init__(self) -> None:
        self.estimator: WindEstimator | None = None

    def recreate_estimator_at_boot(self, drag: DragCoefficients | None) -> None:
        """Set drag fusion up at each boot; None leaves it off."""
        self.estimator = None if drag is None else WindEstimator(drag)
