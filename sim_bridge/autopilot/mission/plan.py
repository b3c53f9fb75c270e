"""The order of mission items: jumps, their counters, and the remaining items."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.enums import Cmd
from sim_bridge.autopilot.mission.items import MissionItem

_MAX_CONSECUTIVE_JUMPS = 255
"""DO_JUMPs in a row after which an autopilot gives up on a mission that only jumps."""


@dataclass(slots=True)
class Plan:
    """The items that are being flown. `first` is 1 if item 0 is the home position."""

    first: int
    unlimited_repeats: int
    """The repeat count that means without end."""
    items: Sequence[MissionItem] = ()
    jumps_done: dict[int, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.items)

    @property
    def is_empty(self) -> bool:
        """Return True if there is nothing to fly."""
        return len(self.items) <= self.first

    def item_index_after_jumps(self, item_index: int, *, count_jumps: bool) -> int | None:
        """Return the item to fly at `item_index`, after following DO_JUMPs.

        `count_jumps` counts the jumps; None means the end of the mission, or an invalid jump.
        """
        done = self.jumps_done if count_jumps else dict(self.jumps_done)
        for _ in range(_MAX_CONSECUTIVE_JUMPS):
            if not self.first <= item_index < len(self.items):
                return None
            item = self.items[item_index]
            if item.command != Cmd.DO_JUMP:
                return item_index
            repeats = int(item.param2)
            if done.get(item_index, 0) < repeats or repeats == self.unlimited_repeats:
                done[item_index] = done.get(item_index, 0) + 1
                item_index = int(item.param1)
            else:
                item_index += 1
        return None

    def items_flown_after(self, item_index: int) -> Iterator[MissionItem]:
        """The items that would come after `item_index`, without counting any jump."""
        for _ in range(len(self.items)):
            next_item = self.item_index_after_jumps(item_index + 1, count_jumps=False)
            if next_item is None:
                return
            item_index = next_item
            yield self.items[item_index]

    def last_speed_command_before_mps(self, item_index: int) -> float | None:
        """Speed of the last DO_CHANGE_SPEED in front of an item, in the order of storage."""
        speed = None
        for item in self.items[: max(item_index, 0)]:
            if item.command == Cmd.DO_CHANGE_SPEED:
                speed = item.param2 if item.param2 > 0.0 else None
        return speed
