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
from companion.core.base.wire_message import VERSION, Name, WireMessage
from companion.core.separation.track import Track

LARGEST_BYTES = {"state": 4096, "event": 8192, "command": 1 << 20, "result": 4096, "track": 1024}
"""A command may carry a site's obstacles; the others are a few hundred bytes."""

Id = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]*\Z")]
Words = Annotated[str, Meta(max_length=500)]
Probability = Annotated[float, Meta(ge=0.0, le=1.0)]


class State(WireMessage, frozen=True, kw_only=True):
    """A vehicle as its companion sees it now. Unknown is absent.

    `phase` is `standby` between missions, else the mission's phase. `last_seq` is the newest event
    of log `log`: who has seen less asks for the rest. `home` names the promised stop at which
    what is aboard the autopilot ends, were its companion to die now (safety rule 3). A truck is a
    vehicle of airframe `truck`, in phase `driving` or `at_stop`; `stop`: where it stands or drives
    to.
    """

    vehicle: Name
    life: Id
    uptime_s: Annotated[float, Meta(ge=0.0)]
    epoch_us: int
    airframe: Annotated[str, Meta(max_length=64)]
    max_payload_kg: Annotated[float, Meta(ge=0.0)]
    phase: Annotated[str, Meta(max_length=40)]
    log: Id
    last_seq: Annotated[int, Meta(ge=0)]
    assignment: Id | None = None
    order: Id | None = None
    armed: bool | None = None
    delivered: bool = False
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    height_rel_m: float | None = None
    ground_speed_mps: Annotated[float, Meta(ge=0.0)] | None = None
    voltage_v: float | None = None
    energy_left_wh: float | None = None
    margin_wh: float | None = None
    p_home: Probability | None = None
    p_home_now: Probability | None = None
    p_success: Probability | None = None
    wind_to_n_mps: float | None = None
    wind_to_e_mps: float | None = None
    home: Id | None = None
    stop: Id | None = None
    text: Words = ""


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
    """Something that happened aboard: `seq` counts up in `log`, which outlives restarts.

    `outcome` (SUC, DEL, FAIL, ABRT; with `delivered` and `home`) closes an assignment;
    `drop_unproven`: nobody knows yet whether the parcel is still aboard. `recovered` with
    `delivered` tells what the driver found: False, it was aboard.
    """

    vehicle: Name
    log: Id
    seq: Annotated[int, Meta(ge=1)]
    epoch_us: int
    kind: EventKind
    text: Words
    assignment: Id | None = None
    order: Id | None = None
    p_home: Probability | None = None
    margin_wh: float | None = None
    outcome: Annotated[str, Meta(pattern=r"^(SUC|DEL|FAIL|ABRT)\Z")] | None = None
    delivered: bool | None = None
    home: bool | None = None
    drop_unproven: bool | None = None


class _Deed(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="do"):
    """What a command asks for."""


class Assign(_Deed, frozen=True, kw_only=True, tag="assign"):
    """Take this mission, plan it, put it aboard and wait for `launch`.

    `flight` is a whole `flight/1` table (`site.obstacles` absent), `obstacles` the GeoJSON that
    stands on its site.
    """

    assignment: Id
    order: Id
    flight: dict[str, Any]
    obstacles: dict[str, Any] | None = None


class Launch(_Deed, frozen=True, kw_only=True, tag="launch"):
    """The explicit authorisation of this assignment's one flight (safety rule 1)."""

    assignment: Id


class Withdraw(_Deed, frozen=True, kw_only=True, tag="withdraw"):
    """Give up an assignment that has not taken off."""

    assignment: Id


class Recall(_Deed, frozen=True, kw_only=True, tag="recall"):
    """Come home now, by the way home that the gate finds safe; on the ground: stay."""


class MoveHome(_Deed, frozen=True, kw_only=True, tag="move_home"):
    """Land at another stop of the flight's `site.stops`: the truck promises it from now on.

    `done` says that the wish is taken; the earlier promise is void only when `State.home` names the
    new stop (safety rule 3). Refused where the gate does not find the way there safe.
    """

    assignment: Id
    home: Id


class Drive(_Deed, frozen=True, kw_only=True, tag="drive"):
    """To a truck: leave where it stands and drive to this stop."""

    stop: Id
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]


class Serve(_Deed, frozen=True, kw_only=True, tag="serve"):
    """To a truck at a stop: the driver brings this order; an outcome event tells that it did."""

    assignment: Id
    order: Id


class PutOut(_Deed, frozen=True, kw_only=True, tag="put_out"):
    """To a truck at a stop: put this drone with this parcel on its pad, switch it on, step back.

    An event of kind `placed` says that nobody is near its rotors any more.
    """

    assignment: Id
    order: Id
    vehicle: Name
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]


class Recover(_Deed, frozen=True, kw_only=True, tag="recover"):
    """To a truck at a stop: take this drone aboard, swap its pack; `recovered` tells that it is.

    `parcel`: look whether this order's parcel is still on it, and tell.
    """

    assignment: Id
    vehicle: Name
    parcel: Id | None = None
    lat_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]


class HandsOff(_Deed, frozen=True, kw_only=True, tag="hands_off"):
    """Send the autopilot nothing more; somebody else flies."""


class HandBack(_Deed, frozen=True, kw_only=True, tag="hand_back"):
    """Control is the companion's again."""


class SetLimits(_Deed, frozen=True, kw_only=True, tag="set_limits"):
    """What the operator accepts from now on."""

    max_loss: Annotated[float, Meta(ge=1e-6, le=0.5)] | None = None
    reserve_frac: Annotated[float, Meta(ge=0.0, le=0.6)] | None = None


TruckDeed = Drive | Serve | PutOut | Recover
Deed = Assign | Launch | Withdraw | Recall | MoveHome | HandsOff | HandBack | SetLimits | TruckDeed


class Command(WireMessage, frozen=True, kw_only=True):
    """One order to one vehicle. The same `id` means the same command, however often it is sent.

    `life` and `as_of_s` are `life` and `uptime_s` of the newest state that the sender had heard: a
    command from too long ago, or for an earlier life, is answered `stale` (a recall never is).
    """

    id: Id
    vehicle: Name
    life: Id
    as_of_s: Annotated[float, Meta(ge=0.0)]
    by: Annotated[str, Meta(min_length=1, max_length=64)]
    deed: Deed


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

    id: Annotated[str, Meta(max_length=64)]
    vehicle: Name
    life: Id
    answer: Answered
    reason: Words = ""


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
}
_decoders = {kind: msgspec.json.Decoder(type_) for kind, type_ in _KINDS.items()}


def encode(message: State | FleetEvent | Command | Result | Track) -> bytes:
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
        return _decoders[kind].decode(raw)
    except (msgspec.DecodeError, LeewayError, UnicodeDecodeError, RecursionError) as error:
        return Refused(f"{kind}: {error}"[:300])
