"""The state of the vehicle, fused from reports that fail independently of each other.

| state | report | second witness |
| --- | --- | --- |
| on the ground | landing detector | thrust command; without one, height and speed at rest |
| mission flown | flight mode | state of the mission |
| falling | vertical speed | change of the height |
| height | the autopilot's estimate, by its barometer | height of the GNSS receiver |

One report alone never decides. The reactions are in observed_reactions.py.
"""

from dataclasses import dataclass

from companion.core.mission.events import (
    Event,
    GnssFix,
    MissionProgress,
    MissionState,
    Mode,
    Position,
    Throttle,
)

THROTTLE_MAX_AGE_S = 1.0

IDLE_THRUST = 0.15
"""Thrust command at which no multirotor hovers (hover needs 0.3 to 0.6); PX4 keeps 0.12
(MPC_THR_MIN) until it detects the landing, ArduCopter less."""

LIFT_THRUST, LIFT_S = 0.25, 3.0
"""More thrust than this for so long carries the vehicle: a landing detector reports within 1 s."""

MIN_STATE_REPORTS = 2
"""Consecutive reports that confirm a state of the mission: one may precede a mode change."""

FALL_ACCELERATION_MPS2, FALL_SPEED_MPS, FALL_DEPTH_M = 5.0, 3.0, 1.0
"""Least downward acceleration, speed and depth of a fall. Autopilots accelerate a descent by at
most 3 m/s2 (PX4 MPC_ACC_DOWN_MAX) or 1 m/s2 (ArduCopter WPNAV_ACCEL_Z)."""

MAX_REPORT_GAP_S = 0.5

HEIGHT_DOUBT_M, HEIGHT_LIMIT_M = 3.0, 5.0
"""Difference of estimated and GNSS height since takeoff: reported with a release; no release. Both
heights wander by 1 to 1.5 m within a flight, so the limit is more than three sigma."""

LIMIT_SIGMAS = 3.0
"""Multiple of the receiver's stated height accuracy that the limit is at least."""

DIFFERENCE_SMOOTHING = 0.2
"""Weight of one fix at 2 Hz: noise and delay of single fixes average out in 2.5 s."""


@dataclass(slots=True)
class ObservedState:
    """Evidence of thrust, mission, fall and height; one per flight."""

    thrust: Throttle | None = None
    lifted_since_s: float | None = None
    mission_state: MissionState | None = None
    """State of the mission while the mission mode flies it; `None`: unknown or unconfirmed."""
    fall_s: float | None = None
    """Time at which the last fall was detected."""
    height_difference_m: float = 0.0
    """Estimated height minus GNSS height, less their difference at takeoff (m)."""
    height_limit_m: float = HEIGHT_LIMIT_M
    _state_reports: int = 0
    reported_state: MissionState | None = None
    _reference_m: float | None = None
    _position: Position | None = None
    _fall_top_m: float = 0.0
    _fall_expected_m: float = 0.0
    """Depth of the present fall by its speed."""

    def store_event(self, event: Event, mode: Mode | None, *, is_armed: bool) -> None:
        """Process one telemetry event; `mode`: the reported flight mode."""
        match event:
            case Throttle():
                self.thrust = event
                if event.throttle_frac <= LIFT_THRUST:
                    self.lifted_since_s = None
                elif self.lifted_since_s is None:
                    self.lifted_since_s = event.t_s
            case MissionProgress():
                self._store_mission_state(event.mission_state, mode)
            case Position() if self._position is None or event.t_s > self._position.t_s:
                self._update_fall(event)
                self._position = event
            case GnssFix() if event.gnss_alt_m is not None and self._position is not None:
                self._update_height_difference(event, is_armed=is_armed)
            case _:
                return

    def is_thrust_idle(self, t_s: float) -> bool | None:
        """Return whether the motors idle; `None` without a recent report."""
        if self.thrust is None or t_s - self.thrust.t_s > THROTTLE_MAX_AGE_S:
            return None
        return self.thrust.throttle_frac <= IDLE_THRUST

    def is_lifted(self, t_s: float) -> bool:
        """Return whether the motors have carried the vehicle for longer than `LIFT_S`."""
        since_s = self.lifted_since_s
        return (
            since_s is not None and t_s - since_s > LIFT_S and self.is_thrust_idle(t_s) is not None
        )

    def height_conflict_text(self) -> str:
        """Return why no parcel may be released at the estimated height; `""` if it may."""
        difference_m = self.height_difference_m
        if abs(difference_m) <= self.height_limit_m:
            return ""
        return f"height uncertain by {abs(difference_m):.0f} m"

    def _store_mission_state(self, reported: MissionState | None, mode: Mode | None) -> None:
        was_flown = self.reported_state in (MissionState.ACTIVE, MissionState.COMPLETE)
        if reported is MissionState.NOT_STARTED and was_flown and mode is Mode.MISSION:
            reported = MissionState.COMPLETE  # a jump after its end stops ArduCopter's mission
        if reported is not self.reported_state or mode is not Mode.MISSION:
            self._state_reports = 0
        self.reported_state, self._state_reports = reported, self._state_reports + 1
        is_confirmed = self._state_reports >= MIN_STATE_REPORTS
        self.mission_state = reported if is_confirmed and mode is Mode.MISSION else None

    def _update_fall(self, new: Position) -> None:
        """Detect a fall: the speed grows as without thrust, and the height falls with it."""
        old = self._position
        dt_s = 0.0 if old is None else new.t_s - old.t_s
        gained_mps = 0.0 if old is None else new.vel_d_mps - old.vel_d_mps
        if (
            old is None
            or not 0.0 < dt_s <= MAX_REPORT_GAP_S
            or gained_mps < FALL_ACCELERATION_MPS2 * dt_s
        ):
            self._fall_top_m, self._fall_expected_m = new.alt_amsl_m, 0.0
            return
        self._fall_expected_m += 0.5 * (old.vel_d_mps + new.vel_d_mps) * dt_s
        sunk_m = self._fall_top_m - new.alt_amsl_m
        is_deep = self._fall_expected_m > FALL_DEPTH_M
        if is_deep and new.vel_d_mps > FALL_SPEED_MPS and sunk_m > 0.5 * self._fall_expected_m:
            self.fall_s = new.t_s

    def _update_height_difference(self, fix: GnssFix, *, is_armed: bool) -> None:
        """Compare the heights; until the vehicle is armed their difference is the reference."""
        assert fix.gnss_alt_m is not None
        assert self._position is not None
        difference_m = self._position.alt_amsl_m - fix.gnss_alt_m
        if not is_armed:
            before_m = self._reference_m
            step_m = (
                0.0
                if before_m is None
                else (1.0 - DIFFERENCE_SMOOTHING) * (before_m - difference_m)
            )
            self._reference_m, self.height_difference_m = difference_m + step_m, 0.0
            return
        if fix.gnss_alt_std_m is not None:
            self.height_limit_m = max(HEIGHT_LIMIT_M, LIMIT_SIGMAS * fix.gnss_alt_std_m)
        new_m = difference_m - (self._reference_m or 0.0)
        self.height_difference_m += DIFFERENCE_SMOOTHING * (new_m - self.height_difference_m)
