"""Events: everything that enters the core, in SI units and the same for every autopilot.

Adapters make them from MAVLink and stamp them with the autopilot's clock (`t_s`, monotonic).
Mission indices count our own items (0 is the first that we uploaded). Unknown is `None`.
"""

from dataclasses import dataclass
from enum import Enum

from companion.core.separation.track import Track
from companion.core.wind_field.shared_winds import SharedWinds


class AutopilotKind(Enum):
    """Which autopilot: they differ in what an order means."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class Mode(Enum):
    """The modes that matter to authority; everything else flies by somebody else's hand."""

    MISSION = "mission"
    RTL = "return to launch"
    LAND = "land"
    HOLD = "hold"
    GUIDED = "guided"
    TAKEOFF = "takeoff"
    OTHER = "other"


class Ground(Enum):
    """What the autopilot says of the ground under it."""

    ON_GROUND = "on ground"
    IN_AIR = "in air"
    TAKING_OFF = "taking off"
    LANDING = "landing"


@dataclass(frozen=True, slots=True)
class Event:
    """Something happened at `t_s` on the autopilot's clock."""

    t_s: float


@dataclass(frozen=True, slots=True)
class Tick(Event):
    """Time passed; every telemetry message up to `t_s` has been heard.

    `late`: more waits to be heard. The estimators take the moment in; nothing is decided on it.
    """

    late: bool = False


# --- telemetry ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Identified(Event):
    """An autopilot was recognised by several heartbeats."""

    autopilot_kind: AutopilotKind
    system_id: int


@dataclass(frozen=True, slots=True)
class BoardKnown(Event):
    """The flight controller told its own number (AUTOPILOT_VERSION): hex digits, or "" for none."""

    board: str


@dataclass(frozen=True, slots=True)
class SettingsLeft(Event):
    """Settings of this vehicle's that an earlier flight changed and did not put back: its own."""

    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class VehicleState(Event):
    """A heartbeat of the autopilot. `failsafe` = it calls its state critical or emergency."""

    mode: Mode
    mode_name: str
    armed: bool
    failsafe: bool = False
    ready_state: bool = True


@dataclass(frozen=True, slots=True)
class ModeNow(Event):
    """The flight mode between two heartbeats, where the autopilot tells it."""

    mode: Mode
    mode_name: str


@dataclass(frozen=True, slots=True)
class Attitude(Event):
    """Body attitude, heading clockwise from north, and the rate that the gyro reports of it."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_rps: float | None = None


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
    """The barometer's pressure, and the temperature of the board that it sits on."""

    pressure_pa: float
    board_temperature_c: float | None = None


@dataclass(frozen=True, slots=True)
class GnssFix(Event):
    """The receiver's own word; `usable` = a 3-D fix or better."""

    usable: bool
    satellites: int | None = None


@dataclass(frozen=True, slots=True)
class EstimatorHealth(Event):
    """Whether the autopilot's own estimator trusts its horizontal position."""

    position_ok: bool


@dataclass(frozen=True, slots=True)
class Home(Event):
    """Where the autopilot thinks home is (RTL goes there)."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class Battery(Event):
    """What the battery monitor knows; each field `None` where it knows nothing.

    `pack`: whose (BATTERY_STATUS.id); `None` for what speaks of the whole vehicle (SYS_STATUS).
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
    """Mean thrust command, 0 to 1: falls when the parcel goes, current sensor or not."""

    throttle_frac: float


@dataclass(frozen=True, slots=True)
class Airspeed(Event):
    """A pitot's reading along the body's forward axis.

    `is_magnitude`: of an anemometer that turns into the wind; only recordings have such.
    """

    forward_mps: float
    is_magnitude: bool = False


@dataclass(frozen=True, slots=True)
class AutopilotWind(Event):
    """The autopilot's own, real wind estimate: where the air moves TO."""

    to_n_mps: float
    to_e_mps: float
    std_mps: float | None = None


@dataclass(frozen=True, slots=True)
class MissionProgress(Event):
    """The item that the autopilot flies (`None`: none of ours) and how many items it holds (0: no
    mission aboard).

    `in_mission`: whether it flies the mission at all, where it tells. `mission_id`: a number that
    changes with the list, where the autopilot sends one (PX4 1.15 and later).
    """

    index: int | None
    total: int | None = None
    in_mission: bool | None = None
    mission_id: int | None = None


@dataclass(frozen=True, slots=True)
class ItemReached(Event):
    """An item was completed."""

    index: int


@dataclass(frozen=True, slots=True)
class GroundState(Event):
    """Landed or not, by the autopilot's detector."""

    ground: Ground


@dataclass(frozen=True, slots=True)
class ArmingReadiness(Event):
    """The autopilot's own pre-arm check."""

    ready: bool


@dataclass(frozen=True, slots=True)
class ReleaseFeedback(Event):
    """The gripper itself says whether it let go."""

    released: bool


@dataclass(frozen=True, slots=True)
class AutopilotText(Event):
    """A sentence of the autopilot, for the log."""

    severity: int
    text: str


@dataclass(frozen=True, slots=True)
class AutopilotParameters(Event):
    """Parameters that were asked for; `None` where the autopilot has no such parameter."""

    values: dict[str, float | None]


# --- answers to actions ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StreamsAsked(Event):
    """Every telemetry request has been answered; `refused` names those that were not granted."""

    refused: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class MissionUploaded(Event):
    """An upload ended; `reason` is `None` when the autopilot accepted it."""

    reason: str | None = None


@dataclass(frozen=True, slots=True)
class MissionReadBack(Event):
    """What differs between the mission aboard and ours: nothing, or a line for each difference.

    Not `complete`: it could not be read, and the only line says why.
    """

    differences: tuple[str, ...]
    complete: bool = True


@dataclass(frozen=True, slots=True)
class MissionTouched(Event):
    """Somebody else wrote to the mission aboard, as was overheard."""

    words: str


@dataclass(frozen=True, slots=True)
class OrderRefused(Event):
    """The autopilot refused an order, or never answered it: then it may have been obeyed."""

    order: str
    reason: str
    answered: bool = True


@dataclass(frozen=True, slots=True)
class OrderAccepted(Event):
    """The autopilot acknowledged an order. That is not a fact yet: telemetry confirms it."""

    order: str


@dataclass(frozen=True, slots=True)
class ParametersSet(Event):
    """`--configure` is through; `failed` names what could not be set or read back."""

    failed: tuple[str, ...] = ()


# --- operator and the rest of the world ---------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Authorised(Event):
    """An operator authorises this mission."""

    by: str


@dataclass(frozen=True, slots=True)
class OperatorReached(Event):
    """A message arrived from a ground station or a desk whose commands count."""


@dataclass(frozen=True, slots=True)
class ControlHandedBack(Event):
    """An operator hands control (back) to the companion."""

    by: str


@dataclass(frozen=True, slots=True)
class ControlTaken(Event):
    """An operator tells the companion to keep its hands off."""

    by: str


@dataclass(frozen=True, slots=True)
class AbortOrdered(Event):
    """An operator wants the vehicle home now."""

    by: str


@dataclass(frozen=True, slots=True)
class LimitsChanged(Event):
    """An operator changed what they accept."""

    max_loss: float | None = None
    reserve_frac: float | None = None


@dataclass(frozen=True, slots=True)
class HomeMoved(Event):
    """The truck promises another stop: by its name, or by where its pad is."""

    by: str
    stop: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None


@dataclass(frozen=True, slots=True)
class GnssTime(Event):
    """What the autopilot's satellite receiver says of the time, seconds since 1970."""

    unix_s: float


@dataclass(frozen=True, slots=True)
class NeighbourHeard(Event):
    """Another vehicle told where it is. `fleet`: the neighbouring fleet that it is of; empty: our
    own.
    """

    track: Track
    fleet: str = ""

    @property
    def name(self) -> str:
        """As we call it: `d2`, or `north-2/d2`, since two fleets may have the same names."""
        return f"{self.fleet}/{self.track.vehicle}" if self.fleet else self.track.vehicle


@dataclass(frozen=True, slots=True)
class WindsTold(Event):
    """The desk told the winds that others feel; it was valid from `age_s` before on."""

    winds: SharedWinds
    age_s: float


CLAIM = "LW_SINCE"
"""The named value by which two companions tell which of them flies, in seconds."""

CLAIM_STEP_S = 0.1
"""Told in a 32-bit float, such a step stays exact for nine days."""


@dataclass(frozen=True, slots=True)
class OtherComputer(Event):
    """Another onboard computer speaks on this system: a companion, or one that says it flies.

    `flies`: it says so. `since_ms`: on the autopilot's clock, from when on it has flown this
    flight; None where it does not say.
    """

    active: bool
    booting: bool = False
    component: int = 191
    flies: bool = False
    since_ms: int | None = None


@dataclass(frozen=True, slots=True)
class LinkSilent(Event):
    """Nothing has come from the autopilot for a while (by the wall clock)."""


@dataclass(frozen=True, slots=True)
class LinkBack(Event):
    """The autopilot is heard again after `gap_s` of its own time."""

    gap_s: float


@dataclass(frozen=True, slots=True)
class ClockStepped(Event):
    """The autopilot's clock went back by `back_s`: a reboot, or a clock fault."""

    back_s: float


@dataclass(frozen=True, slots=True)
class ClockLeapt(Event):
    """The autopilot's clock leapt ahead by `ahead_s` between two messages."""

    ahead_s: float
