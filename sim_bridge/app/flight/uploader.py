"""Another ground station that uploads a mission while the vehicle flies."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import Cmd
from sim_bridge.autopilot.mission.items import MissionItem

DRAGGED_E7 = 134_900
"""1.5 km to the north, in 1e-7 degrees."""

CHANGED = 3
"""Items that are cut off or added."""


def edited(items: Sequence[MissionItem], edit: str) -> list[MissionItem]:
    """The mission aboard as another ground station has edited it."""
    match edit:
        case "cut":
            return list(items[:-CHANGED])
        case "add":
            return [*items, *[_dragged(items[0])] * CHANGED]
        case "foreign":
            return [_away(item) for item in items]
        case "same":
            return list(items)
        case _:
            return [_dragged(item) for item in items]


def _dragged(item: MissionItem) -> MissionItem:
    is_waypoint = item.command == Cmd.NAV_WAYPOINT
    return replace(item, x=item.x + DRAGGED_E7) if is_waypoint else item


def _away(item: MissionItem) -> MissionItem:
    """A waypoint far off for every item but the take-off."""
    if item.command == Cmd.NAV_TAKEOFF:
        return item
    place = item if item.x else replace(item, x=554_700_000, y=84_500_000)
    return MissionItem(
        Cmd.NAV_WAYPOINT, 3, x=place.x + 2 * DRAGGED_E7, y=place.y, z=30.0, autocontinue=True
    )


@dataclass(slots=True)
class Uploader:
    """Answers the autopilot's requests for the items of one upload."""

    items: list[MissionItem] = field(default_factory=list)

    def answer(self, request: Message) -> list[Message]:
        """The item that is asked for."""
        if not 0 <= request.seq < len(self.items):
            return []
        item = self.items[request.seq]
        return [
            Message(
                "MISSION_ITEM_INT",
                target_system=request.src_system,
                target_component=request.src_component,
                seq=request.seq,
                frame=int(item.frame),
                command=int(item.command),
                current=0,
                autocontinue=int(item.autocontinue),
                param1=item.param1,
                param2=item.param2,
                param3=item.param3,
                param4=item.param4,
                x=item.x,
                y=item.y,
                z=item.z,
                mission_type=0,
            )
        ]
