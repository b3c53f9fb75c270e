"""Shared state of one autopilot's modules: time, measurements, the estimate, mode, arming, home.

Every field has one writer, named above it; all modules read it. `tests/sim_bridge/autopilot/
test_state_owners.py` checks that no other module assigns it. Data used by only one module is
stored in that module.
"""

from dataclasses import dataclass, field

from sim_bridge.autopilot.base.geodesy import LocalFrame, Vec3
from sim_bridge.autopilot.base.goals import Goal, Idle
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.base.readings import AttitudeSetpoint, Readings
from sim_bridge.autopilot.mavlink.parameters import ParameterStore

RADIO = (0, 0)
"""The pilot's radio control, as the system and component that changed the mode."""

STEP_S = 0.01
"""Seconds between two steps of the control loop; no message is streamed faster."""


@dataclass(frozen=True, slots=True)
class FlightRules:
    """Rules for flying mission items, from the autopilot's parameters and design."""

    default_speed_mps: float
    spool_s: float
    """Time from arming to the first thrust."""
    accept_radius_m: float
    accept_height_m: float
    takeoff_short_m: float
    """A take-off is done this far below its height."""
    takeoff_speed_mps: float
    takeoff_min_height_m: float
    corner_accel_mps2: float
    land_descent_distance_m: float
    """Distance to the position of a LAND item at which its descent begins."""
    land_transit_distance_m: float
    """Distance above which the vehicle first flies to the position of a LAND item."""
    thrust_ramp_s: float = 0.0
    """Time from spooled up, on the ground, to enough thrust to lift off (PX4)."""
    is_speed_cut_on_redirect: bool = False
    """True if leaving a waypoint before it is reached reduces the speed (ArduCopter)."""
    item_period_s: float = 0.0
    """Shortest time between two items that take no time (PX4's navigator)."""
    independent_height: bool = False
    """True if height is flown independently of the path: slopes do not slow the vehicle (PX4)."""
    accepts_passed_waypoints: bool = True
    """True if a waypoint that is flown through counts when passed (ArduCopter)."""


@dataclass(frozen=True, slots=True)
class EstimatorTiming:
    """When an autopilot's estimator has a position."""

    ready_after_s: float
    """Time from boot to the first position."""
    gnss_timeout_s: float
    """Time for which the position stays valid without GNSS."""


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
    """Sender of the mode change: system and component, `RADIO` for radio control; None: itself."""
    is_armed: bool = False
    armed_since_s: float = 0.0
    has_flown: bool = False
    """True if it has left the ground since arming."""
    landed_since_s: float = 0.0
    failsafe_reason: str | None = None
    home_ned_m: Vec3 = (0.0, 0.0, 0.0)
    home_is_set: bool = False
    home_is_locked: bool = False
    """True if arming does not move home."""
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
    def are_motors_spooled_up(self) -> bool:
        """Return True if the motors have been armed long enough to take off."""
        return self.is_armed and self.t_s - self.armed_since_s >= self.rules.spool_s

    @property
    def gnss_ok(self) -> bool:
        """Return True if the receiver has a fix."""
        return self.readings is not None and self.readings.gnss_ok

    @property
    def ekf_is_ready(self) -> bool:
        """Return True if the estimator has had a position since boot."""
        return self.home_is_set or self.t_since_boot_s >= self.timing.ready_after_s

    @property
    def has_position(self) -> bool:
        """Return True if a horizontal position is available for flight."""
        return (
            self.readings is not None
            and self.t_since_boot_s >= (0.5 if self.has_flown else self.timing.ready_after_s)
            and self.gnss_lost_s < self.timing.gnss_timeout_s
        )

    @property
    def yaw_rad(self) -> float:
        """Measured heading; 0 before the first readings."""
        return 0.0 if self.readings is None else self.readings.yaw_rad

    @property
    def height_above_home_m(self) -> float:
        """Estimated height above home."""
        return self.home_ned_m[2] - self.pos_ned_m[2]
