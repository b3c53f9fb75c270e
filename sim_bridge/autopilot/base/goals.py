"""Goals that a mode gives to the flight controller. NED about the site's origin, SI."""

from dataclasses import dataclass

from sim_bridge.autopilot.base.geodesy import Vec3


@dataclass(frozen=True, slots=True)
class Idle:
    """Armed on the ground: the propellers turn and carry nothing."""


@dataclass(frozen=True, slots=True)
class FollowLine:
    """Along a straight line to `end` at a ground speed, passing it at `exit_mps`.

    `independent_height`: at that speed whatever the slope, and to the end's height at full rate.
    """

    start: Vec3
    end: Vec3
    speed_mps: float
    exit_mps: float = 0.0
    yaw_rad: float | None = None
    independent_height: bool = False


@dataclass(frozen=True, slots=True)
class HoldPoint:
    """Hold a point, or return to it."""

    point: Vec3
    yaw_rad: float | None = None


@dataclass(frozen=True, slots=True)
class FlyVelocity:
    """A velocity over ground, and how it is about to change."""

    vel_ned_mps: Vec3
    yaw_rad: float | None = None
    yaw_rate_rps: float = 0.0
    accel_ned_mps2: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Descend:
    """Straight down over a point (north, east) to the ground."""

    point: tuple[float, float]
    rate_mps: float


@dataclass(frozen=True, slots=True)
class FlyLevel:
    """An attitude and a climb rate (minus is down): by the sticks, or level without a position."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rate_rps: float = 0.0
    climb_mps: float = 0.0


@dataclass(frozen=True, slots=True)
class FlyManual:
    """Attitude and thrust straight from the sticks."""

    roll_rad: float
    pitch_rad: float
    yaw_rate_rps: float
    thrust_frac: float


Goal = Idle | FollowLine | HoldPoint | FlyVelocity | Descend | FlyLevel | FlyManual


@dataclass(frozen=True, slots=True)
class Setpoint:
    """An external set-point: a position, a velocity, or both. None means not given.

    An acceleration requires a velocity.
    """

    t_s: float
    pos_ned_m: Vec3 | None
    vel_ned_mps: Vec3 | None
    yaw_rad: float | None
    yaw_rate_rps: float
    accel_ned_mps2: Vec3 = (0.0, 0.0, 0.0)
