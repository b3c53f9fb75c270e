"""What a mode wants of the flight controller at this moment. NED about the site's origin, SI."""

from dataclasses import dataclass

Vec3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Limits:
    """How fast the vehicle may go: over ground, up, down, and how hard it may turn."""

    horizontal_mps: float
    up_mps: float
    down_mps: float
    accel_mps2: float
    accel_vertical_mps2: float
    jerk_mps3: float
    tilt_rad: float


@dataclass(frozen=True, slots=True)
class Idle:
    """Armed on the ground, propellers turning, no thrust; or disarmed."""


@dataclass(frozen=True, slots=True)
class FollowLine:
    """Along a straight line to `end`, passing it at `exit_mps`."""

    start: Vec3
    end: Vec3
    speed_mps: float
    exit_mps: float
    up_mps: float
    down_mps: float
    yaw_rad: float | None = None


@dataclass(frozen=True, slots=True)
class HoldPoint:
    """Stay at, or come back to, a point."""

    point: Vec3
    yaw_rad: float | None = None


@dataclass(frozen=True, slots=True)
class FlyVelocity:
    """A velocity over ground."""

    vel_ned_mps: Vec3
    yaw_rad: float | None = None
    yaw_rate_rps: float = 0.0


@dataclass(frozen=True, slots=True)
class Descend:
    """Straight down above a point (north, east) until the ground is met."""

    point: tuple[float, float]
    rate_mps: float
    yaw_rad: float | None = None


@dataclass(frozen=True, slots=True)
class FlyLevel:
    """Attitude by hand, or level where position is unknown; climbs at a rate (down is minus)."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rate_rps: float = 0.0
    climb_mps: float = 0.0


@dataclass(frozen=True, slots=True)
class FlyByHand:
    """Attitude and thrust straight from the sticks."""

    roll_rad: float
    pitch_rad: float
    yaw_rate_rps: float
    thrust_frac: float


Goal = Idle | FollowLine | HoldPoint | FlyVelocity | Descend | FlyLevel | FlyByHand
