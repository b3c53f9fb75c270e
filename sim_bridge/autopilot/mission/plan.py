"""The order of mission items: jumps, their counters, and the items ahead."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.enums import Cmd
from sim_bridge.autopilot.mission.items import MissionItem

_JUMPS_AT_ONCE = 255
"""DO_JUMPs in a row after which an autopilot gives up on a mission that only jumps."""


@dataclass(slots=True)
class Plan:
    """The items that are being flown. `first` is 1 if item 0 is the home position."""

    first: int
    forever: int
    """The repeat count that means without end."""
    items: Sequence[MissionItem] = ()
    jumps_done: dict[int, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.items)

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to fly."""
        return len(self.items) <= self.first

    def landing_at(self, index: int, *, consume: bool) -> int | None:
        """The item that is flown at `index`, after following DO_JUMPs.

        `consume` counts the jumps; None is the end of the mission, or a jump to nowhere.
        """
        done = self.jumps_done if consume else dict(self.jumps_done)
        for _ in range(_JUMPS_AT_ONCE):
            if not self.first <= index < len(self.items):
                return None
            item = self.items[index]
            if item.command != Cmd.DO_JUMP:
                return index
            repeats = int(item.param2)
            if done.get(index, 0) < repeats or repeats == self.forever:
                done[index] = done.get(index, 0) + 1
                index = int(item.param1)
            else:
                index += 1
        return None

    def ahead(self, index: int) -> Iterator[MissionItem]:
        """The items that would come after `index`, without counting any jump."""
        for _ in range(len(self.items)):
            following = self.landing_at(index + 1, consume=False)
            if following is None:
                return
            index = following
            yield self.items[index]

    def speed_before(self, index: int) -> float | None:
        """Speed of the last DO_CHANGE_SPEED in front of an item, in the order of storage."""
        speed = None
        for item in self.items[: max(index, 0)]:
            if item.command == Cmd.DO_CHANGE_SPEED:
                speed = item.param2 if item.param2 > 0.0 else None
        return speed
