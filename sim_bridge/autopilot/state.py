"""What the modules of one autopilot share: time, measurements, the estimate, mode, arming, home.

Every field has one writer, named above it; everybody reads. `tests/sim_bridge/autopilot/
test_state_owners.py` checks that nobody else assigns it. What only one module needs is that
module's own and is not here.
"""

from dataclasses import dataclass, field

from sim_bridge.autopilot.base.geodesy import LocalFrame, Vec3
from sim_bridge.autopilot.base.goals import Goal, Idle
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.base.readings import AttitudeSetpoint, Readings
from sim_bridge.autopilot.mavlink.parameters import ParameterStore

RADIO = (0, 0)
"""The pilot's radio control, where who changed the mode is told as system and component."""

STEP_S = 0.01
"""Seconds between two steps of the control loop; no message is streamed faster."""


@dataclass(frozen=True, slots=True)
class FlightRules:
    """How mission items are flown, as the autopilot's parameters and design say."""

    default_speed_mps: float
    spool_s: float
    """From arming to the first thrust."""
    accept_radius_m: float
    accept_height_m: float
    takeoff_short_m: float
    """A take-off is done this far below its height."""
    takeoff_speed_mps: float
    takeoff_min_height_m: float
    corner_accel_mps2: float
    land_above_m: float
    """The descent of a LAND item begins when the vehicle is this near to its place."""
    land_from_m: float
    """The vehicle first flies to the place of a LAND item if it is farther away than this."""
    ramp_s: float = 0.0
    """From spooled up, on the ground, to enough thrust to lift off (PX4)."""
    brakes_when_redirected: bool = False
    """Whether leaving a waypoint before it is reached costs the speed (ArduCopter)."""
    item_period_s: float = 0.0
    """Shortest time between two items that take no time (PX4's navigator)."""
    height_apart: bool = False
    """Whether a leg's height is flown apart from its way: no slope slows the vehicle (PX4)."""
    takes_passed: bool = True
    """Whether a waypoint that is flown through counts once it is passed (ArduCopter)."""


@dataclass(frozen=True, slots=True)
class EstimatorTiming:
    """When an autopilot's estimator has a position."""

    ready_after_s: float
    """From boot to the first position."""
    gnss_patience_s: float
    """How long the position stays valid without GNSS."""


@dataclass(slots=True)
class VehicleState:
    """The shared state. Positions are NED about the site's origin, in metres."""

    # fixed
    params: ParameterStore
    """The store changes its values itself; it is never replaced."""
    frame: LocalFrame
    timing: EstimatorTiming
    system_id: int
    vehicle_type: int
    epoch_unix_s: float
    """Unix time at t_s = 0."""

    # written by autopilot.py
    rules: FlightRules
    boot_t_s: float
    t_s: float = 0.0
    readings: Readings | None = None
    pos_ned_m: Vec3 = (0.0, 0.0, 0.0)
    """Estimated position."""
    vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    """Estimated velocity over ground."""
    is_landed: bool = True
    gnss_lost_s: float = 0.0
    goal: Goal = field(default_factory=Idle)
    actuation: AttitudeSetpoint = field(default_factory=AttitudeSetpoint)

    # written by flight/commander.py
    mode: Mode = Mode.HOLD
    mode_by: tuple[int, int] | None = None
    """Who changed to this mode: system and component, `RADIO` for radio control; None: itself."""
    is_armed: bool = False
    armed_since_s: float = 0.0
    has_flown: bool = False
    """Whether it has left the ground since it was armed."""
    landed_since_s: float = 0.0
    failsafe_reason: str | None = None
    home_ned_m: Vec3 = (0.0, 0.0, 0.0)
    home_is_set: bool = False
    home_is_locked: bool = False
    """Whether home stays where it is when the vehicle is armed."""
    home_revision: int = 0
    ekf_origin_ned_m: Vec3 = (0.0, 0.0, 0.0)

    @property
    def t_since_boot_s(self) -> float:
        """Seconds since boot."""
        return self.t_s - self.boot_t_s

    @property
    def time_boot_ms(self) -> int:
        """`time_boot_ms` of the messages."""
        return round(self.t_since_boot_s * 1000.0) & 0xFFFFFFFF

    @property
    def time_boot_ns(self) -> int:
        """The autopilot's clock as TIMESYNC has it."""
        return round(self.t_since_boot_s * 1e6) * 1000

    @property
    def is_spooled(self) -> bool:
        """Whether the motors have been armed for long enough to take off."""
        return self.is_armed and self.t_s - self.armed_since_s >= self.rules.spool_s

    @property
    def gnss_ok(self) -> bool:
        """Whether the receiver has a fix."""
        return self.readings is not None and self.readings.gnss_ok

    @property
    def ekf_is_ready(self) -> bool:
        """Whether the estimator has had a position since boot."""
        return self.home_is_set or self.t_since_boot_s >= self.timing.ready_after_s

    @property
    def has_position(self) -> bool:
        """Whether there is a horizontal position to fly by."""
        return (
            self.readings is not None
            and self.t_since_boot_s >= (0.5 if self.has_flown else self.timing.ready_after_s)
            and self.gnss_lost_s < self.timing.gnss_patience_s
        )

    @property
    def yaw_rad(self) -> float:
        """Measured heading; 0 before the first readings."""
        return 0.0 if self.readings is None else self.readings.yaw_rad

    @property
    def height_above_home_m(self) -> float:
        """Estimated height above home."""
        return self.home_ned_m[2] - self.pos_ned_m[2]
