"""Messages between vehicles, trucks and the dispatcher: typed, versioned, bounded JSON.

A message of another version, over the size limit, with an unknown field or a number out of range is
rejected with a reason (`Refused`). `epoch_us` is the sender's wall clock, for people; no decision
uses it, since clocks may be wrong. Decisions use `uptime_s`, seconds since the companion instance
started, which only that companion compares.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from companion.core.base.desk_heartbeat import DeskHeartbeat
from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.core.base.wire_message import VERSION, Name, RosterStamp, WireMessage
from companion.core.separation.track import Track
from companion.core.wind_field.shared_winds import SharedWinds

MAX_MESSAGE_BYTES = {
    "state": 4096,
    "event": 8192,
    "command": 1 << 20,
    "result": 4096,
    "track": 1024,
    "station": 512,
    "winds": 2048,
    "desk": 512,
}
"""A command may contain a site's obstacles and ground; other messages are a few hundred bytes."""

Message = TypeVar("Message", bound=WireMessage)
Id = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]*\Z")]
AIRFRAME = r"^[A-Za-z0-9][A-Za-z0-9 ._+-]{0,63}\Z"
AnyId = Annotated[str, Meta(max_length=64, pattern=r"^([A-Za-z0-9][A-Za-z0-9._:-]*)?\Z")]
AirframeName = Annotated[str, Meta(pattern=AIRFRAME)]
PhaseName = Annotated[str, Meta(max_length=40, pattern=r"^[a-z][a-z0-9_ ]*\Z")]
OperatorText = Annotated[str, Meta(max_length=500)]
"""Texts for people. `TEXT_FIELDS` lists the fields; they are sanitised at decoding."""
IssuerName = Annotated[str, Meta(min_length=1, max_length=64)]
Probability = Annotated[float, Meta(ge=0.0, le=1.0)]


Count = Annotated[int, Meta(ge=0, le=2**53)]
EpochUs = Annotated[int, Meta(ge=-(2**53), le=2**53)]
"""The largest integers that every JSON reader and database accepts."""

MAX_ROUTE_CHARS = 400
"""Maximum characters of a route in a state: some sixty waypoints."""

MAX_COV_M2PS2 = 400.0
WindCov = tuple[
    Annotated[float, Meta(gt=0.0, le=MAX_COV_M2PS2)],
    Annotated[float, Meta(ge=-MAX_COV_M2PS2, le=MAX_COV_M2PS2)],
    Annotated[float, Meta(gt=0.0, le=MAX_COV_M2PS2)],
]
"""A wind covariance, (m/s)^2: north, north with east, east."""

EncodedRoute = Annotated[str, Meta(max_length=MAX_ROUTE_CHARS, pattern=r"^[?-~]*\Z")]
"""A route over the ground, as `polyline.encoded` writes it."""


class State(WireMessage, frozen=True, kw_only=True):
    """A vehicle's state as reported by its companion. Unknown values are absent."""

    vehicle: Name
    """The sender."""
    instance_id: Id = msgspec.field(name="life")
    """Identifier of this companion instance: new after each start."""
    uptime_s: Annotated[float, Meta(ge=0.0)]
    """Seconds since this instance started."""
    epoch_us: EpochUs
    """The sender's wall clock, for people."""
    airframe: AirframeName
    """The airframe's name; "truck" is a truck."""
    max_payload_kg: Annotated[float, Meta(ge=0.0)]
    """Maximum payload."""
    phase: PhaseName
    """`standby` between missions, else the mission's phase; of a truck `driving` or `at_stop`."""
    log: Id
    """Identifier of the event log."""
    last_seq: Count
    """Newest event in that log: a receiver that has fewer requests the rest."""
    assignment: Id | None = None
    """The current assignment."""
    order: Id | None = None
    """The order of that assignment."""
    armed: bool | None = None
    """True if the motors may spin."""
    delivered: bool = False
    """The parcel's release is confirmed."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    """Latitude."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    """Longitude."""
    height_rel_m: float | None = None
    """Height above the launch position."""
    ground_speed_mps: Annotated[float, Meta(ge=0.0)] | None = None
    """Speed over the ground."""
    voltage_v: float | None = None
    """Voltage of the pack."""
    energy_left_wh: float | None = None
    """Usable energy remaining."""
    margin_wh: float | None = None
    """Energy above the need of the required P(home) from the next decision point."""
    p_home: Probability | None = None
    """Probability of returning if it flies on as planned."""
    p_home_now: Probability | None = None
    """Probability of returning if it turns back now."""
    p_success: Probability | None = None
    """Probability of delivering and returning."""
    p_home_limit: Probability | msgspec.UnsetType = msgspec.UNSET
    """Limit of evidence: the largest P(home) that is stated to people. Older readers reject a state
    that has it.
    """
    wind_to_n_mps: float | None = None
    """Wind, north component of the direction TO."""
    wind_to_e_mps: float | None = None
    """Wind, east component of the direction TO."""
    wind_cov_m2ps2: WindCov | msgspec.UnsetType = msgspec.UNSET
    """Covariance of that wind: nn, ne, ee. Omitted, not null, if unknown: older readers reject a
    state that has it.
    """
    home: Id | None = None
    """The guaranteed stop at which the uploaded mission ends if the companion fails now (safety
    rule 3).
    """
    stop: Id | None = None
    """Of a truck: the stop where it is or to which it drives."""
    text: OperatorText = ""
    """The last message to people."""
    monitor_text: OperatorText = msgspec.field(default="", name="doubt")
    """Active alarms of the service monitor, and how to clear them; empty: none."""
    outbound_route: EncodedRoute = msgspec.field(default="", name="way_out")
    """The uploaded mission from the launch pad to the customer, an encoded polyline; empty: none,
    or not reported.
    """
    return_route: EncodedRoute = msgspec.field(default="", name="way_home")
    """The uploaded mission from the customer to its landing site, likewise."""
    roster: RosterStamp | msgspec.UnsetType = msgspec.UNSET
    """The sender's roster; omitted: none."""


class EventKind(Enum):
    """Kind of an event. A truck driver sends the last three."""

    PHASE = "phase"
    DECISION = "decision"
    TEXT = "said"
    COMMAND = "command"
    OUTCOME = "outcome"
    DRONE_ON_PAD = "placed"
    RECOVERED = "recovered"
    TASK_FAILED = "cannot"


class FleetEvent(WireMessage, frozen=True, kw_only=True):
    """An event on a member."""

    vehicle: Name
    """The sender."""
    log: Id
    """The event log, which outlives restarts."""
    seq: Annotated[int, Meta(ge=1, le=2**53)]
    """Increases in `log`."""
    epoch_us: EpochUs
    """The sender's wall clock, for people."""
    kind: EventKind
    """Kind of the event."""
    text: OperatorText
    """Description for people."""
    assignment: Id | None = None
    """The assignment that it belongs to."""
    order: Id | None = None
    """The order that it belongs to."""
    p_home: Probability | None = None
    """Probability of returning."""
    margin_wh: float | None = None
    """The same as in the state; of an outcome: energy left above the reserve."""
    outcome: Annotated[str, Meta(pattern=r"^(SUC|DEL|FAIL|ABRT|TAKEN)\Z")] | None = None
    """Closes an assignment: one of SUC, DEL, FAIL, ABRT and TAKEN."""
    delivered: bool | None = None
    """With `outcome`: dropped. With kind `recovered`: false if the driver found it on the drone."""
    home: bool | None = None
    """With `outcome`: the vehicle landed at home or at a rally point."""
    evidence_nats: float | None = None
    """With `outcome`: log of the e-value against the vehicle's energy model after this flight."""
    drop_unproven: bool | None = None
    """It is unknown whether the drone still carries the parcel."""
    fitted_pack: Id | msgspec.UnsetType = msgspec.UNSET
    """With kind `recovered`: the pack that the driver has fitted, as `companion run --pack`."""


class _CommandAction(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="do"
):
    """The action of a command."""


class Assign(_CommandAction, frozen=True, kw_only=True, tag="assign"):
    """Accept this mission, plan it, upload it and wait for `launch`."""

    assignment: Id
    """Identifier of the assignment."""
    order: Id
    """The order."""
    flight: dict[str, Any]
    """A whole flight/1 table without `site.obstacles` and `site.terrain.grid`: the ground is
    included in `site.terrain.heights`.
    """
    obstacles: dict[str, Any] | None = None
    """The GeoJSON obstacles of its site."""


class LaunchWindow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When a launch may start, on the vehicle's clock; fixed when the launch is first sent."""

    instance_id: Id = msgspec.field(name="life")
    """The companion instance whose `uptime_s` is that clock."""
    not_before_s: Annotated[float, Meta(ge=0.0, le=1e9)]
    """Earliest uptime: the launch gap ends."""
    expires_s: Annotated[float, Meta(ge=0.0, le=1e9)]
    """Latest uptime, at most 15 s later."""


class Launch(_CommandAction, frozen=True, kw_only=True, tag="launch"):
    """The explicit authorisation of this assignment's one flight (safety rule 1)."""

    assignment: Id
    """The assignment."""
    window: LaunchWindow | msgspec.UnsetType = msgspec.UNSET
    """Its validity; a launch without one is refused."""


class Withdraw(_CommandAction, frozen=True, kw_only=True, tag="withdraw"):
    """Cancel an assignment before take-off."""

    assignment: Id
    """The assignment."""


class Recall(_CommandAction, frozen=True, kw_only=True, tag="recall"):
    """Return now, by the return route that the gate finds safe; on the ground: stay."""


class MoveHome(_CommandAction, frozen=True, kw_only=True, tag="move_home"):
    """Land at another stop of the flight's `site.stops`, which the truck guarantees from now on.

    `done` acknowledges the request; the earlier guarantee ends only when `State.home` names the new
    stop (safety rule 3). Refused if the gate does not find the route to it safe.
    """

    assignment: Id
    """The assignment."""
    home: Id
    """One of the flight's `site.stops`."""


class Drive(_CommandAction, frozen=True, kw_only=True, tag="drive"):
    """To a truck: leave its current position and drive to this stop."""

    stop: Id
    """The stop's name."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """Its latitude."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Its longitude."""


class Serve(_CommandAction, frozen=True, kw_only=True, tag="serve"):
    """To a truck at a stop: the driver delivers this order; an outcome event confirms it."""

    assignment: Id
    """The assignment."""
    order: Id
    """The order to deliver."""


class PutOut(_CommandAction, frozen=True, kw_only=True, tag="put_out"):
    """To a truck at a stop: put this drone with this parcel on its pad, switch it on, step back.

    An event of kind `placed` confirms that the area around its rotors is clear.
    """

    assignment: Id
    """The assignment."""
    order: Id
    """The parcel's order."""
    vehicle: Name
    """The drone."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """Latitude of its pad."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Longitude of its pad."""


class Recover(_CommandAction, frozen=True, kw_only=True, tag="recover"):
    """To a truck at a stop: recover this drone, swap its pack; a `recovered` event confirms it."""

    assignment: Id
    """The assignment."""
    vehicle: Name
    """The drone."""
    parcel: Id | None = None
    """Check for this order's parcel on the drone, and report the result."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """Latitude of its position."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Longitude of its position."""


class ReleaseControl(_CommandAction, frozen=True, kw_only=True, tag="hands_off"):
    """Send the autopilot no more commands; another operator controls the vehicle."""


class ReturnControl(_CommandAction, frozen=True, kw_only=True, tag="hand_back"):
    """Return control to the companion."""


class SetLimits(_CommandAction, frozen=True, kw_only=True, tag="set_limits"):
    """The operator's limits from now on."""

    max_loss: Annotated[float, Meta(ge=1e-6, le=0.5)] | None = None
    """Accepted probability of losing the vehicle."""
    reserve_frac: Annotated[float, Meta(ge=0.0, le=0.6)] | None = None
    """Required energy after landing, as a fraction of the usable energy."""


TruckAction = Drive | Serve | PutOut | Recover
CommandAction = (
    Assign
    | Launch
    | Withdraw
    | Recall
    | MoveHome
    | ReleaseControl
    | ReturnControl
    | SetLimits
    | TruckAction
)


class Command(WireMessage, frozen=True, kw_only=True):
    """One command to one vehicle.

    Too old, or for an earlier instance, it is answered `stale`, a launch `expired`, a recall never.
    """

    id: Id
    """A repeated id denotes the same command."""
    vehicle: Name
    """The addressed vehicle."""
    instance_id: Id = msgspec.field(name="life")
    """`instance_id` of the newest state that the sender received."""
    as_of_s: Annotated[float, Meta(ge=0.0)]
    """`uptime_s` of that state: a command that is too old is answered `stale`."""
    by: IssuerName
    """The author, for people and for the audit."""
    action: CommandAction = msgspec.field(name="deed")
    """The requested action."""


class CommandStatus(Enum):
    """Status of a command. `later` and `stale` are not final: the same id may be sent again."""

    DONE = "done"
    REFUSED = "refused"
    LATER = "later"
    STALE = "stale"
    INTERRUPTED = "interrupted"
    EXPIRED = "expired"  # a launch after its window: not executed


FINAL_STATUSES = frozenset(CommandStatus) - {CommandStatus.LATER, CommandStatus.STALE}


class Result(WireMessage, frozen=True, kw_only=True):
    """Reply to a command. `interrupted`: started before a restart; the state shows the result."""

    id: AnyId
    """The command's id; empty if unreadable."""
    vehicle: Name
    """The vehicle that replies."""
    instance_id: Id = msgspec.field(name="life")
    """The instance that replies."""
    status: CommandStatus = msgspec.field(name="answer")
    """Status of the command."""
    reason: OperatorText = ""
    """The reason, for people."""


@dataclass(frozen=True, slots=True)
class Refused:
    """The reason for which bytes were rejected as a message."""

    reason: str


class _VersionHeader(msgspec.Struct, frozen=True):
    v: int


_version_decoder = msgspec.json.Decoder(_VersionHeader)
KIND_OF_TYPE: dict[type[WireMessage], str] = {
    State: "state",
    FleetEvent: "event",
    Command: "command",
    Result: "result",
    Track: "track",
    SharedWinds: "winds",
    DeskHeartbeat: "desk",
}
TEXT_FIELDS: dict[type[WireMessage], tuple[str, ...]] = {
    State: ("text", "monitor_text"),
    FleetEvent: ("text",),
    Command: ("by",),
    Result: ("reason",),
}
"""Fields with texts for people. All other texts in a message are names with a pattern."""

_decoders: dict[type[WireMessage], Any] = {
    type_: msgspec.json.Decoder(type_) for type_ in KIND_OF_TYPE
}


def encode_message(message: WireMessage) -> bytes:
    """Encode a message; LeewayError if it exceeds its kind's size limit."""
    kind = KIND_OF_TYPE[type(message)]
    raw = msgspec.json.encode(message)
    if len(raw) > MAX_MESSAGE_BYTES[kind]:
        raise LeewayError(f"{kind}: {len(raw)} bytes, expected at most {MAX_MESSAGE_BYTES[kind]}")
    return raw


def decode_message(message_type: type[Message], raw: bytes | Refused) -> Message | Refused:
    """Decode a message of this type, or return the reason for its rejection, or the given one."""
    if isinstance(raw, Refused):
        return raw
    kind = KIND_OF_TYPE[message_type]
    if len(raw) > MAX_MESSAGE_BYTES[kind]:
        return Refused(f"{kind}: {len(raw)} bytes, expected at most {MAX_MESSAGE_BYTES[kind]}")
    try:
        version = _version_decoder.decode(raw).v
        if version != VERSION:
            return Refused(f"{kind}: version {version}, expected {VERSION}")
        return with_sanitized_texts(_decoders[message_type].decode(raw))
    except (msgspec.DecodeError, LeewayError, UnicodeDecodeError, RecursionError) as error:
        return Refused(safe_text(f"{kind}: {error}"[:300]))  # the error quotes received text


def with_sanitized_texts(message: Message) -> Message:
    """Return the message with its texts sanitised for display."""
    texts = {name: getattr(message, name) for name in TEXT_FIELDS.get(type(message), ())}
    safe = {name: safe_text(text) for name, text in texts.items()}
    return message if safe == texts else msgspec.structs.replace(message, **safe)
