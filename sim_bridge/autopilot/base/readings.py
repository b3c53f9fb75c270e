"""What the sensors tell an autopilot, and what it tells the airframe to do."""

from dataclasses import dataclass
from typing import Protocol

from sim_bridge.autopilot.base.geodesy import Vec3


class Readings(Protocol):
    """One set of readings: NED about the depot, SI, radians; None is unknown."""

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
    def accel_frd_mps2(self) -> Vec3: ...
    @property
    def gnss_ok(self) -> bool: ...
    @property
    def pos_ned_m(self) -> Vec3: ...
    @property
    def vel_ned_mps(self) -> Vec3: ...
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


@dataclass(frozen=True, slots=True)
class AttitudeSetpoint:
    """Attitude in rad, thrust as a share of the static maximum, motors, gripper."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    thrust_frac: float = 0.0
    motors_on: bool = False
    release: bool = False
