"""Jumps that are believed only when telemetry shows them: asked again, then given up."""

from dataclasses import dataclass
from enum import Enum

from companion.core.mission.mission_items import DeadMansMission

CONFIRM_S = 2.5
TRIES = 3
TURN_S = 10.0
AWAY_M = 25.0


class Purpose(Enum):
    """Why a jump was ordered."""

    ONWARD = "onward"
    HOME = "home"
    MOVE = "another home"


class JumpStatus(Enum):
    """What has become of a jump."""

    WAITING = "waiting"
    ASK_AGAIN = "ask again"
    CONFIRMED = "confirmed"
    REFUSED = "refused"


@dataclass(slots=True)
class JumpWatch:
    """One jump from the order until the vehicle flies it."""

    index: int
    purpose: Purpose
    ordered_s: float
    tries: int = 1
    refused: bool = False

    def update(self, mission: DeadMansMission, index: int | None, t_s: float) -> JumpStatus:
        """Judge by the item that the autopilot says it flies."""
        if index is not None and self._shows(mission, index):
            return JumpStatus.CONFIRMED
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
            and closing_mps < -2.0
        )
