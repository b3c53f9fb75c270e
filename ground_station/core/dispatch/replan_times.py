"""How long it took to plan a day anew, and what came of it."""

from dataclasses import dataclass, field
from enum import Enum

from ground_station.core.fleet.time_counts import TimeCounts

BOUNDS_S = (1.0, 5.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0)
"""A dozen customers take seconds, a thousand five minutes; after 900 s a planner is given up."""


class ReplanResult(Enum):
    """What came of it. `REFUSED`: there is no plan, or it breaks a promise. `DIED`: its planner
    ended without an answer and is asked again.
    """

    TAKEN = "taken"
    REFUSED = "refused"
    DIED = "died"


@dataclass(slots=True)
class ReplanTimes:
    """Of one desk since it began."""

    by_result: dict[str, TimeCounts] = field(default_factory=dict)

    def ended(self, result: ReplanResult, took_s: float) -> None:
        """One has ended."""
        before = self.by_result.get(result.value) or TimeCounts.none(BOUNDS_S)
        self.by_result[result.value] = before.and_one(took_s)
