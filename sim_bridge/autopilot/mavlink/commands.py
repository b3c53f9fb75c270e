"""Commands: COMMAND_LONG and COMMAND_INT, and those that both autopilots answer alike."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd, Result
from sim_bridge.autopilot.mavlink.message_table import SPECS_BY_ID

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

FORCE_DISARM = 21196.0
"""param2 of COMPONENT_ARM_DISARM that disarms in flight (both autopilots; PX4 also arms by it)."""


@dataclass(frozen=True, slots=True)
class Command:
    """One command; `lat_deg`, `lon_deg` are params 5 and 6 as a place, `frame` None for LONG."""

    number: int
    link_id: int
    system: int
    component: int
    frame: int | None
    param1: float
    param2: float
    param3: float
    param4: float
    param5: float
    param6: float
    param7: float

    @property
    def lat_deg(self) -> float:
        """Param 5 as degrees; NaN when not given."""
        return self.param5

    @property
    def lon_deg(self) -> float:
        """Param 6 as degrees; NaN when not given."""
        return self.param6


Handler = Callable[["Autopilot", Command], Result | None]
"""None: no acknowledgement is sent (now)."""


def from_long(link_id: int, message: Message) -> Command:
    """A COMMAND_LONG."""
    return Command(
        message.command,
        link_id,
        message.src_system,
        message.src_component,
        None,
        message.param1,
        message.param2,
        message.param3,
        message.param4,
        message.param5,
        message.param6,
        message.param7,
    )


def from_int(link_id: int, message: Message) -> Command:
    """A COMMAND_INT; INT32_MAX in x or y means not given."""
    return Command(
        message.command,
        link_id,
        message.src_system,
        message.src_component,
        message.frame,
        message.param1,
        message.param2,
        message.param3,
        message.param4,
        math.nan if message.x == 2**31 - 1 else message.x * 1e-7,
        math.nan if message.y == 2**31 - 1 else message.y * 1e-7,
        message.z,
    )


def as_int(value: float, otherwise: int = -1) -> int:
    """A float parameter as an integer, however wild it is."""
    return int(value) if math.isfinite(value) and abs(value) < 2**31 else otherwise


def set_message_interval(ap: "Autopilot", command: Command) -> Result:
    """SET_MESSAGE_INTERVAL: what an autopilot does not stream it refuses, each in its own word."""
    spec = SPECS_BY_ID.get(as_int(command.param1))
    link = ap.radio.links.get(command.link_id)
    if spec is None or link is None or spec.name not in ap.behaviour.streams:
        return ap.behaviour.refused_interval
    if not math.isfinite(command.param2):
        return Result.DENIED
    if command.param2 < 0.0:
        link.set_interval(spec.name, None, ap.t_s)
    elif command.param2 == 0.0:
        default = ap.behaviour.default_streams(link.kind).get(spec.name)
        link.set_interval(spec.name, default, ap.t_s)
    else:
        link.set_interval(spec.name, max(command.param2 * 1e-6, ap.STEP_S), ap.t_s)
    return Result.ACCEPTED


def get_message_interval(ap: "Autopilot", command: Command) -> Result:
    """GET_MESSAGE_INTERVAL: answered by a MESSAGE_INTERVAL."""
    spec = SPECS_BY_ID.get(as_int(command.param1))
    link = ap.radio.links.get(command.link_id)
    if link is None:
        return Result.FAILED
    known = spec is not None and spec.name in ap.behaviour.streams
    interval = link.interval_of(spec.name) if known and spec is not None else None
    ap.radio.send(
        command.link_id,
        "MESSAGE_INTERVAL",
        message_id=max(as_int(command.param1), 0) & 0xFFFF,
        interval_us=0 if not known else -1 if interval is None else round(interval * 1e6),
    )
    return Result.ACCEPTED if known else Result.FAILED


def request_message(ap: "Autopilot", command: Command) -> Result:
    """REQUEST_MESSAGE: one message, now."""
    spec = SPECS_BY_ID.get(as_int(command.param1))
    if spec is None:
        return ap.behaviour.refused_request
    if spec.name == "AUTOPILOT_VERSION":
        return autopilot_version(ap, command)
    if spec.name == "PROTOCOL_VERSION":
        return protocol_version(ap, command)
    builder = ap.behaviour.streams.get(spec.name)
    if builder is None:
        return ap.behaviour.refused_request
    fields = builder(ap)
    if fields is None:
        return ap.behaviour.refused_request
    ap.radio.send(command.link_id, spec.name, **fields)
    return Result.ACCEPTED


def autopilot_version(ap: "Autopilot", command: Command) -> Result:
    """AUTOPILOT_VERSION: what it can do, and which firmware it is."""
    behaviour = ap.behaviour
    ap.radio.send(
        command.link_id,
        "AUTOPILOT_VERSION",
        capabilities=behaviour.capabilities,
        flight_sw_version=behaviour.firmware_version,
        middleware_sw_version=0,
        os_sw_version=0,
        board_version=0,
        flight_custom_version=behaviour.firmware_hash,
        middleware_custom_version=bytes(8),
        os_custom_version=bytes(8),
        vendor_id=0,
        product_id=0,
        uid=ap.system_id,
        uid2=bytes([ap.system_id]) + bytes(17),
    )
    return Result.ACCEPTED


def protocol_version(ap: "Autopilot", command: Command) -> Result:
    """PROTOCOL_VERSION: MAVLink 2."""
    ap.radio.send(
        command.link_id,
        "PROTOCOL_VERSION",
        version=200,
        min_version=100,
        max_version=200,
        spec_version_hash=bytes(8),
        library_version_hash=bytes(8),
    )
    return Result.ACCEPTED


def get_home_position(ap: "Autopilot", command: Command) -> Result:
    """GET_HOME_POSITION."""
    fields = ap.behaviour.streams["HOME_POSITION"](ap)
    if fields is None:
        return Result.FAILED
    ap.radio.send(command.link_id, "HOME_POSITION", **fields)
    return Result.ACCEPTED


def set_home(ap: "Autopilot", command: Command) -> Result:
    """DO_SET_HOME: here (param1 = 1), or a place with an AMSL altitude."""
    if not ap.has_position:
        return Result.FAILED
    if command.param1 == 1.0:
        ap.set_home(ap.pos_ned_m)
        return Result.ACCEPTED
    place = (command.lat_deg, command.lon_deg, command.param7)
    if not all(math.isfinite(number) for number in place) or abs(place[0]) > 90.0:
        return Result.DENIED
    if command.lat_deg == 0.0 and command.lon_deg == 0.0:
        return Result.DENIED
    north, east = ap.frame.to_ne_m(command.lat_deg, command.lon_deg)
    ap.set_home((north, east, ap.frame.alt_amsl_m - command.param7), locked=True)
    return Result.ACCEPTED


COMMON_COMMANDS: dict[int, Handler] = {
    Cmd.SET_MESSAGE_INTERVAL: set_message_interval,
    Cmd.GET_MESSAGE_INTERVAL: get_message_interval,
    Cmd.REQUEST_MESSAGE: request_message,
    Cmd.REQUEST_AUTOPILOT_CAPABILITIES: autopilot_version,
    Cmd.REQUEST_PROTOCOL_VERSION: protocol_version,
    Cmd.GET_HOME_POSITION: get_home_position,
    Cmd.DO_SET_HOME: set_home,
}
