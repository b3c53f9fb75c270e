"""A row of the standing suite: what is done to a flight, in which phases, and what must hold."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from sim_bridge.app.faults.stage import Stage
from sim_bridge.app.faults.verdict import (
    Ask,
    FlownFault,
    claims_no_delivery,
    comes_home,
    ends_in_order,
    fault_began,
    promises_nothing_false,
    raises_nothing,
)

PHASES = ("ready", "climb", "outbound", "drop", "return", "land")
"""Where in a flight a fault begins; the names of the command line and of the results."""

FLYING = ("climb", "outbound", "drop", "return")
"""Those in the air, but for the landing."""

IN_THE_AIR = (*FLYING, "land")
"""All of those in the air."""

BOTH = ("px4", "ardupilot")

SAFE: tuple[Ask, ...] = (comes_home, promises_nothing_false)
"""What nearly every row asks."""

Play = Callable[[Stage], Iterator[None]]
"""What happens, step by step: each `yield` is an exchange of 0.1 s with the companion."""


def from_the_start(stage: Stage) -> Iterator[None]:
    """The world itself is the fault: its air, its pack, its computer."""
    stage.begin()
    yield


@dataclass(frozen=True, slots=True)
class FaultCase:
    """One row. `asks` are judged by truth; each returns what is wrong, or None.

    `flight` changes the flight file, table by table; `untold` changes the world's alone, and the
    companion is given a file without it. `arguments` are more of the companion's.
    `before_companion` is Python that runs first in its process: a computer that is not what it
    should be. `ends_after_s`: the flight is ended so long after a person has taken over, where
    nobody is expected to come home. `signed`: autopilot and companion share a signing key.
    """

    number: int
    name: str
    group: str
    says: str
    play: Play
    asks: tuple[Ask, ...] = (comes_home,)
    phases: tuple[str, ...] = ("outbound",)
    autopilots: tuple[str, ...] = BOTH
    flight: dict[str, Any] = field(default_factory=dict)
    untold: dict[str, Any] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    before_companion: str = ""
    ends_after_s: float | None = None
    signed: bool = False

    def wrong(self, flown: FlownFault, *, tight: bool = False) -> list[str]:
        """What does not hold. In any flight: the fault begins, nobody raises, it ends in order.

        A `tight` flight may be refused, may turn back, and may come home or not as P(home) says:
        that is judged over many.
        """
        kept = tuple(ask for ask in self.asks if ask is claims_no_delivery)
        asks = kept if tight else (fault_began, *self.asks)
        found = [ask(flown) for ask in (*asks, raises_nothing, ends_in_order)]
        return [words for words in found if words]
