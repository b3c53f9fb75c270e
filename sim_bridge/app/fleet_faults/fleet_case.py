"""A row of the suite that strikes a fleet: what is done to a small day, and what must hold."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from sim_bridge.app.faults.case import BOTH, PHASES
from sim_bridge.app.fleet_faults.fleet_stage import FleetStage
from sim_bridge.app.fleet_faults.fleet_verdict import ALWAYS, Ask, FlownDay

GROUP = "fleet"
DAY_S = 900.0
"""An untroubled day is over after some 200 s; a replan and a second flight take as long again."""

FleetPlay = Callable[[FleetStage], Iterator[None]]
"""What happens, step by step: each `yield` is a second of the day."""


@dataclass(frozen=True, slots=True)
class FleetCase:
    """One row. The struck drone has the autopilot that is asked for, its neighbour the other.

    `asks` come beside what every row asks. `day_s`: a day that is not over by then has failed.
    """

    number: int
    name: str
    says: str
    play: FleetPlay
    asks: tuple[Ask, ...] = ()
    phases: tuple[str, ...] = PHASES
    group: str = GROUP
    autopilots: tuple[str, ...] = BOTH
    day_s: float = DAY_S

    def wrong(self, flown: FlownDay) -> list[str]:
        """What does not hold."""
        return [words for ask in (*ALWAYS, *self.asks) for words in ask(flown)]
