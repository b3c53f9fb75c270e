"""Mission, fence and rally items as an autopilot stores them.

Each autopilot accepts and returns items differently: see `mission_items.py` of each.
"""

from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.enums import Cmd, MissionResult, MissionType

NO_COORDINATE = 2**31 - 1
"""INT32_MAX in x or y: no coordinate given (MAVLink's NaN for integers)."""


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One stored item: `x`, `y` in degE7 for commands with a position, else params 5, 6."""

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
    def first_four_params(self) -> tuple[float, float, float, float]:
        """The four float parameters."""
        return self.param1, self.param2, self.param3, self.param4


POSITIONED_COMMANDS = frozenset(
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
"""Commands whose x and y are a position."""

NAVIGATION_COMMANDS = frozenset(
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


def coordinate_error(item: MissionItem) -> MissionResult | None:
    """Return the error in an item's coordinates; None if they are in range."""
    if item.command not in POSITIONED_COMMANDS:
        return None
    if item.x != NO_COORDINATE and abs(item.x) > 900_000_000:
        return MissionResult.INVALID_PARAM5_X
    if item.y != NO_COORDINATE and abs(item.y) > 1_800_000_000:
        return MissionResult.INVALID_PARAM6_Y
    return None


NAN_YAW_COMMANDS = frozenset({Cmd.NAV_WAYPOINT, Cmd.NAV_LAND, Cmd.NAV_TAKEOFF})
"""Commands whose param4 is a heading; NaN leaves it open."""


@dataclass(slots=True)
class MissionStore:
    """The three lists of items, which survive a reboot."""

    mission: list[MissionItem] = field(default_factory=list)
    fence: list[MissionItem] = field(default_factory=list)
    rally: list[MissionItem] = field(default_factory=list)

    marked_current: int | None = None
    """Number of the item that the last mission upload marked as the current one."""
    areas_revision: int = 0
    """Counts the changes of fence and rally points."""

    def items_of_type(self, mission_type: int) -> list[MissionItem]:
        """The list of one mission type."""
        return {
            MissionType.MISSION: self.mission,
            MissionType.FENCE: self.fence,
            MissionType.RALLY: self.rally,
        }[MissionType(mission_type)]
