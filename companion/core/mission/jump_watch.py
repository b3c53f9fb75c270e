"""Jumps that are believed only when telemetry shows them: asked again, then given up.

MISSION_CURRENT has no time, and PX4 sends it at 1 Hz: a report that was sent before the order may
arrive after it. Such a report is not about the order: it neither confirms nor undoes it.
"""

import math
from dataclasses import dataclass, field
from enum import Enum

from companion.core.mission.mission_items import DeadMansMission

CONFIRM_S = 2.5
TRIES = 3
TURN_S = 10.0
AWAY_M = 25.0
AT_ITEM_M = 50.0
PAST_M = 150.0
"""Beyond an item that it has passed: ten seconds at top speed, so that late reports are none."""

MISSED_M, MISSED_S = 40.0, 10.0
"""So far beyond, and opening for so long at whatever speed: it does not come back to it. PX4 that
was too low over a waypoint went 15 m on, and back."""

OPENS_MPS, CREEPS_MPS = 2.0, 0.5
"""Slower away from a place than the first is no flight away from it; in a gale the second is."""

OLDER_S = 1.0
"""A report overtaken by others arrives up to so late (as `LATE_S` of the adapters' clock)."""


class Purpose(Enum):
    """Why a jump was ordered."""

    ONWARD = "onward"
    HOME = "home"
    MOVE = "another home"


class JumpStatus(Enum):
    """What has become of a jump."""

    WAITING = "waiting"
    ASK_AGAIN = "ask again"
    REFUSED = "refused"


@dataclass(slots=True)
class JumpWatch:
    """One jump from the order until the vehicle flies it.

    `before`: the items that were reported just before the order, at `began_s`.
    """

    index: int
    purpose: Purpose
    ordered_s: float
    before: frozenset[int] = frozenset()
    tries: int = 1
    refused: bool = False
    began_s: float = field(init=False)

    def __post_init__(self) -> None:
        self.began_s = self.ordered_s

    def confirms(self, mission: DeadMansMission, index: int, arrived_s: float) -> bool:
        """Tell whether a report of this item, arrived then, shows that the jump was obeyed."""
        may_be_older = index in self.before and arrived_s - self.began_s <= OLDER_S
        return not may_be_older and self._shows(mission, index)

    def explains(self, mission: DeadMansMission, index: int) -> bool:
        """Tell whether the autopilot may fly this item by itself while the jump is pending: it is
        no farther than the next place after the items reported so far.
        """
        for at in (self.index, *self.before):
            place = mission.next_place(at)
            beyond = place not in (None, index) and mission.follows(place or 0, index)
            if mission.follows(at, index) and (at == index or not beyond):
                self.before |= {index}
                return True
        return not self.before

    def shown_by(self, mission: DeadMansMission) -> frozenset[int]:
        """The items beside its own that show that the jump was obeyed, and cannot be older."""
        items = range(len(mission.items))
        return frozenset(i for i in items if self._shows(mission, i)) - {self.index, *self.before}

    def left_behind(self, mission: DeadMansMission, index: int) -> bool:
        """Tell whether this item may have been flown before the jump, and not since.

        The way home, too: it follows every outbound waypoint, so the mission may have turned home
        just before a jump outward reached it.
        """
        if index == self.index:
            return False
        if self.purpose is not Purpose.ONWARD:
            return index in self.before
        onward = mission.part_at(index) is mission.part_at(self.index)
        return not onward and any(mission.follows(at, index) for at in self.before)

    def wait(self, t_s: float) -> JumpStatus:
        """No report confirms it so far: wait on, ask again, or give it up."""
        if not self.refused and t_s - self.ordered_s < CONFIRM_S:
            return JumpStatus.WAITING
        if self.tries >= TRIES:
            return JumpStatus.REFUSED
        self.tries += 1
        self.refused = False
        self.ordered_s = t_s
        return JumpStatus.ASK_AGAIN

    def _shows(self, mission: DeadMansMission, index: int) -> bool:
        """Tell whether this item shows that the jump was obeyed.

        The way home follows every outbound waypoint: there it may just as well be where the
        vehicle was before a jump outward (MISSION_CURRENT has no time).
        """
        if index == self.index:
            return True
        same = mission.part_at(index) is mission.part_at(self.index)
        onward = self.purpose is Purpose.ONWARD
        return mission.follows(self.index, index) and (same or not onward)


@dataclass(slots=True)
class CourseWatch:
    """Whether the vehicle really flies where it was sent: it may turn first, not fly away."""

    since_s: float
    distance_m: float

    def disobeys(self, t_s: float, distance_m: float, closing_mps: float) -> bool:
        """Tell whether it has got well farther away and still does, long after it should turn."""
        self.distance_m = min(self.distance_m, distance_m)
        return (
            t_s - self.since_s > TURN_S
            and distance_m > self.distance_m + AWAY_M
            and closing_mps < -OPENS_MPS
        )


@dataclass(slots=True)
class LegWatch:
    """Whether an autopilot that shows one item takes it, or flies on beyond.

    PX4's SIH was seen past an item by 2 km, in its mission, with every report as ever. Who is blown
    off its track by more than the radius of acceptance misses one, too.
    """

    index: int
    nearest_m: float = math.inf
    beyond_m: float = 0.0
    """How much farther than it was at the nearest."""
    closing_mps: float = 0.0
    opens_since_s: float | None = None

    def pause(self) -> None:
        """Where it is is not known for now."""
        self.opens_since_s, self.closing_mps = None, 0.0

    def watch(self, t_s: float, distance_m: float, closing_mps: float) -> None:
        """Where it is from its item (m), and how fast it comes nearer (m/s)."""
        self.nearest_m = min(self.nearest_m, distance_m)
        self.beyond_m = distance_m - self.nearest_m
        self.closing_mps = closing_mps
        if closing_mps >= -CREEPS_MPS:
            self.opens_since_s = None
        elif self.opens_since_s is None:
            self.opens_since_s = t_s

    def has_missed(self, t_s: float) -> bool:
        """Tell whether it was at its item, is beyond, and has long been flying away from it."""
        if self.has_flown_past():
            return True
        if self.opens_since_s is None or self.nearest_m >= AT_ITEM_M:
            return False
        return self.beyond_m > MISSED_M and t_s - self.opens_since_s > MISSED_S

    def has_flown_past(self) -> bool:
        """Tell whether it was at its item, is far beyond, and still opens."""
        opens = self.closing_mps < -OPENS_MPS
        return opens and self.nearest_m < AT_ITEM_M and self.beyond_m > PAST_M
