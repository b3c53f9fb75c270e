"""COMMAND_LONG and COMMAND_INT as one kind of command."""

import math
from dataclasses import dataclass

from sim_bridge.autopilot.mavlink.codec import Message

FORCE_DISARM = 21196.0
"""param2 of COMPONENT_ARM_DISARM that disarms in flight (both autopilots; PX4 also arms by it)."""


@dataclass(frozen=True, slots=True)
class Command:
    """One command; `lat_deg`, `lon_deg` are params 5 and 6 as a position, `frame` None for LONG."""

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
    def sender_system_and_component(self) -> tuple[int, int]:
        """System and component that sent it."""
        return self.system, self.component

    @property
    def lat_deg(self) -> float:
        """Param 5 as degrees; NaN when not given."""
        return self.param5

    @property
    def lon_deg(self) -> float:
        """Param 6 as degrees; NaN when not given."""
        return self.param6


def command_from_long(link_id: int, message: Message) -> Command:
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


def command_from_int(link_id: int, message: Message) -> Command:
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


def int_or_default(value: float, default: int = -1) -> int:
    """A float parameter as an integer, however wild it is."""
    return int(value) if math.isfinite(value) and abs(value) < 2**31 else default
