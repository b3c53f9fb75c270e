"""Messages between vehicles, trucks and the dispatcher: typed, versioned, bounded JSON.

A message of another version, of too many bytes, with an unknown field or a number out of range is
refused in words (`Refused`), never guessed at. `epoch_us` is the sender's own wall clock, for
people; nothing is decided on it, since clocks may be off. Decisions rest on `uptime_s`, seconds
since that life of the companion began, which only its own companion compares.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from companion.core.base.wire_message import VERSION, Name, WireMessage
from companion.core.separation.track import Track
from companion.core.separation.track_cells import cell_of
from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.network import Told

LARGEST_BYTES = {
    "state": 4096,
    "event": 8192,
    "command": 1 << 20,
    "result": 4096,
    "track": 1024,
    "station": 512,
    "winds": 2048,
}
"""A command may carry a site's obstacles and its ground; the others are a few hundred bytes."""

Id = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]*\Z")]
AIRFRAME = r"^[A-Za-z0-9][A-Za-z0-9 ._+-]{0,63}\Z"
AnyId = Annotated[str, Meta(max_length=64, pattern=r"^([A-Za-z0-9][A-Za-z0-9._:-]*)?\Z")]
AirframeName = Annotated[str, Meta(pattern=AIRFRAME)]
PhaseName = Annotated[str, Meta(max_length=40, pattern=r"^[a-z][a-z0-9_ ]*\Z")]
Words = Annotated[str, Meta(max_length=500)]
"""For people. `WORDS` lists the fields: what is decoded of them is safe to show."""
Author = Annotated[str, Meta(min_length=1, max_length=64)]
Probability = Annotated[float, Meta(ge=0.0, le=1.0)]


Count = Annotated[int, Meta(ge=0, le=2**53)]
EpochUs = Annotated[int, Meta(ge=-(2**53), le=2**53)]
"""As large as every reader of JSON, and every database, takes a whole number."""

LONGEST_WAY = 400
"""Characters of a way in a state: some sixty waypoints."""

MOST_COV_M2PS2 = 400.0
WindCov = tuple[
    Annotated[float, Meta(gt=0.0, le=MOST_COV_M2PS2)],
    Annotated[float, Meta(ge=-MOST_COV_M2PS2, le=MOST_COV_M2PS2)],
    Annotated[float, Meta(gt=0.0, le=MOST_COV_M2PS2)],
]
"""A covariance of the wind, (m/s)^2: north, north with east, east."""

Way = Annotated[str, Meta(max_length=LONGEST_WAY, pattern=r"^[?-~]*\Z")]
"""A way over the ground, as `polyline.encoded` writes it."""


class State(WireMessage, frozen=True, kw_only=True):
    """A vehicle as its companion sees it now. Unknown is absent.

    A truck is a vehicle of airframe `truck`.
    """

    vehicle: Name
    """Who tells it."""
    life: Id
    """Name of this life of the companion: a new one after each start."""
    uptime_s: Annotated[float, Meta(ge=0.0)]
    """Seconds since this life began."""
    epoch_us: EpochUs
    """The sender's wall clock, for people."""
    airframe: AirframeName
    """The airframe's name; "truck" is a truck."""
    max_payload_kg: Annotated[float, Meta(ge=0.0)]
    """Heaviest parcel."""
    phase: PhaseName
    """`standby` between missions, else the mission's phase; of a truck `driving` or `at_stop`."""
    log: Id
    """Name of the event log."""
    last_seq: Count
    """Newest event of that log: who has seen less asks for the rest."""
    assignment: Id | None = None
    """The assignment that it holds."""
    order: Id | None = None
    """The order of that assignment."""
    armed: bool | None = None
    """Whether the motors may turn."""
    delivered: bool = False
    """The parcel's release is confirmed."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    """Latitude."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    """Longitude."""
    height_rel_m: float | None = None
    """Height above the launch place."""
    ground_speed_mps: Annotated[float, Meta(ge=0.0)] | None = None
    """Speed over the ground."""
    voltage_v: float | None = None
    """Voltage of the pack."""
    energy_left_wh: float | None = None
    """Usable energy left."""
    margin_wh: float | None = None
    """Energy expected to be left above the reserve after landing."""
    p_home: Probability | None = None
    """Probability of coming home if it flies on as planned."""
    p_home_now: Probability | None = None
    """Probability of coming home if it turns back now."""
    p_success: Probability | None = None
    """Probability of delivering and coming home."""
    wind_to_n_mps: float | None = None
    """Wind, north part of where the air moves to."""
    wind_to_e_mps: float | None = None
    """Wind, east part of where the air moves to."""
    wind_cov_m2ps2: WindCov | msgspec.UnsetType = msgspec.UNSET
    """Covariance of that wind: nn, ne, ee. Left out, not null, where it is not told: readers of
    before refuse a state that has it.
    """
    home: Id | None = None
    """The promised stop at which the mission aboard ends if the companion dies now (safety
    rule 3).
    """
    stop: Id | None = None
    """Of a truck: where it stands or drives to."""
    text: Words = ""
    """The last message to people."""
    doubt: Words = ""
    """What the monitor of its service holds in doubt, and what clears it; empty: nothing."""
    way_out: Way = ""
    """The mission aboard from the launch pad to the customer, an encoded polyline; empty: none, or
    not told.
    """
    way_home: Way = ""
    """The mission aboard from the customer to where it lands, likewise."""


class EventKind(Enum):
    """What an event tells; the last three are a truck driver's: a drone placed on its pad, taken
    aboard, or why that cannot be.
    """

    PHASE = "phase"
    DECISION = "decision"
    SAID = "said"
    COMMAND = "command"
    OUTCOME = "outcome"
    PLACED = "placed"
    RECOVERED = "recovered"
    CANNOT = "cannot"


class FleetEvent(WireMessage, frozen=True, kw_only=True):
    """Something that happened aboard."""

    vehicle: Name
    """Who tells it."""
    log: Id
    """The event log, which outlives restarts."""
    seq: Annotated[int, Meta(ge=1, le=2**53)]
    """Counts up in `log`."""
    epoch_us: EpochUs
    """The sender's wall clock, for people."""
    kind: EventKind
    """What the event tells."""
    text: Words
    """In words."""
    assignment: Id | None = None
    """The assignment that it belongs to."""
    order: Id | None = None
    """The order that it belongs to."""
    p_home: Probability | None = None
    """Probability of coming home."""
    margin_wh: float | None = None
    """Energy expected to be left above the reserve after landing."""
    outcome: Annotated[str, Meta(pattern=r"^(SUC|DEL|FAIL|ABRT|TAKEN)\Z")] | None = None
    """Closes an assignment: one of SUC, DEL, FAIL, ABRT and TAKEN."""
    delivered: bool | None = None
    """With `outcome`: the parcel was dropped. With kind `recovered`: false where the driver
    found it aboard.
    """
    home: bool | None = None
    """With `outcome`: the vehicle landed at home or at a rally point."""
    evidence_nats: float | None = None
    """With `outcome`: log of the e-value against the vehicle's energy model after this flight."""
    drop_unproven: bool | None = None
    """Nobody knows yet whether the parcel is still aboard."""


class _Deed(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="do"):
    """What a command asks for."""


class Assign(_Deed, frozen=True, kw_only=True, tag="assign"):
    """Take this mission, plan it, put it aboard and wait for `launch`."""

    assignment: Id
    """Name of the assignment."""
    order: Id
    """The order."""
    flight: dict[str, Any]
    """A whole flight/1 table, `site.obstacles` and `site.terrain.grid` absent: the ground is
    written out in `site.terrain.heights`.
    """
    obstacles: dict[str, Any] | None = None
    """The GeoJSON that stands on its site."""


class Launch(_Deed, frozen=True, kw_only=True, tag="launch"):
    """The explicit authorisation of this assignment's one flight (safety rule 1)."""

    assignment: Id
    """Which assignment."""


class Withdraw(_Deed, frozen=True, kw_only=True, tag="withdraw"):
    """Give up an assignment that has not taken off."""

    assignment: Id
    """Which assignment."""


class Recall(_Deed, frozen=True, kw_only=True, tag="recall"):
    """Come home now, by the way home that the gate finds safe; on the ground: stay."""


class MoveHome(_Deed, frozen=True, kw_only=True, tag="move_home"):
    """Land at another stop of the flight's `site.stops`: the truck promises it from now on.

    `done` says that the wish is taken; the earlier promise is void only when `State.home` names the
    new stop (safety rule 3). Refused where the gate does not find the way there safe.
    """

    assignment: Id
    """Which assignment."""
    home: Id
    """One of the flight's `site.stops`."""


class Drive(_Deed, frozen=True, kw_only=True, tag="drive"):
    """To a truck: leave where it stands and drive to this stop."""

    stop: Id
    """The stop's name."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """Its latitude."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Its longitude."""


class Serve(_Deed, frozen=True, kw_only=True, tag="serve"):
    """To a truck at a stop: the driver brings this order; an outcome event tells that it did."""

    assignment: Id
    """Which assignment."""
    order: Id
    """The order that the driver brings."""


class PutOut(_Deed, frozen=True, kw_only=True, tag="put_out"):
    """To a truck at a stop: put this drone with this parcel on its pad, switch it on, step back.

    An event of kind `placed` says that nobody is near its rotors any more.
    """

    assignment: Id
    """Which assignment."""
    order: Id
    """The parcel's order."""
    vehicle: Name
    """The drone."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """Latitude of its pad."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Longitude of its pad."""


class Recover(_Deed, frozen=True, kw_only=True, tag="recover"):
    """To a truck at a stop: take this drone aboard, swap its pack; `recovered` tells that it is."""

    assignment: Id
    """Which assignment."""
    vehicle: Name
    """The drone."""
    parcel: Id | None = None
    """Look whether this order's parcel is still on it, and tell."""
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    """Latitude of where it stands."""
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Longitude of where it stands."""


class HandsOff(_Deed, frozen=True, kw_only=True, tag="hands_off"):
    """Send the autopilot nothing more; somebody else flies."""


class HandBack(_Deed, frozen=True, kw_only=True, tag="hand_back"):
    """Control is the companion's again."""


class SetLimits(_Deed, frozen=True, kw_only=True, tag="set_limits"):
    """What the operator accepts from now on."""

    max_loss: Annotated[float, Meta(ge=1e-6, le=0.5)] | None = None
    """Probability of losing the vehicle that the operator accepts."""
    reserve_frac: Annotated[float, Meta(ge=0.0, le=0.6)] | None = None
    """Energy that must be left after landing, of the usable energy."""


TruckDeed = Drive | Serve | PutOut | Recover
Deed = Assign | Launch | Withdraw | Recall | MoveHome | HandsOff | HandBack | SetLimits | TruckDeed


class Command(WireMessage, frozen=True, kw_only=True):
    """One order to one vehicle.

    A command from too long ago, or for an earlier life, is answered `stale` (a recall never is).
    """

    id: Id
    """The same id means the same command, however often it is sent."""
    vehicle: Name
    """Who is asked."""
    life: Id
    """`life` of the newest state that the sender has heard."""
    as_of_s: Annotated[float, Meta(ge=0.0)]
    """`uptime_s` of that state: a command from too long ago is answered `stale`."""
    by: Author
    """Who asks, for people and for the audit."""
    deed: Deed
    """What is asked for."""


class Answered(Enum):
    """How a command was taken. `later` and `stale` settle nothing: the same id may come again."""

    DONE = "done"
    REFUSED = "refused"
    LATER = "later"
    STALE = "stale"
    INTERRUPTED = "interrupted"


FINAL = (Answered.DONE, Answered.REFUSED, Answered.INTERRUPTED)


class Result(WireMessage, frozen=True, kw_only=True):
    """The answer to a command. `interrupted`: begun before a restart; the state tells the rest."""

    id: AnyId
    """The command's id; empty where that could not be read."""
    vehicle: Name
    """Who answers."""
    life: Id
    """The life that answers."""
    answer: Answered
    """How the command was taken."""
    reason: Words = ""
    """Why, in words."""


@dataclass(frozen=True, slots=True)
class Refused:
    """Why bytes were not taken for a message."""

    reason: str


class _Head(msgspec.Struct, frozen=True):
    v: int


_head = msgspec.json.Decoder(_Head)
_KINDS: dict[str, type[WireMessage]] = {
    "state": State,
    "event": FleetEvent,
    "command": Command,
    "result": Result,
    "track": Track,
    "winds": SharedWinds,
}
WORDS: dict[type[WireMessage], tuple[str, ...]] = {
    State: ("text", "doubt"),
    FleetEvent: ("text",),
    Command: ("by",),
    Result: ("reason",),
}
"""Fields that hold a person's words. Every other text of a message is a name with a pattern."""

_decoders = {kind: msgspec.json.Decoder(type_) for kind, type_ in _KINDS.items()}


def encode(message: State | FleetEvent | Command | Result | Track | SharedWinds) -> bytes:
    """The bytes of a message; LeewayError where they are more than its kind may have."""
    kind = next(kind for kind, type_ in _KINDS.items() if isinstance(message, type_))
    raw = msgspec.json.encode(message)
    if len(raw) > LARGEST_BYTES[kind]:
        raise LeewayError(f"{kind}: {len(raw)} bytes, expected at most {LARGEST_BYTES[kind]}")
    return raw


def decode_state(raw: bytes) -> State | Refused:
    """A state, or why these bytes are none."""
    return _decode("state", raw)


def decode_event(raw: bytes) -> FleetEvent | Refused:
    """An event, or why these bytes are none."""
    return _decode("event", raw)


def decode_command(raw: bytes) -> Command | Refused:
    """A command, or why these bytes are none."""
    return _decode("command", raw)


def decode_track(raw: bytes) -> Track | Refused:
    """A neighbour's place, or why these bytes are none."""
    return _decode("track", raw)


def decode_winds(raw: bytes) -> SharedWinds | Refused:
    """The winds that others feel, or why these bytes are none."""
    return _decode("winds", raw)


def decode_told_track(told: Told) -> Track | Refused:
    """A neighbour's place, told by its own key and in the cell where it is."""
    track = decode_track(told.raw)
    if isinstance(track, Refused):
        return track
    if track.vehicle != told.speaker:
        return Refused(f"{told.name} tells a place of {track.vehicle}")
    if cell_of(track.lat_deg, track.lon_deg) != told.cell:
        return Refused(f"{told.name} tells its place in a cell where it is not")
    return track


def decode_result(raw: bytes) -> Result | Refused:
    """A result, or why these bytes are none."""
    return _decode("result", raw)


def _decode(kind: str, raw: bytes) -> Any:
    if len(raw) > LARGEST_BYTES[kind]:
        return Refused(f"{kind}: {len(raw)} bytes, expected at most {LARGEST_BYTES[kind]}")
    try:
        version = _head.decode(raw).v
        if version != VERSION:
            return Refused(f"{kind}: version {version}, expected {VERSION}")
        return with_safe_words(_decoders[kind].decode(raw))
    except (msgspec.DecodeError, LeewayError, UnicodeDecodeError, RecursionError) as error:
        return Refused(safe_text(f"{kind}: {error}"[:300]))  # it quotes what was sent


def with_safe_words(message: WireMessage) -> WireMessage:
    """The message, with its words as they may be shown."""
    words = {name: getattr(message, name) for name in WORDS.get(type(message), ())}
    safe = {name: safe_text(text) for name, text in words.items()}
    return message if safe == words else msgspec.structs.replace(message, **safe)
