"""Actions: outputs of the pilot. Adapters translate them into autopilot messages."""

import re
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Any

from companion.core.base.probability import home_probability_text
from companion.core.mission.alerts import Alert, AlertParameter, Severity
from companion.core.mission.events import Mode
from companion.core.mission.mission_items import MissionItem
from companion.core.monitor.flight_evidence import FlightEvidence
from companion.core.return_budget.budget import Assessment
from companion.core.return_budget.outcomes import SiteMargin


@dataclass(frozen=True, slots=True)
class Action:
    """An output of the pilot."""


# --- orders to the autopilot: only in COMMANDING_PHASES (safety rule 1) ---------------------------


@dataclass(frozen=True, slots=True)
class Order(Action):
    """An action addressed to the autopilot."""


@dataclass(frozen=True, slots=True)
class RequestTelemetry(Order):
    """Request every telemetry stream that the mission needs."""


@dataclass(frozen=True, slots=True)
class RequestBoardId(Order):
    """Request the identifier of the flight controller board."""


@dataclass(frozen=True, slots=True)
class RequestParameters(Order):
    """Read the autopilot parameters on which the pre-flight checks depend."""

    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SetParameters(Order):
    """Set autopilot parameters and verify them (`--configure`, and the restore afterwards)."""

    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class UploadMission(Order):
    """Upload this mission to the autopilot."""

    items: tuple[MissionItem, ...]


@dataclass(frozen=True, slots=True)
class ClearMission(Order):
    """Clear the mission on the autopilot. A `MissionUploaded` event reports the result."""


@dataclass(frozen=True, slots=True)
class VerifyMission(Order):
    """Download the onboard mission and compare it with `items`.

    `item_interval_s`: interval of item requests; 0: as fast as possible.
    `stop_at_first_difference`: stop at the first item that differs. `pending_requests`: number of
    pending requests, for autopilots that answer several.
    """

    items: tuple[MissionItem, ...]
    item_interval_s: float = 0.0
    stop_at_first_difference: bool = False
    pending_requests: int = 1


@dataclass(frozen=True, slots=True)
class SetMode(Order):
    """Change the flight mode."""

    mode: Mode


@dataclass(frozen=True, slots=True)
class Arm(Order):
    """Arm with the autopilot's own checks enabled."""


@dataclass(frozen=True, slots=True)
class Disarm(Order):
    """Plain disarm, never forced."""


@dataclass(frozen=True, slots=True)
class JumpTo(Order):
    """Continue the mission at this item.

    `confirming_items`: further items that confirm the jump: the autopilot reaches them on its own
    and may be there before it reports this one. `is_restart`: the mission is complete or stopped;
    ArduCopter then flies to the item only if the jump resets the mission.
    """

    index: int
    confirming_items: frozenset[int] = field(default=frozenset(), compare=False)
    is_restart: bool = field(default=False, compare=False)


@dataclass(frozen=True, slots=True)
class ContinueMission(Order):
    """Continue a paused mission (ArduCopter; PX4 has no pause)."""


@dataclass(frozen=True, slots=True)
class SetGroundSpeed(Order):
    """Fly route segments at this ground speed."""

    ground_speed_mps: float


@dataclass(frozen=True, slots=True)
class SetHome(Order):
    """Set the autopilot's home back to this position."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class ReleaseParcel(Order):
    """Release the parcel."""


@dataclass(frozen=True, slots=True)
class FlyVelocity(Order):
    """A set-point: ground velocity (NED) and its rate of change."""

    vel_ned_mps: tuple[float, float, float]
    accel_ned_mps2: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CancelOrders(Action):
    """Discard every order that is being sent, retried or awaits its response."""


# --- other outputs --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class AlertReport(Action):
    """An alert with its parameters, for the operator (STATUSTEXT, up to 249 bytes) and the log."""

    alert: Alert
    parameters: dict[str, AlertParameter] = field(default_factory=dict)

    @classmethod
    def create(cls, alert: Alert, **parameters: AlertParameter) -> "AlertReport":
        """Report an alert with its parameters."""
        return cls(alert, parameters)

    @property
    def severity(self) -> Severity:
        """Severity of the alert."""
        return self.alert.severity

    @property
    def text(self) -> str:
        """Text for operators; raises KeyError for a missing parameter."""
        return self.alert.text_template.format(**self.parameters)


def mask_numbers(text: str) -> str:
    """Return the text without its numbers: texts of one kind are then equal."""
    return re.sub(r"[0-9.]+", "#", text)


@dataclass(frozen=True, slots=True)
class LogNote(Action):
    """One line for the log. `in_run`, `in_check`: that command prints it too."""

    text: str
    in_run: bool = False
    in_check: bool = False


@dataclass(frozen=True, slots=True)
class PublishTrack(Action):
    """Position, velocity and goal of this vehicle; the fleet port adds its name."""

    gnss_s: float
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    vel_ned_mps: tuple[float, float, float]
    on_setpoints: bool
    goal_lat_deg: float | None = None
    goal_lon_deg: float | None = None


@dataclass(frozen=True, slots=True)
class PublishValues(Action):
    """Named values for any ground station (NAMED_VALUE_FLOAT). Unknown values are omitted."""

    values: dict[str, float]


_DECISION_TEXTS = ("t_s", "kind", "reason")


@dataclass(frozen=True, slots=True)
class Decision(Action):
    """A decision with the probabilities on which it is based (docs/reference/outcomes.md)."""

    t_s: float
    kind: str
    reason: str
    p_home: float | None = None
    p_home_stated: float | None = None
    p_home_now: float | None = None
    p_success: float | None = None
    margin_wh: float | None = None
    required_p_home: float | None = None
    p_home_next: float | None = None
    p_home_onward: float | None = None
    p_success_onward: float | None = None
    sites: tuple[SiteMargin, ...] = ()

    @classmethod
    def create(
        cls,
        t_s: float,
        kind: str,
        reason: str,
        assessment: Assessment | None,
        sites: tuple[SiteMargin, ...] | None = None,
    ) -> "Decision":
        """Create a decision from an assessment; `sites`: more recent ones that it rests on."""
        if assessment is None:
            return cls(t_s, kind, reason)
        names = [each.name for each in fields(cls) if each.name not in _DECISION_TEXTS]
        numbers: dict[str, Any] = {name: getattr(assessment, name) for name in names}
        if sites is not None:
            numbers["sites"] = sites
        return cls(t_s, kind, reason, **numbers)

    @property
    def p_home_text(self) -> str | None:
        """P(home) as stated to people."""
        if self.p_home is None or self.p_home_stated is None:
            return None
        return home_probability_text(self.p_home, self.p_home_stated)


@dataclass(frozen=True, slots=True)
class AssessmentReport(Action):
    """Result of the gate at one instant, for the record and the display."""

    t_s: float
    p_home: float
    p_home_stated: float
    p_home_now: float
    p_success: float
    margin_wh: float
    energy_left_wh: float
    energy_need_wh: float
    p_home_unattended: float | None
    required_p_home: float
    p_home_next: float
    p_home_onward: float
    p_success_onward: float
    sites: tuple[SiteMargin, ...]
    by_table: bool = False
    """Always False: readers of result.json expect the key."""


class ResponseStatus(Enum):
    """Result of an operator's command."""

    ACCEPTED = "accepted"
    LATER = "not now"
    DENIED = "denied"


@dataclass(frozen=True, slots=True)
class OperatorResponse(Action):
    """Response to the operator's last command, with an optional reason."""

    status: ResponseStatus
    reason: str = ""


@dataclass(frozen=True, slots=True)
class WindReport(Action):
    """Wind estimate for the record: direction of flow (to) and its covariance."""

    t_s: float
    n_mps: float
    e_mps: float
    nn_m2ps2: float
    ne_m2ps2: float
    ee_m2ps2: float


@dataclass(frozen=True, slots=True)
class EnergyReport(Action):
    """Energy left, and energy used since the start, for the record."""

    t_s: float
    left_wh: float
    std_wh: float
    source: str
    used_wh: float


@dataclass(frozen=True, slots=True)
class SaveCheckpoint(Action):
    """Write the state for a restart to disk. `routine` checkpoints come every few seconds."""

    content: dict[str, object]
    routine: bool = False


@dataclass(frozen=True, slots=True)
class PhaseChanged(Action):
    """A phase transition, for the log, the heartbeat state and the progress display."""

    t_s: float
    before: str
    now: str
    why: str


@dataclass(frozen=True, slots=True)
class Finished(Action):
    """The mission has ended: no further order is sent to the autopilot.

    `home` and `margin_wh` (energy above the reserve) are the companion's values at the end; None:
    unknown. `release_unconfirmed`: the gripper was commanded to open without confirmation, so the
    parcel has to be looked for. `flight_statistics`: contribution of the flight, which started at
    `takeoff_s`, to the service monitor; None: it never flew. `evidence_nats`: logarithm of the
    e-value against the energy model, once the flight is counted.
    """

    outcome: str
    delivered: bool
    reason: str
    home: bool | None = None
    margin_wh: float | None = None
    release_unconfirmed: bool = False
    takeoff_s: float | None = None
    flight_statistics: FlightEvidence | None = None
    evidence_nats: float | None = None
