"""Actions: what the pilot asks for. Adapters turn them into what the autopilot understands."""

from dataclasses import dataclass, field
from enum import Enum, IntEnum

from companion.core.mission.events import Mode
from companion.core.mission.mission_items import MissionItem
from companion.core.monitor.figures import FlightFigures


@dataclass(frozen=True, slots=True)
class Action:
    """Something to do."""


# --- orders to the autopilot: only in COMMANDING_PHASES (safety rule 1) ---------------------------


@dataclass(frozen=True, slots=True)
class Order(Action):
    """Goes to the autopilot."""


@dataclass(frozen=True, slots=True)
class AskTelemetry(Order):
    """Ask for every stream that the mission needs."""


@dataclass(frozen=True, slots=True)
class AskBoard(Order):
    """Ask for the flight controller's own number."""


@dataclass(frozen=True, slots=True)
class AskParameters(Order):
    """Read the autopilot parameters that the promise rests on."""

    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Configure(Order):
    """Set autopilot parameters and read them back (`--configure`, and the old ones at the end)."""

    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class UploadMission(Order):
    """Put this mission aboard."""

    items: tuple[MissionItem, ...]


@dataclass(frozen=True, slots=True)
class ClearMission(Order):
    """Take the mission off the vehicle; a `MissionUploaded` tells how that ended."""


@dataclass(frozen=True, slots=True)
class ReadMissionBack(Order):
    """Download the mission aboard and compare it with this one.

    `pace_s`: so long between two items; 0: as fast as the link is. `first_only`: end at the first
    item that differs. `window`: requests sent at a time, where the autopilot answers several.
    """

    items: tuple[MissionItem, ...]
    pace_s: float = 0.0
    first_only: bool = False
    window: int = 1


@dataclass(frozen=True, slots=True)
class SetMode(Order):
    """Change the flight mode."""

    mode: Mode


@dataclass(frozen=True, slots=True)
class Arm(Order):
    """Arm, with the autopilot's own checks on."""


@dataclass(frozen=True, slots=True)
class Disarm(Order):
    """Plain disarm, never forced."""


@dataclass(frozen=True, slots=True)
class JumpTo(Order):
    """Go on with the mission at this item.

    `passes`: items that show, too, that it was obeyed: the autopilot comes to them by itself, and
    may be there before it tells of this one.
    """

    index: int
    passes: frozenset[int] = field(default=frozenset(), compare=False)


@dataclass(frozen=True, slots=True)
class SetGroundSpeed(Order):
    """Fly legs at this ground speed."""

    ground_speed_mps: float


@dataclass(frozen=True, slots=True)
class SetHome(Order):
    """Make this place the autopilot's home again."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class Release(Order):
    """Let the parcel go."""


@dataclass(frozen=True, slots=True)
class FlyVelocity(Order):
    """A set-point: a velocity over ground, NED, and how it is changing."""

    vel_ned_mps: tuple[float, float, float]
    accel_ned_mps2: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class DropOrders(Action):
    """Forget every order that is still being sent, retried or waited for."""


# --- to everybody else ----------------------------------------------------------------------------


class Severity(IntEnum):
    """As MAV_SEVERITY numbers them."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


@dataclass(frozen=True, slots=True)
class Say(Action):
    """One sentence for the operator (STATUSTEXT, 249 bytes of it) and the log."""

    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class Note(Action):
    """One line for the log only."""

    text: str


@dataclass(frozen=True, slots=True)
class TellPlace(Action):
    """Where we are and where to, for the neighbours; the fleet's port adds our name."""

    gnss_s: float
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    vel_ned_mps: tuple[float, float, float]
    aside: bool
    to_lat_deg: float | None = None
    to_lon_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Publish(Action):
    """Named numbers for any ground station (NAMED_VALUE_FLOAT); unknown ones are left out."""

    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class Decision(Action):
    """A decision with the probabilities that it rests on (docs/reference/outcomes.md)."""

    t_s: float
    kind: str
    reason: str
    p_home: float | None = None
    p_home_now: float | None = None
    p_success: float | None = None
    margin_wh: float | None = None


@dataclass(frozen=True, slots=True)
class Assessed(Action):
    """The gate's answer at one instant, for the record and the picture."""

    t_s: float
    p_home: float
    p_home_now: float
    p_success: float
    margin_wh: float
    energy_left_wh: float
    energy_need_wh: float
    p_home_unattended: float | None = None
    by_table: bool = False
    """Always False: readers of result.json expect the key."""


class Reply(Enum):
    """How an operator's order was taken."""

    ACCEPTED = "accepted"
    LATER = "not now"
    DENIED = "denied"


@dataclass(frozen=True, slots=True)
class Answer(Action):
    """The reply to the operator's order that was just heard, with its reason where one is told."""

    reply: Reply
    reason: str = ""


@dataclass(frozen=True, slots=True)
class WindReport(Action):
    """The wind estimate for the record: where the air moves to, with its covariance."""

    t_s: float
    n_mps: float
    e_mps: float
    nn_m2ps2: float
    ne_m2ps2: float
    ee_m2ps2: float


@dataclass(frozen=True, slots=True)
class EnergyReport(Action):
    """The energy left, and that used since the start, for the record."""

    t_s: float
    left_wh: float
    std_wh: float
    source: str
    used_wh: float


@dataclass(frozen=True, slots=True)
class SaveCheckpoint(Action):
    """Put everything that a restart needs on disk; `routine` ones come every few seconds."""

    content: dict[str, object]
    routine: bool = False


@dataclass(frozen=True, slots=True)
class PhaseChanged(Action):
    """For the log, the heartbeat's state and the progress display."""

    t_s: float
    before: str
    now: str
    why: str


@dataclass(frozen=True, slots=True)
class Finished(Action):
    """The mission is over: nothing more will be asked of the autopilot.

    `home` and `margin_wh` (energy above the reserve) are as the companion saw them at the end;
    `None` = it cannot tell. `drop_unproven`: the gripper was told to open, and nothing showed that
    it did: somebody has to look where the parcel is. `figures` is what the flight, begun at
    `took_off_s`, tells the monitor of the service; None: it never flew. `evidence_nats` is
    the log of the e-value against the energy model, once the flight is counted.
    """

    outcome: str
    delivered: bool
    reason: str
    home: bool | None = None
    margin_wh: float | None = None
    drop_unproven: bool = False
    took_off_s: float | None = None
    figures: FlightFigures | None = None
    evidence_nats: float | None = None
