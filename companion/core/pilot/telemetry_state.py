"""The latest telemetry of the vehicle, its age, and whether it is good enough to act on.

Heights have one reference. An autopilot reports its height above its own home, and any station can
move that home in flight. After takeoff every height is AMSL minus the AMSL height of the takeoff
ground, independent of the autopilot's home.
"""

import math
from dataclasses import dataclass, field, replace
from typing import TypeVar

from companion.core.mission.events import (
    AirPressure,
    Airspeed,
    ArmingReadiness,
    Attitude,
    AutopilotDetected,
    AutopilotKind,
    AutopilotWind,
    Battery,
    EstimatorHealth,
    Event,
    GnssFix,
    GroundState,
    Home,
    MissionProgress,
    ModeReport,
    Position,
    Throttle,
    VehicleLandedState,
    VehicleState,
)
from companion.core.pilot.observed_state import ObservedState
from companion.core.pilot.telemetry.pack_telemetry import BATTERY_MAX_AGE_S, PackTelemetry
from companion.core.pilot.telemetry.position_watch import PositionWatch

EventT = TypeVar("EventT", bound=Event)

POSITION_MAX_AGE_S = 1.0
ATTITUDE_MAX_AGE_S = 1.0
GNSS_MAX_AGE_S = 3.0
STATE_MAX_AGE_S = 3.5
PROGRESS_MAX_AGE_S = 3.0
AIRSPEED_MAX_AGE_S = 1.0
WIND_MAX_AGE_S = 2.0
GROUND_MAX_AGE_S = 1.5
"""Three messages at the 2 Hz requested from both autopilots."""

MIN_DISARMED_REPORTS = 2
"""Number of consecutive disarmed heartbeats accepted in flight: one may be wrong."""

MIN_MODE_GAP_S = 0.6
"""Both autopilots report the mode at 4 Hz or more. In a longer gap a person may have changed it and
changed it back. At lower rates a gap is 1.6 times the usual interval."""

PRESSURE_MAX_AGE_S = 3.0
"""Three messages at the 1 Hz requested from both autopilots."""


LATEST_FIELDS: dict[type[Event], str] = {
    GnssFix: "gnss",
    EstimatorHealth: "estimator",
    Home: "home",
    Throttle: "throttle",
    Airspeed: "airspeed",
    AirPressure: "pressure",
    AutopilotWind: "wind",
    MissionProgress: "progress",
    ArmingReadiness: "readiness",
}
"""Events of which the latest is kept unchanged, with its field."""


@dataclass(slots=True)
class TelemetryState:
    """The latest sample of each kind. Late samples never replace newer ones.

    After armed heartbeats a disarmed one is uncertain: `state` stays armed until the landed state
    agrees or the next heartbeat confirms it.
    """

    t_s: float = 0.0
    autopilot_kind: AutopilotKind | None = None
    """`None` until the autopilot is identified."""
    state: VehicleState | None = None
    attitude: Attitude | None = None
    position: Position | None = None
    gnss: GnssFix | None = None
    estimator: EstimatorHealth | None = None
    home: Home | None = None
    throttle: Throttle | None = None
    airspeed: Airspeed | None = None
    pressure: AirPressure | None = None
    wind: AutopilotWind | None = None
    progress: MissionProgress | None = None
    ground: GroundState | None = None
    readiness: ArmingReadiness | None = None
    ground_amsl_m: float | None = None
    """Ground at takeoff; `None` before: heights are above the autopilot's home."""
    home_below_ground_m: float = 0.0
    """Present depth of the autopilot's home below that ground."""
    pack: PackTelemetry = field(default_factory=PackTelemetry)
    observed: ObservedState = field(default_factory=ObservedState)
    position_watch: PositionWatch = field(default_factory=PositionWatch)
    disarmed_since_s: float | None = None
    """First of the latest heartbeats in a row that report disarmed."""
    _disarmed_reports: int = 0
    _mode_s: float | None = None
    """Time of the last mode report."""
    _mode_gap_s: float | None = None
    """End of the last gap in the mode reports."""
    _mode_interval_s: float = 0.0

    def store_event(self, event: Event) -> None:
        """Process one telemetry event."""
        self.t_s = max(self.t_s, event.t_s)
        mode = None if self.state is None else self.state.mode
        self.observed.store_event(event, mode, is_armed=self.armed)
        match event:
            case AutopilotDetected():
                self.autopilot_kind = event.autopilot_kind
            case VehicleState():
                self._store_heartbeat(event)
                self._record_mode_report(event.t_s)
            case ModeReport() if self.state is not None:
                self._record_mode_report(event.t_s)
                self.state = replace(self.state, mode=event.mode, mode_name=event.mode_name)
            case Attitude() if self.attitude is None or event.t_s >= self.attitude.t_s:
                self.attitude = event
            case Position() if self.position is None or event.t_s >= self.position.t_s:
                if self._is_plausible_position(event):
                    self.position = self._correct_height_to_takeoff_ground(event)
            case Battery():
                self.pack.store_message(
                    event, self.t_s, is_armed=self.armed, is_airborne=self.airborne
                )
            case GroundState():
                self.ground = event
                self._accept_disarmed_if_confirmed()
            case _ if type(event) in LATEST_FIELDS:
                setattr(self, LATEST_FIELDS[type(event)], event)
            case _:
                return

    def _is_plausible_position(self, position: Position) -> bool:
        if not self.airborne:
            self.position_watch = PositionWatch()
            return True
        gnss = self.recent_or_none(self.gnss, GNSS_MAX_AGE_S)
        return self.position_watch.accepts_report(position, gnss)

    def _record_mode_report(self, t_s: float) -> None:
        interval_s = t_s - (self._mode_s if self._mode_s is not None else t_s)
        if interval_s > max(MIN_MODE_GAP_S, 1.6 * self._mode_interval_s):
            self._mode_gap_s = t_s
        self._mode_s, self._mode_interval_s = t_s, interval_s

    def has_mode_gap_since(self, since_s: float) -> bool:
        """Return whether the mode may have changed and changed back unseen since then."""
        return self._mode_gap_s is not None and self._mode_gap_s >= since_s

    def _store_heartbeat(self, heartbeat: VehicleState) -> None:
        was_armed = self.armed
        self._disarmed_reports = 0 if heartbeat.armed else self._disarmed_reports + 1
        if self._disarmed_reports <= 1:
            self.disarmed_since_s = None if heartbeat.armed else heartbeat.t_s
        self.state = replace(heartbeat, armed=True) if was_armed else heartbeat
        self._accept_disarmed_if_confirmed()

    def _accept_disarmed_if_confirmed(self) -> None:
        """Accept the latest heartbeat as disarmed if another source confirms it."""
        if self.state is None or self._disarmed_reports == 0:
            return
        if self._disarmed_reports >= MIN_DISARMED_REPORTS or (
            self.landed_state is VehicleLandedState.ON_GROUND and self.on_ground
        ):
            self.state = replace(self.state, armed=False)

    def set_height_reference(self, ground_amsl_m: float | None) -> None:
        """Measure heights from this ground; `None`: from the autopilot's home."""
        self.ground_amsl_m = ground_amsl_m

    def _correct_height_to_takeoff_ground(self, position: Position) -> Position:
        """Return the position with its height above the takeoff ground.

        Whole centimetres: both altitudes come rounded to the millimetre.
        """
        ground_m = self.ground_amsl_m
        if ground_m is None:
            self.home_below_ground_m = 0.0
            return position
        self.home_below_ground_m = round(
            position.height_rel_m - (position.alt_amsl_m - ground_m), 2
        )
        return replace(position, height_rel_m=position.height_rel_m - self.home_below_ground_m)

    @property
    def battery(self) -> Battery | None:
        """The pack's state, merged from the messages about it."""
        return self.pack.battery

    def clear_samples(self) -> None:
        """Drop every sample: the autopilot rebooted."""
        for name in ("state", "attitude", "position", "ground", *LATEST_FIELDS.values()):
            setattr(self, name, None)
        self.pack = PackTelemetry(self.pack.voltage_range_v)
        self.observed = ObservedState()
        self.position_watch = PositionWatch()
        self._disarmed_reports = 0
        self.disarmed_since_s = None

    def is_recent(self, sample: Event | None, max_age_s: float) -> bool:
        """Return whether a sample exists and is not too old."""
        return sample is not None and self.t_s - sample.t_s <= max_age_s

    def recent_or_none(self, sample: EventT | None, max_age_s: float) -> EventT | None:
        """Return the sample if it is not too old."""
        return sample if self.is_recent(sample, max_age_s) else None

    @property
    def armed(self) -> bool:
        """Whether the last heartbeat reports armed."""
        return self.state is not None and self.state.armed

    @property
    def landed_state(self) -> VehicleLandedState | None:
        """State of the autopilot's landing detector; `None` without a recent report."""
        ground = self.recent_or_none(self.ground, GROUND_MAX_AGE_S)
        return None if ground is None else ground.ground

    @property
    def on_ground(self) -> bool:
        """Whether it is certainly on the ground: disarmed, or by the landing detector without
        evidence of flight.
        """
        if self.state is not None and not self.state.armed:
            return True
        detected = self.ground is not None and self.ground.ground is VehicleLandedState.ON_GROUND
        return detected and not self.observed.is_lifted(self.t_s)

    @property
    def airborne(self) -> bool:
        """Whether it is armed and not known to be on the ground."""
        return self.armed and not self.on_ground

    def ground_speed_mps(self) -> float:
        """Return the horizontal ground speed from the latest position; 0 without one."""
        position = self.position
        return math.hypot(position.vel_n_mps, position.vel_e_mps) if position is not None else 0.0

    def speed_3d_mps(self) -> float:
        """Return the speed in all three axes from the latest position; 0 without one."""
        down_mps = self.position.vel_d_mps if self.position is not None else 0.0
        return math.hypot(self.ground_speed_mps(), down_mps)

    def position_faults(self) -> tuple[str, ...]:
        """Return why the position is not good enough to plan or to clear a leg; empty if it is."""
        faults: list[str] = []
        if not self.is_recent(self.position, POSITION_MAX_AGE_S):
            faults.append(self.position_watch.reason or "no recent position")
        if not self.is_recent(self.gnss, GNSS_MAX_AGE_S):
            faults.append("no data from the GNSS receiver")
        elif self.gnss is not None and not self.gnss.usable:
            faults.append("no GNSS fix")
        if self.estimator is not None and not self.estimator.position_ok:
            faults.append("autopilot reports an invalid position")
        return tuple(faults)

    def command_faults(self) -> tuple[str, ...]:
        """Return which samples are too old or unknown to send commands; empty if all are recent."""
        faults = list(self.position_faults())
        for sample, max_age_s, text in (
            (self.attitude, ATTITUDE_MAX_AGE_S, "no recent attitude"),
            (self.state, STATE_MAX_AGE_S, "no recent heartbeat"),
            (self.progress, PROGRESS_MAX_AGE_S, "no recent mission progress"),
            (self.battery, BATTERY_MAX_AGE_S, "no recent battery reading"),
        ):
            if not self.is_recent(sample, max_age_s):
                faults.append(text)
        return tuple(faults)
