"""Jumps are confirmed by telemetry only: they are repeated, then abandoned.

MISSION_CURRENT has no time, and PX4 sends it at 1 Hz: a report sent before the order may arrive
after it. Such a report is unrelated to the order: it neither confirms nor undoes it.
"""

import math
from dataclasses import dataclass, field
from enum import Enum

from companion.core.mission.command_life_cycle import UNCHANGED_MAX_AGE_S, CommandKind
from companion.core.mission.mission_items import ReturnByDefaultMission

JUMP = CommandKind.JUMP.value

UNREPORTED_TIMEOUT_S = 2.5
"""Time without a report of the item after which a try counts as used."""

TURN_GRACE_S = 10.0
MAX_RECESSION_M = 25.0
ITEM_RADIUS_M = 50.0
PAST_ITEM_M = 150.0
"""Distance beyond a passed item: ten seconds at top speed, which excludes late reports."""

OVERSHOOT_M, OVERSHOOT_S = 40.0, 10.0
"""Distance beyond the item, and time spent moving away at any speed, after which the vehicle does
not return to it. PX4 that was too low over a waypoint went 15 m beyond it, and back."""

RECESSION_MPS, MIN_RECESSION_MPS = 2.0, 0.5
"""Minimum opening speed of a flight away from a position; in a gale the second applies."""

MAX_REPORT_DELAY_S = 1.0
"""Maximum delay of a report that others overtook (as `MAX_LATE_S` of the adapters' clock)."""


class JumpType(Enum):
    """Purpose of a jump."""

    ONWARD = "onward"
    HOME = "home"
    OTHER_HOME = "another home"


class JumpStatus(Enum):
    """Status of a jump."""

    WAITING = "waiting"
    REPEAT = "repeat"
    UNREPORTED = "no item reported"
    REFUSED = "refused"


@dataclass(slots=True)
class JumpMonitor:
    """One jump, from the order until the vehicle flies it.

    `previous_items`: the items reported just before the order, at `first_ordered_s`, and those that
    the autopilot flew on its own since. `unchanged_s`: last report of one of them.
    """

    index: int
    jump_type: JumpType
    ordered_s: float
    previous_items: frozenset[int] = frozenset()
    tries: int = 1
    refused: bool = False
    unchanged_s: float = -math.inf
    first_ordered_s: float = field(init=False)

    def __post_init__(self) -> None:
        self.first_ordered_s = self.ordered_s

    def is_confirmed_by_report(
        self, mission: ReturnByDefaultMission, reported_item: int, report_received_s: float
    ) -> bool:
        """Return whether a report of this item, received at that time, confirms the jump."""
        is_ambiguous = (
            reported_item in self.previous_items
            and report_received_s - self.first_ordered_s <= MAX_REPORT_DELAY_S
        )
        return not is_ambiguous and self._is_confirming_item(mission, reported_item)

    def record_if_intermediate_item(
        self, mission: ReturnByDefaultMission, reported_item: int
    ) -> bool:
        """Return whether the autopilot may fly this item on its own while the jump is pending: it
        is at most the next positioned item after those reported so far.
        """
        for item in (self.index, *self.previous_items):
            next_positioned = mission.next_positioned_item(item)
            is_past = next_positioned not in (
                None,
                reported_item,
            ) and mission.is_item_reachable_without_jump(next_positioned or 0, reported_item)
            if mission.is_item_reachable_without_jump(item, reported_item) and (
                item == reported_item or not is_past
            ):
                self.previous_items |= {reported_item}
                return True
        return not self.previous_items

    def other_confirming_items(self, mission: ReturnByDefaultMission) -> frozenset[int]:
        """Return the other items that confirm the jump and cannot be from an older report."""
        items = range(len(mission.items))
        return frozenset(i for i in items if self._is_confirming_item(mission, i)) - {
            self.index,
            *self.previous_items,
        }

    def is_possibly_stale_item(self, mission: ReturnByDefaultMission, reported_item: int) -> bool:
        """Return whether this item may have been flown before the jump but not since.

        The return route counts too: it follows every outbound waypoint, so the mission may have
        turned home just before a jump outward reached it.
        """
        if reported_item == self.index:
            return False
        if self.jump_type is not JumpType.ONWARD:
            return reported_item in self.previous_items
        onward = mission.part_of_item(reported_item) is mission.part_of_item(self.index)
        return not onward and any(
            mission.is_item_reachable_without_jump(item, reported_item)
            for item in self.previous_items
        )

    def update_retry_status(self, t_s: float) -> JumpStatus:
        """Without confirmation so far: wait, repeat the order, or abandon it.

        It is repeated only if a recent report shows the item unchanged, or if it was refused.
        """
        waited_s = t_s - self.ordered_s
        if not self.refused and waited_s < JUMP.interval_s:
            return JumpStatus.WAITING
        is_permitted = self.refused or t_s - self.unchanged_s <= UNCHANGED_MAX_AGE_S
        if not is_permitted and waited_s < UNREPORTED_TIMEOUT_S:
            return JumpStatus.WAITING
        if self.tries >= JUMP.max_tries:
            return JumpStatus.REFUSED
        self.tries += 1
        self.refused = False
        self.ordered_s = t_s
        return JumpStatus.REPEAT if is_permitted else JumpStatus.UNREPORTED

    def _is_confirming_item(self, mission: ReturnByDefaultMission, reported_item: int) -> bool:
        """Return whether this item confirms the jump.

        The return route follows every outbound waypoint: such a report may refer to the position
        before a jump outward (MISSION_CURRENT has no time).
        """
        if reported_item == self.index:
            return True
        same_part = mission.part_of_item(reported_item) is mission.part_of_item(self.index)
        onward = self.jump_type is JumpType.ONWARD
        return mission.is_item_reachable_without_jump(self.index, reported_item) and (
            same_part or not onward
        )


@dataclass(slots=True)
class CourseMonitor:
    """Checks that the vehicle flies to its target: it may turn first but not fly away."""

    since_s: float
    distance_m: float

    def update_and_check_off_course(
        self, t_s: float, distance_m: float, closing_mps: float
    ) -> bool:
        """Return whether it is well farther away and still opening long after its turn."""
        self.distance_m = min(self.distance_m, distance_m)
        return (
            t_s - self.since_s > TURN_GRACE_S
            and distance_m > self.distance_m + MAX_RECESSION_M
            and closing_mps < -RECESSION_MPS
        )


@dataclass(slots=True)
class LegMonitor:
    """Checks whether an autopilot that reports one item reaches it or flies beyond it.

    PX4's SIH flew 2 km past an item, in its mission, with regular reports. A vehicle blown off its
    track by more than the acceptance radius misses an item too.
    """

    index: int
    nearest_m: float = math.inf
    overshoot_m: float = 0.0
    """Increase of the distance since the closest approach."""
    closing_mps: float = 0.0
    receding_since_s: float | None = None

    def suspend_check(self) -> None:
        """Suspend the check while the position is unknown."""
        self.receding_since_s, self.closing_mps = None, 0.0

    def record_distance_and_closing_speed(
        self, t_s: float, distance_m: float, closing_mps: float
    ) -> None:
        """Update with the distance to the item (m) and the closing speed (m/s)."""
        self.nearest_m = min(self.nearest_m, distance_m)
        self.overshoot_m = distance_m - self.nearest_m
        self.closing_mps = closing_mps
        if closing_mps >= -MIN_RECESSION_MPS:
            self.receding_since_s = None
        elif self.receding_since_s is None:
            self.receding_since_s = t_s

    def has_overshot_item(self, t_s: float) -> bool:
        """Return whether it was at its item, is beyond it, and has long been opening."""
        if self.has_flown_far_past_item():
            return True
        if self.receding_since_s is None or self.nearest_m >= ITEM_RADIUS_M:
            return False
        return self.overshoot_m > OVERSHOOT_M and t_s - self.receding_since_s > OVERSHOOT_S

    def has_flown_far_past_item(self) -> bool:
        """Return whether it was at its item, is far beyond, and still opens."""
        is_receding = self.closing_mps < -RECESSION_MPS
        return is_receding and self.nearest_m < ITEM_RADIUS_M and self.overshoot_m > PAST_ITEM_M
