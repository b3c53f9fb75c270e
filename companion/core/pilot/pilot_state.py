"""What the pilot remembers of one mission: how to fly it, the ground work, the flight so far."""

from dataclasses import dataclass, field

from companion.core.mission.events import Position
from companion.core.mission.preflight_checks import Finding, Requirement
from companion.core.pilot.jump_confirmation import CourseWatch, JumpWatch
from companion.core.pilot.release_detection import ReleaseWatch
from companion.core.vehicle.energy_ledger import EnergyBelief


@dataclass(frozen=True, slots=True)
class PilotOptions:
    """How this run is to be flown. `authorise` counts once and never after a restart.

    `keep_apart`: fly set-points near neighbours; without `separation_filter` they are what is
    wished, for comparison only. `name`: as which the fleet knows this vehicle.

    `here`: the site lies about where the vehicle stands, not about the flight file's depot.
    """

    gate_on: bool = True
    configure: bool = False
    authorise: bool = False
    check_only: bool = False
    here: bool = False
    keep_apart: bool = False
    name: str = ""
    separation_filter: bool = True


@dataclass(frozen=True, slots=True)
class Move:
    """An item that the mission was moved to and not by us, told so many times in a row."""

    index: int
    told: int


@dataclass(slots=True)
class FlightState:
    """What the flight has come to so far."""

    authorised: bool = False
    flying: bool = False
    delivered: bool = False
    drop_begun: bool = False
    """The gripper was told to open: without proof nobody knows where the parcel is."""
    gate_closed: str = ""
    took_off_s: float | None = None
    leg: int = 0
    index: int | None = None
    rally: str | None = None
    home: str | None = None
    """Where what is aboard ends were we to die now; only on flights to a promised stop."""
    wanted: str | None = None
    """The stop that the truck wants to be the end; `None`: the one that it is."""
    moved_to: Move | None = None
    jump: JumpWatch | None = None
    course: CourseWatch | None = None
    release: ReleaseWatch | None = None
    release_asked_again: bool = False
    turned_again: int = 0
    looked_again_s: float = -1e9
    looked_home_s: float = -1e9
    speed_mps: float | None = None
    speed_s: float = -1e9
    speed_index: int | None = None
    settled_s: float | None = None
    landed_s: float | None = None
    energy_landed: EnergyBelief | None = None
    disarm_asked_s: float = -1e9
    disarms_asked: int = 0
    disarmed_s: float | None = None
    still_s: float | None = None
    doubtful_s: float | None = None
    position_lost_s: float | None = None
    last_sure: Position | None = None
    noted: set[str] = field(default_factory=set)


@dataclass(slots=True)
class GroundWork:
    """What is being waited for before take-off."""

    asked_s: float = -1e9
    attempts: int = 0
    values: dict[str, float | None] = field(default_factory=dict)
    settings_before: dict[str, float] = field(default_factory=dict)
    configured: bool = False
    findings: tuple[Finding, ...] = ()
    findings_known: bool = False
    requirements: tuple[Requirement, ...] = ()
    arm_asked_s: float = -1e9
    mission_matches: bool = False
    plan_refused: str = ""
    giving_up: str = ""
    giving_up_s: float = 0.0
    said: str = ""
