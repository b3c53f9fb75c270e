"""The interface of the paper's planners: a batch of missions in, the next edge of each out.

One mission is a batch of one: the vehicle and the campaign run the same code.
"""

from dataclasses import dataclass
from typing import Protocol

from companion.core.base.arrays import Bools, Floats, Ints

STAY = -1  # stop at the depot, undelivered: ABRT
NOWHERE = -2  # no edge leads on from here: the mission is lost


@dataclass(frozen=True, slots=True)
class Look:
    """What planners see at the vertices where n missions stand; all arrays of length n.

    `seen` indexes the sight's winds where the wind is a known chain and is -1 otherwise;
    `wind_en_mps` (n, 2) is the seen wind as a vector (a class's centre where classes hide it).
    """

    mission: Ints
    vertex: Ints
    delivered: Bools
    energy_wh: Floats
    seen: Ints
    wind_en_mps: Floats

    @property
    def count(self) -> int:
        return len(self.mission)


class Decider(Protocol):
    """A planner at work on one batch of missions: it may remember, mission by mission."""

    def decide(self, look: Look) -> Ints:
        """The edge that each mission flies next, or STAY, or NOWHERE."""
        ...


class MissionPlanner(Protocol):
    """A way to plan; `begin` starts a batch of missions, each with a uniform number of its own."""

    @property
    def name(self) -> str: ...

    def begin(self, coin: Floats) -> Decider:
        """A decider for len(coin) missions; `coin` decides where a policy is a mixture."""
        ...
