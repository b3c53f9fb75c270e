"""Events: all inputs of the core, in SI units and the same for every autopilot.

Adapters create them from MAVLink messages and stamp them with the autopilot's clock (`t_s`,
monotonic). Mission indices count the uploaded items from 0. Unknown is `None`.
"""

from dataclasses import dataclass, field
from enum import Enum

from companion.core.separation.track import Track
from companion.core.wind_field.shared_winds import SharedWinds


class AutopilotKind(Enum):
    """Autopilot firmware: the two differ in the meaning of orders."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class Mode(Enum):
    """Flight modes relevant to control authority. Any other mode is a takeover."""

    MISSION = "mission"
    RTL = "return to launch"
    LAND = "land"
    HOLD = "hold"
    GUIDED = "guided"
    TAKEOFF = "takeoff"
    OTHER = "other"


class VehicleLandedState(Enum):
    """Landed state as reported by the autopilot."""

    ON_GROUND = "on ground"
    IN_AIR = "in air"
    TAKEOFF = "taking off"
    LANDING = "landing"


class MissionState(Enum):
    """State of the onboard mission (MISSION_CURRENT.mission_state)."""

    NO_MISSION = "no mission"
    NOT_STARTED = "not started"
    ACTIVE = "active"
    PAUSED = "paused"
    COMPLETE = "complete"


@dataclass(frozen=True, slots=True)
class Event:
    """An event at time `t_s` on the autopilot's clock."""

    t_s: float


@dataclass(frozen=True, slots=True)
class Tick(Event):
    """A time step: every telemetry message up to `t_s` has been processed.

    `is_backlog`: further messages are queued. The estimators are updated; no decision is taken.
    """

    is_backlog: bool = False


# --- telemetry ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class AutopilotDetected(Event):
    """An autopilot was detected by several heartbeats."""

    autopilot_kind: AutopilotKind
    system_id: int


@dataclass(frozen=True, slots=True)
class BoardIdReceived(Event):
    """Identifier of the flight controller (AUTOPILOT_VERSION) in hexadecimal, or "" for none."""

    board_id: str


@dataclass(frozen=True, slots=True)
class UnrestoredSettings(Event):
    """Original values of settings that an earlier flight changed and did not restore."""

    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class VehicleState(Event):
    """A heartbeat of the autopilot. `failsafe`: it reports state critical or emergency."""

    mode: Mode
    mode_name: str
    armed: bool
    failsafe: bool = False
    ready_state: bool = True


@dataclass(frozen=True, slots=True)
class ModeReport(Event):
    """The flight mode between two heartbeats, from autopilots that report it."""

    mode: Mode
    mode_name: str


@dataclass(frozen=True, slots=True)
class Attitude(Event):
    """Body attitude, heading clockwise from north, and the rates of the gyro (roll, pitch)."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_rps: float | None = None
    tilt_rates_rps: tuple[float | None, float | None] = field(default=(None, None), kw_only=True)


@dataclass(frozen=True, slots=True)
class Position(Event):
    """The autopilot's fused position and velocity (NED); height relative to its home."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    height_rel_m: float
    vel_n_mps: float
    vel_e_mps: float
    vel_d_mps: float


@dataclass(frozen=True, slots=True)
class AirPressure(Event):
    """Barometric pressure, and the temperature of the sensor's board."""

    pressure_pa: float
    board_temperature_c: float | None = None


@dataclass(frozen=True, slots=True)
class GnssFix(Event):
    """Fix of the GNSS receiver. `usable`: 3-D fix or better. `gnss_alt_m`: its height AMSL."""

    usable: bool
    satellites: int | None = None
    gnss_alt_m: float | None = None
    gnss_alt_std_m: float | None = None
    lat_lon_deg: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class EstimatorHealth(Event):
    """Whether the autopilot's estimator reports a valid horizontal position."""

    position_ok: bool


@dataclass(frozen=True, slots=True)
class Home(Event):
    """Home position of the autopilot (destination of RTL)."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class Battery(Event):
    """Battery measurements; unknown fields are `None`.

    `pack`: its number (BATTERY_STATUS.id); `None`: totals of the whole vehicle (SYS_STATUS).
    """

    voltage_v: float | None = None
    current_a: float | None = None
    consumed_ah: float | None = None
    consumed_j: float | None = None
    remaining_frac: float | None = None
    temperature_c: float | None = None
    pack: int | None = None


@dataclass(frozen=True, slots=True)
class Throttle(Event):
    """Mean thrust command, 0 to 1: it falls at the release, also without a current sensor."""

    throttle_frac: float


@dataclass(frozen=True, slots=True)
class Airspeed(Event):
    """Airspeed reading along the body's forward axis.

    `is_magnitude`: from an anemometer that turns into the wind; in recordings only.
    """

    forward_mps: float
    is_magnitude: bool = False


@dataclass(frozen=True, slots=True)
class AutopilotWind(Event):
    """The autopilot's own measured wind estimate: direction of flow (to)."""

    to_n_mps: float
    to_e_mps: float
    std_mps: float | None = None


@dataclass(frozen=True, slots=True)
class MissionProgress(Event):
    """The current item (`None`: not an uploaded one) and the number of onboard items (0: no
    mission).

    `in_mission`: whether it flies the mission, if reported. `mission_id`: a number that changes
    with the list (PX4 1.15 and later). `mission_state`: state of the mission, if reported.
    """

    index: int | None
    total: int | None = None
    in_mission: bool | None = None
    mission_id: int | None = None
    mission_state: MissionState | None = None


@dataclass(frozen=True, slots=True)
class ItemReached(Event):
    """A mission item was completed."""

    index: int


@dataclass(frozen=True, slots=True)
class GroundState(Event):
    """Landed state from the autopilot's detector."""

    ground: VehicleLandedState


@dataclass(frozen=True, slots=True)
class ArmingReadiness(Event):
    """Result of the autopilot's pre-arm check."""

    ready: bool


@dataclass(frozen=True, slots=True)
class ReleaseFeedback(Event):
    """The gripper reports that the parcel was released."""


@dataclass(frozen=True, slots=True)
class AutopilotText(Event):
    """A status text of the autopilot, for the log."""

    severity: int
    text: str


@dataclass(frozen=True, slots=True)
class AutopilotParameters(Event):
    """Requested parameters; `None` if the autopilot has no such parameter. `unanswered`: names
    without a response, which may exist.
    """

    values: dict[str, float | None]
    unanswered: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ParametersAwaited(Event):
    """Parameters that were requested long ago and are still awaited."""

    names: tuple[str, ...]


# --- responses to actions ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StreamsConfigured(Event):
    """Every telemetry request has a response; `refused` names the streams that were not granted."""

    refused: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class MissionUploaded(Event):
    """An upload ended; `reason` is `None` when the autopilot accepted it. `superseded`: another
    station wrote the mission meanwhile."""

    reason: str | None = None
    superseded: bool = False


@dataclass(frozen=True, slots=True)
class MissionVerified(Event):
    """Differences between the onboard mission and the uploaded one, one line each; empty if none.

    Not `complete`: the download failed, and the only line states the reason.
    """

    differences: tuple[str, ...]
    complete: bool = True


@dataclass(frozen=True, slots=True)
class MissionWriteDetected(Event):
    """Another station wrote to the onboard mission; detected from its messages on the link."""

    description: str


@dataclass(frozen=True, slots=True)
class OtherStationModeCommand(Event):
    """The autopilot has accepted another station's mode command; it may be the present mode."""


SET_HOME = "set home"
"""Name of the order that moves the autopilot's home."""


@dataclass(frozen=True, slots=True)
class OrderRefused(Event):
    """The autopilot refused an order, or did not respond and may have executed it."""

    order: str
    reason: str
    is_response: bool = True
    mode: Mode | None = None
    """The mode that the order sets; `None`: another order."""


@dataclass(frozen=True, slots=True)
class MessageRequestRefused(Event):
    """The autopilot refused to send this message, or did not respond."""

    message_name: str


@dataclass(frozen=True, slots=True)
class OrderAccepted(Event):
    """The autopilot acknowledged an order. Telemetry has yet to confirm its effect."""

    order: str


@dataclass(frozen=True, slots=True)
class ParametersSet(Event):
    """`--configure` has ended; `failed` names parameters that could not be set or verified."""

    failed: tuple[str, ...] = ()


# --- operator, fleet, link and clock -------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class MissionAuthorised(Event):
    """An operator authorises this mission."""

    by: str


@dataclass(frozen=True, slots=True)
class OperatorMessageReceived(Event):
    """A message arrived from an accepted ground station or desk."""


@dataclass(frozen=True, slots=True)
class ControlHandedBack(Event):
    """An operator hands control (back) to the companion."""

    by: str


@dataclass(frozen=True, slots=True)
class ControlReleaseOrdered(Event):
    """An operator commands the companion to release control."""

    by: str


@dataclass(frozen=True, slots=True)
class AbortOrdered(Event):
    """An operator orders an immediate return."""

    by: str


@dataclass(frozen=True, slots=True)
class LimitsChanged(Event):
    """An operator changed the accepted limits."""

    max_loss: float | None = None
    reserve_frac: float | None = None


@dataclass(frozen=True, slots=True)
class HomeStopRequested(Event):
    """The truck promises another landing stop, given by its name or its position."""

    by: str
    stop: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None


@dataclass(frozen=True, slots=True)
class GnssTime(Event):
    """Time reported by the autopilot's GNSS receiver, seconds since 1970."""

    unix_s: float


@dataclass(frozen=True, slots=True)
class NeighbourTrackReceived(Event):
    """A track of another vehicle. `fleet`: its neighbouring fleet; empty: its own."""

    track: Track
    fleet: str = ""

    @property
    def full_vehicle_name(self) -> str:
        """Name of the vehicle: `d2`, or `north-2/d2`, since two fleets may use the same names."""
        return f"{self.fleet}/{self.track.vehicle}" if self.fleet else self.track.vehicle


@dataclass(frozen=True, slots=True)
class FleetWindReceived(Event):
    """Wind reports of other vehicles, from the desk; valid from `age_s` before reception on."""

    winds: SharedWinds
    age_s: float


CONTROL_CLAIM = "LW_SINCE"
"""Named value in seconds from which two companions decide which of them has control."""

CONTROL_CLAIM_STEP_S = 0.1
"""Resolution that a 32-bit float keeps exact for nine days."""


@dataclass(frozen=True, slots=True)
class OtherCompanionReport(Event):
    """Another onboard computer is active: a companion, or one that claims control.

    `has_control`: it claims control. `control_since_ms`: start of its control of this flight on the
    autopilot's clock; None: not reported.
    """

    active: bool
    booting: bool = False
    component: int = 191
    has_control: bool = False
    control_since_ms: int | None = None


@dataclass(frozen=True, slots=True)
class LinkSilent(Event):
    """No message has arrived from the autopilot for a while (wall clock)."""


@dataclass(frozen=True, slots=True)
class LinkRecovered(Event):
    """Messages of the autopilot arrive again after `gap_s` of its own time."""

    gap_s: float


@dataclass(frozen=True, slots=True)
class ClockSteppedBack(Event):
    """The autopilot's clock went back by `back_s`: a reboot, or a clock fault."""

    back_s: float


@dataclass(frozen=True, slots=True)
class ClockJumpedForward(Event):
    """The autopilot's clock jumped forward by `jump_s` between two messages; above
    `MAX_TELEMETRY_GAP_S` the time did not pass.
    """

    jump_s: float
