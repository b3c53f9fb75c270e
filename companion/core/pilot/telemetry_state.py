"""The newest telemetry of the vehicle, its age, and whether it is good enough to act on.

Heights have one truth here. An autopilot tells its height above its own home, and that home can be
moved in flight by anybody. Once the vehicle has taken off, every height is AMSL less the AMSL of
the ground that it took off from, whatever the autopilot's home is by then.
"""

import math
from dataclasses import dataclass, field, replace

from companion.core.mission.events import (
    AirPressure,
    Airspeed,
    ArmingReadiness,
    Attitude,
    AutopilotWind,
    Battery,
    EstimatorHealth,
    Event,
    GnssFix,
    Ground,
    GroundState,
    Home,
    MissionProgress,
    ModeNow,
    Position,
    Throttle,
    VehicleState,
)
from companion.core.vehicle.airframe import PLAUSIBLE_CELL_V

POSITION_MAX_AGE_S = 1.0
ATTITUDE_MAX_AGE_S = 1.0
GNSS_MAX_AGE_S = 3.0
STATE_MAX_AGE_S = 3.5
PROGRESS_MAX_AGE_S = 3.0
BATTERY_MAX_AGE_S = 5.0
AIRSPEED_MAX_AGE_S = 1.0
WIND_MAX_AGE_S = 2.0
GROUND_MAX_AGE_S = 1.5
"""Three of the 2 Hz that both autopilots are asked for."""

DISARMED_WITNESSES = 2
"""So many heartbeats in a row that say disarmed are believed in flight: one may be wrong."""

MODE_GAP_S = 0.6
"""Both autopilots report the mode at 4 Hz or more. In a longer gap a person may have changed it and
changed it back. Where it comes more slowly, a gap is 1.6 times the usual interval."""

SAME_PACK_FRAC = 0.05
"""Two voltages of one pack differ by less."""

THROTTLE_MAX_AGE_S = 1.0
PRESSURE_MAX_AGE_S = 3.0
"""Three of the 1 Hz that both autopilots are asked for."""


@dataclass(slots=True)
class TelemetryState:
    """The newest sample of each kind. Late samples never replace newer ones.

    A heartbeat that says disarmed after armed ones is doubt, and `state` stays armed, until the
    autopilot's landed-state agrees or the next heartbeat says it again.
    """

    t_s: float = 0.0
    state: VehicleState | None = None
    attitude: Attitude | None = None
    position: Position | None = None
    gnss: GnssFix | None = None
    estimator: EstimatorHealth | None = None
    home: Home | None = None
    battery: Battery | None = None
    throttle: Throttle | None = None
    airspeed: Airspeed | None = None
    pressure: AirPressure | None = None
    wind: AutopilotWind | None = None
    progress: MissionProgress | None = None
    ground: GroundState | None = None
    readiness: ArmingReadiness | None = None
    ground_amsl_m: float | None = None
    """The ground that it took off from; `None` before: heights are above the autopilot's home."""
    home_sunk_m: float = 0.0
    """By how much the autopilot's home lies below that ground now."""
    batteries: dict[int | None, Battery] = field(default_factory=dict)
    """The newest battery message of each monitor, and of the whole vehicle (`None`)."""
    _pack_v: tuple[float, float] = (PLAUSIBLE_CELL_V[0], math.inf)
    _pack: int = 0
    """The monitor that measures the pack: by its voltage, then its current, then its number."""
    _measured: dict[int, Battery] = field(default_factory=dict)
    _battery_times: dict[str, float] = field(default_factory=dict)
    disarmed_since_s: float | None = None
    """When the first of the newest heartbeats came that all say disarmed."""
    _disarmed_reports: int = 0
    _mode_s: float | None = None
    """When the mode was reported last."""
    _mode_gap_s: float | None = None
    """When the last gap in the reports of the mode ended."""
    _mode_every_s: float = 0.0

    def expecting(self, pack_v: tuple[float, float]) -> "TelemetryState":
        """The same, of a vehicle whose pack has a voltage from the first to the second."""
        self._pack_v = pack_v
        return self

    def update(self, event: Event) -> None:
        """Take one telemetry event."""
        self.t_s = max(self.t_s, event.t_s)
        match event:
            case VehicleState():
                self._take_heartbeat(event)
                self._note_mode(event.t_s)
            case ModeNow() if self.state is not None:
                self._note_mode(event.t_s)
                self.state = replace(self.state, mode=event.mode, mode_name=event.mode_name)
            case Attitude() if self.attitude is None or event.t_s >= self.attitude.t_s:
                self.attitude = event
            case Position() if self.position is None or event.t_s >= self.position.t_s:
                self.position = self._above_ground(event)
            case GnssFix():
                self.gnss = event
            case EstimatorHealth():
                self.estimator = event
            case Home():
                self.home = event
            case Battery():
                self._take_battery(event)
            case Throttle():
                self.throttle = event
            case Airspeed():
                self.airspeed = event
            case AirPressure():
                self.pressure = event
            case AutopilotWind():
                self.wind = event
            case MissionProgress():
                self.progress = event
            case GroundState():
                self.ground = event
                self._believe_disarmed()
            case ArmingReadiness():
                self.readiness = event
            case _:
                return

    def _note_mode(self, t_s: float) -> None:
        interval_s = t_s - (self._mode_s if self._mode_s is not None else t_s)
        if interval_s > max(MODE_GAP_S, 1.6 * self._mode_every_s):
            self._mode_gap_s = t_s
        self._mode_s, self._mode_every_s = t_s, interval_s

    def has_mode_gap_since(self, then_s: float) -> bool:
        """Tell whether the mode may have changed and changed back unseen since then."""
        return self._mode_gap_s is not None and self._mode_gap_s >= then_s

    def _take_heartbeat(self, new: VehicleState) -> None:
        was_armed = self.armed
        self._disarmed_reports = 0 if new.armed else self._disarmed_reports + 1
        if self._disarmed_reports <= 1:
            self.disarmed_since_s = None if new.armed else new.t_s
        self.state = replace(new, armed=True) if was_armed else new
        self._believe_disarmed()

    def _believe_disarmed(self) -> None:
        """Take the newest heartbeat's word for it, where something else says the same."""
        if self.state is None or self._disarmed_reports == 0:
            return
        if self._disarmed_reports >= DISARMED_WITNESSES or self.landed_state is Ground.ON_GROUND:
            self.state = replace(self.state, armed=False)

    def measure_heights_from(self, ground_amsl_m: float | None) -> None:
        """Count heights from this ground; `None`: from the autopilot's home."""
        self.ground_amsl_m = ground_amsl_m

    def _above_ground(self, told: Position) -> Position:
        """The position with its height above the ground that it took off from.

        Whole centimetres: both altitudes come rounded to the millimetre.
        """
        ground_m = self.ground_amsl_m
        if ground_m is None:
            self.home_sunk_m = 0.0
            return told
        self.home_sunk_m = round(told.height_rel_m - (told.alt_amsl_m - ground_m), 2)
        return replace(told, height_rel_m=told.height_rel_m - self.home_sunk_m)

    def _take_battery(self, new: Battery) -> None:
        self.batteries[new.pack] = new
        if new.pack is not None and new.voltage_v is not None:
            self._measured[new.pack] = new
        if not (self.armed and self._pack in self._measured):  # in flight it stays the same pack
            known = [k for k in self._measured or self.batteries if k is not None]
            before, self._pack = self._pack, max(known, key=self._evidence, default=0)
            if before != self._pack:
                self.battery = None
        if new.pack in (self._pack, None) and self._is_of_pack(new):
            self.battery = self._merged(new)

    def _volts(self, monitor: int) -> float:
        seen = self._measured.get(monitor)
        return 0.0 if seen is None else seen.voltage_v or 0.0

    def _fits(self, monitor: int) -> bool:
        return self._pack_v[0] <= self._volts(monitor) <= self._pack_v[1]

    def _evidence(self, monitor: int) -> tuple[bool, bool, bool, int]:
        seen = self._measured.get(monitor)
        has_current = seen is not None and seen.current_a is not None
        return self._fits(monitor), self.is_fresh(seen, BATTERY_MAX_AGE_S), has_current, -monitor

    def _is_of_pack(self, new: Battery) -> bool:
        """Whether a message is about a pack; of SYS_STATUS its voltage tells."""
        if new.pack is not None:
            return new.pack == self._pack or self._fits(new.pack)
        off_v = abs((new.voltage_v or 0.0) - self._volts(self._pack))
        return self._pack == 0 or off_v < SAME_PACK_FRAC * self._volts(self._pack)

    @property
    def pack_messages(self) -> list[Battery]:
        """The newest messages about packs; a charge of a monitor without a voltage is of none."""
        return [new for new in self.batteries.values() if self._is_of_pack(new)]

    def pack_missing(self) -> str:
        """Why no monitor is known to measure the pack; `""` where one is."""
        battery = self.battery if self.is_fresh(self.battery, BATTERY_MAX_AGE_S) else None
        if battery is not None and (battery.voltage_v, battery.current_a) != (None, None):
            return ""
        fresh = [b for b in self.batteries.values() if self.is_fresh(b, BATTERY_MAX_AGE_S)]
        received = ", ".join(map(_charge_reported, fresh)) or "nothing"
        return f"no battery voltage: received {received}; expected a monitor that measures the pack"

    @property
    def pack_notes(self) -> list[str]:
        """Which monitor measures the pack, where it is not the first."""
        seen = self._measured.get(self._pack) if self._pack else None
        return [f"the pack is {_charge_reported(seen)}, by its voltage"] if seen else []

    def _merged(self, new: Battery) -> Battery:
        """Merge the two messages about the pack; a field stays until reported again or too old."""
        fields: dict[str, float | None] = {}
        for name in (
            "voltage_v",
            "current_a",
            "consumed_ah",
            "consumed_j",
            "remaining_frac",
            "temperature_c",
        ):
            value = getattr(new, name)
            if value is not None:
                self._battery_times[name] = new.t_s
            elif (
                self.battery is not None
                and (told_s := self._battery_times.get(name)) is not None
                and new.t_s - told_s <= BATTERY_MAX_AGE_S
            ):
                value = getattr(self.battery, name)
            fields[name] = value
        return Battery(new.t_s, **fields, pack=None)

    @property
    def current_age_s(self) -> float:
        """How long ago the battery last told its current; infinite where it never did."""
        told_s = self._battery_times.get("current_a")
        return math.inf if told_s is None else self.t_s - told_s

    def forget(self) -> None:
        """Drop every sample: the autopilot rebooted."""
        t_s = self.t_s
        for name in (
            "state", "attitude", "position", "gnss", "estimator", "home", "battery", "throttle",
            "airspeed", "pressure", "wind", "progress", "ground", "readiness",
        ):  # fmt: skip
            setattr(self, name, None)
        self._battery_times.clear()
        self._disarmed_reports = 0
        self.disarmed_since_s = None
        self.batteries.clear()
        self._measured.clear()
        self.t_s = t_s

    def is_fresh(self, sample: Event | None, max_age_s: float) -> bool:
        """Tell whether a sample exists and is not too old."""
        return sample is not None and self.t_s - sample.t_s <= max_age_s

    @property
    def armed(self) -> bool:
        """Armed by the last heartbeat."""
        return self.state is not None and self.state.armed

    @property
    def landed_state(self) -> Ground | None:
        """What the autopilot's own detector says; `None` where it says nothing (any more)."""
        ground = self.ground
        fresh = self.is_fresh(ground, GROUND_MAX_AGE_S)
        return ground.ground if ground is not None and fresh else None

    @property
    def failing(self) -> bool:
        """The autopilot calls its own state critical."""
        return self.state is not None and self.state.failsafe

    @property
    def on_ground(self) -> bool:
        """Certainly on the ground: disarmed, or the autopilot's detector says so."""
        if self.state is not None and not self.state.armed:
            return True
        return self.ground is not None and self.ground.ground is Ground.ON_GROUND

    @property
    def airborne(self) -> bool:
        """Armed, and not known to stand on the ground."""
        return self.armed and not self.on_ground

    def position_troubles(self) -> tuple[str, ...]:
        """Say why the position is not good enough to plan or to give leave on; empty when it is."""
        troubles: list[str] = []
        if not self.is_fresh(self.position, POSITION_MAX_AGE_S):
            troubles.append("no fresh position")
        if not self.is_fresh(self.gnss, GNSS_MAX_AGE_S):
            troubles.append("nothing heard of the satellite receiver")
        elif self.gnss is not None and not self.gnss.usable:
            troubles.append("no satellite fix")
        if self.estimator is not None and not self.estimator.position_ok:
            troubles.append("the autopilot does not trust its position")
        return tuple(troubles)

    def troubles(self) -> tuple[str, ...]:
        """Say what is too old or unknown to command on; empty when everything is fresh."""
        troubles = list(self.position_troubles())
        for sample, max_age_s, words in (
            (self.attitude, ATTITUDE_MAX_AGE_S, "no fresh attitude"),
            (self.state, STATE_MAX_AGE_S, "no fresh heartbeat"),
            (self.progress, PROGRESS_MAX_AGE_S, "no fresh mission progress"),
            (self.battery, BATTERY_MAX_AGE_S, "no fresh battery reading"),
        ):
            if not self.is_fresh(sample, max_age_s):
                troubles.append(words)
        return tuple(troubles)


def _charge_reported(new: Battery) -> str:
    monitor = "SYS_STATUS" if new.pack is None else f"battery {new.pack}"
    return monitor if new.remaining_frac is None else f"{monitor} at {new.remaining_frac:.0%}"
