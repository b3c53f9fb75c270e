"""Mission, fence and rally items as an autopilot stores them, and its rules for taking them.

What each autopilot accepts and what it gives back differs item by item. Sources: the measured
facts; ArduPilot, libraries/AP_Mission/AP_Mission.cpp (mavlink_int_to_mission_cmd and back,
sanity_check_params); PX4, src/modules/mavlink/mavlink_mission.cpp (parse_mavlink_mission_item,
format_mavlink_mission_item).
"""

import math
from dataclasses import dataclass, field, replace
from typing import Protocol

from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    RELATIVE_FRAMES,
    TERRAIN_FRAMES,
    Cmd,
    Frame,
    MissionResult,
    MissionType,
)

NO_COORDINATE = 2**31 - 1
"""INT32_MAX in x or y: no coordinate given (MAVLink's NaN for integers)."""


@dataclass(frozen=True, slots=True)
class Item:
    """One item as stored: `x`, `y` in degE7 where the command has a place, else its params 5, 6."""

    command: int
    frame: int
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    x: int = 0
    y: int = 0
    z: float = 0.0
    autocontinue: bool = True

    @property
    def params(self) -> tuple[float, float, float, float]:
        """The four float parameters."""
        return self.param1, self.param2, self.param3, self.param4


PLACED = frozenset(
    {
        Cmd.NAV_WAYPOINT,
        Cmd.NAV_LOITER_UNLIM,
        Cmd.NAV_LOITER_TIME,
        Cmd.NAV_LOITER_TO_ALT,
        Cmd.NAV_LAND,
        Cmd.NAV_TAKEOFF,
        Cmd.DO_SET_HOME,
        Cmd.DO_SET_ROI_LOCATION,
        Cmd.DO_SET_ROI,
        Cmd.NAV_FENCE_RETURN_POINT,
        Cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        Cmd.NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
        Cmd.NAV_FENCE_CIRCLE_INCLUSION,
        Cmd.NAV_FENCE_CIRCLE_EXCLUSION,
        Cmd.NAV_RALLY_POINT,
    }
)
"""Commands whose x and y are a place."""

NAVIGATING = frozenset(
    {
        Cmd.NAV_WAYPOINT,
        Cmd.NAV_LOITER_UNLIM,
        Cmd.NAV_LOITER_TIME,
        Cmd.NAV_LOITER_TO_ALT,
        Cmd.NAV_RETURN_TO_LAUNCH,
        Cmd.NAV_LAND,
        Cmd.NAV_TAKEOFF,
        Cmd.NAV_GUIDED_ENABLE,
        Cmd.NAV_DELAY,
    }
)
"""Commands that take time and move, or hold, the vehicle; the others are done at once."""

FENCE_COMMANDS = frozenset(
    {
        Cmd.NAV_FENCE_RETURN_POINT,
        Cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        Cmd.NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
        Cmd.NAV_FENCE_CIRCLE_INCLUSION,
        Cmd.NAV_FENCE_CIRCLE_EXCLUSION,
    }
)


class MissionRules(Protocol):
    """How an autopilot takes part in the mission protocol."""

    @property
    def request_name(self) -> str:
        """Name of the message by which an upload asks for the next item."""
        ...

    @property
    def unknown_type(self) -> MissionResult:
        """The answer to an upload of a type that there is not."""
        ...

    @property
    def has_home_item(self) -> bool:
        """Whether index 0 of a mission is the home position, whatever was uploaded there."""
        ...

    @property
    def is_atomic(self) -> bool:
        """Whether an upload takes effect as a whole, after its last item."""
        ...

    @property
    def takes_partial_writes(self) -> bool:
        """Whether MISSION_WRITE_PARTIAL_LIST is answered."""
        ...

    @property
    def retry_s(self) -> float:
        """Seconds after which an item is asked for again."""
        ...

    @property
    def timeout_s(self) -> float:
        """Seconds of silence after which a transfer is given up."""
        ...

    @property
    def capacity(self) -> int:
        """Items that storage holds."""
        ...

    def take(self, item: Item, mission_type: int) -> Item | MissionResult:
        """The item as it is stored, or why it is refused."""
        ...

    def give(self, item: Item) -> Item:
        """The item as it is read back in a MISSION_ITEM_INT."""
        ...


def _place_error(item: Item) -> MissionResult | None:
    if item.command not in PLACED:
        return None
    if item.x != NO_COORDINATE and abs(item.x) > 900_000_000:
        return MissionResult.INVALID_PARAM5_X
    if item.y != NO_COORDINATE and abs(item.y) > 1_800_000_000:
        return MissionResult.INVALID_PARAM6_Y
    return None


_ARDUPILOT_COMMANDS = frozenset(
    {
        *NAVIGATING,
        Cmd.CONDITION_DELAY,
        Cmd.CONDITION_YAW,
        Cmd.DO_JUMP,
        Cmd.DO_CHANGE_SPEED,
        Cmd.DO_SET_HOME,
        Cmd.DO_SET_SERVO,
        Cmd.DO_LAND_START,
        Cmd.DO_SET_ROI_LOCATION,
        Cmd.DO_SET_ROI_NONE,
        Cmd.DO_SET_ROI,
        Cmd.DO_SET_CAM_TRIGG_DIST,
        Cmd.DO_FENCE_ENABLE,
        Cmd.DO_GRIPPER,
        Cmd.DO_GUIDED_LIMITS,
    }
) - {Cmd.NAV_LOITER_TO_ALT}
_ARDUPILOT_YAW_MAY_BE_NAN = frozenset({Cmd.NAV_WAYPOINT, Cmd.NAV_LAND, Cmd.NAV_TAKEOFF})
_ARDUPILOT_KEPT = {
    Cmd.NAV_WAYPOINT: 0b0001,
    Cmd.NAV_LOITER_UNLIM: 0b0000,
    Cmd.NAV_LOITER_TIME: 0b0001,
    Cmd.NAV_RETURN_TO_LAUNCH: 0b0000,
    Cmd.NAV_LAND: 0b0001,
    Cmd.NAV_TAKEOFF: 0b0001,
    Cmd.DO_JUMP: 0b0011,
    Cmd.DO_CHANGE_SPEED: 0b0111,
    Cmd.DO_SET_SERVO: 0b0011,
    Cmd.DO_GRIPPER: 0b0011,
    Cmd.NAV_GUIDED_ENABLE: 0b0001,
    Cmd.DO_FENCE_ENABLE: 0b0001,
    Cmd.CONDITION_DELAY: 0b0001,
}
"""Bit i: parameter i+1 survives storage; commands not named keep all four."""
_ARDUPILOT_WHOLE_SECONDS = frozenset({Cmd.NAV_WAYPOINT, Cmd.NAV_LOITER_TIME})
_ARDUPILOT_FRAMES = {
    **dict.fromkeys(AMSL_FRAMES, Frame.GLOBAL),
    **dict.fromkeys(RELATIVE_FRAMES, Frame.GLOBAL_RELATIVE_ALT),
    **dict.fromkeys(TERRAIN_FRAMES, Frame.GLOBAL_TERRAIN_ALT),
    Frame.MISSION: Frame.GLOBAL,
}
_ARDUPILOT_ALT_MAX_M = 83_000.0


@dataclass(frozen=True, slots=True)
class ArduPilotMissionRules:
    """Items are squeezed into ArduPilot's 15 bytes: what has no room there does not come back."""

    request_name: str = "MISSION_REQUEST"
    unknown_type: MissionResult = MissionResult.UNSUPPORTED
    has_home_item: bool = True
    is_atomic: bool = False
    takes_partial_writes: bool = True
    retry_s: float = 1.0
    timeout_s: float = 8.0
    capacity: int = 724

    def take(self, item: Item, mission_type: int) -> Item | MissionResult:
        """The item as it is stored, or why it is refused."""
        supported = {
            MissionType.MISSION: _ARDUPILOT_COMMANDS,
            MissionType.FENCE: FENCE_COMMANDS,
            MissionType.RALLY: {Cmd.NAV_RALLY_POINT},
        }.get(MissionType(mission_type), frozenset())
        if item.command not in supported:
            return MissionResult.UNSUPPORTED
        for number, value in enumerate(item.params):
            yaw = number == 3 and item.command in _ARDUPILOT_YAW_MAY_BE_NAN
            if not math.isfinite(value) and not yaw:
                return MissionResult(MissionResult.INVALID_PARAM1 + number)
        error = _place_error(item)
        if error is not None:
            return error
        frame = int(Frame.GLOBAL)
        if item.command in PLACED:
            known = _ARDUPILOT_FRAMES.get(Frame(item.frame)) if item.frame in _FRAMES else None
            if known is None:
                return MissionResult.UNSUPPORTED_FRAME
            if NO_COORDINATE in (item.x, item.y):
                return MissionResult.INVALID_PARAM5_X
            if not abs(item.z) <= _ARDUPILOT_ALT_MAX_M:
                return MissionResult.INVALID_PARAM7
            frame = int(known)
        kept = _ARDUPILOT_KEPT.get(Cmd(item.command), 0b1111)
        params = [
            value if kept >> number & 1 and math.isfinite(value) else 0.0
            for number, value in enumerate(item.params)
        ]
        if item.command in _ARDUPILOT_WHOLE_SECONDS:
            params[0] = float(min(65535, max(0, int(params[0]))))
        z = round(item.z * 100.0) / 100.0 if item.command in PLACED else 0.0
        x, y = (item.x, item.y) if item.command in PLACED else (0, 0)
        return Item(item.command, frame, *params, x=x, y=y, z=z)

    def give(self, item: Item) -> Item:
        """The item as it is read back in a MISSION_ITEM_INT."""
        return item


_FRAMES = frozenset(Frame)
_PX4_PLACED = frozenset(
    {
        Cmd.NAV_WAYPOINT,
        Cmd.NAV_LOITER_UNLIM,
        Cmd.NAV_LOITER_TIME,
        Cmd.NAV_LAND,
        Cmd.NAV_TAKEOFF,
        Cmd.NAV_LOITER_TO_ALT,
        Cmd.DO_SET_ROI_LOCATION,
    }
)
_PX4_PLACELESS = frozenset(
    {
        Cmd.DO_JUMP,
        Cmd.DO_GRIPPER,
        Cmd.DO_CHANGE_SPEED,
        Cmd.DO_SET_HOME,
        Cmd.DO_LAND_START,
        Cmd.DO_SET_CAM_TRIGG_DIST,
        Cmd.NAV_DELAY,
        Cmd.NAV_RETURN_TO_LAUNCH,
        Cmd.DO_SET_ROI_NONE,
        Cmd.CONDITION_DELAY,
        Cmd.CONDITION_DISTANCE,
        Cmd.DO_SET_ACTUATOR,
        Cmd.DO_TRIGGER_CONTROL,
        Cmd.DO_GIMBAL_MANAGER_PITCHYAW,
        Cmd.DO_GIMBAL_MANAGER_CONFIGURE,
    }
)
"""These need frame MISSION (2): with any other frame PX4 answers UNSUPPORTED."""
_PX4_KEPT = {
    Cmd.NAV_WAYPOINT: 0b1011,
    Cmd.NAV_LOITER_UNLIM: 0b1100,
    Cmd.NAV_LOITER_TIME: 0b1111,
    Cmd.NAV_LAND: 0b1010,
    Cmd.NAV_TAKEOFF: 0b1000,
    Cmd.NAV_LOITER_TO_ALT: 0b1011,
    Cmd.NAV_RALLY_POINT: 0b0000,
}
PX4_JUMP_FOREVER = 65535
"""PX4 keeps the repeats unsigned in 16 bits: -1 becomes this."""


@dataclass(frozen=True, slots=True)
class Px4MissionRules:
    """Items with a place keep their frame and NaN; items without one need frame MISSION."""

    request_name: str = "MISSION_REQUEST_INT"
    unknown_type: MissionResult = MissionResult.NO_SPACE
    has_home_item: bool = False
    is_atomic: bool = True
    takes_partial_writes: bool = False
    retry_s: float = 0.25
    timeout_s: float = 5.0
    capacity: int = 500

    def take(self, item: Item, mission_type: int) -> Item | MissionResult:
        """The item as it is stored, or why it is refused."""
        if item.frame == Frame.MISSION:
            if mission_type != MissionType.MISSION or item.command not in _PX4_PLACELESS:
                return MissionResult.UNSUPPORTED
            if item.command == Cmd.DO_JUMP:
                jump, repeats = item.param1, item.param2
                if not (math.isfinite(jump) and math.isfinite(repeats)):
                    return MissionResult.INVALID
                return replace(item, param2=float(int(repeats) & PX4_JUMP_FOREVER))
            return item
        if item.frame not in AMSL_FRAMES | RELATIVE_FRAMES:
            return MissionResult.UNSUPPORTED_FRAME
        supported = {
            MissionType.MISSION: _PX4_PLACED,
            MissionType.FENCE: FENCE_COMMANDS | {Cmd.NAV_WAYPOINT},  # taken, and then no fence
            MissionType.RALLY: {Cmd.NAV_RALLY_POINT},
        }.get(MissionType(mission_type), frozenset())
        if item.command not in supported:
            return MissionResult.UNSUPPORTED
        kept = _PX4_KEPT.get(Cmd(item.command), 0b1111)
        params = [value if kept >> number & 1 else 0.0 for number, value in enumerate(item.params)]
        if item.command in _ARDUPILOT_YAW_MAY_BE_NAN and math.isfinite(params[3]):
            params[3] %= 360.0
        return replace(item, param1=params[0], param2=params[1], param3=params[2], param4=params[3])

    def give(self, item: Item) -> Item:
        """The item as it is read back in a MISSION_ITEM_INT."""
        if item.frame in AMSL_FRAMES:
            return replace(item, frame=int(Frame.GLOBAL_INT))
        if item.frame in RELATIVE_FRAMES:
            return replace(item, frame=int(Frame.GLOBAL_RELATIVE_ALT_INT))
        return item


@dataclass(slots=True)
class MissionStore:
    """What survives a reboot: the three lists of items."""

    mission: list[Item] = field(default_factory=list)
    fence: list[Item] = field(default_factory=list)
    rally: list[Item] = field(default_factory=list)

    def of(self, mission_type: int) -> list[Item]:
        """The list of one mission type."""
        return {
            MissionType.MISSION: self.mission,
            MissionType.FENCE: self.fence,
            MissionType.RALLY: self.rally,
        }[MissionType(mission_type)]
