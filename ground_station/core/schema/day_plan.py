"""The day plan (`day-plan/1`, JSON) that planner, desk, simulator and people share.

Times are seconds after the truck leaves the depot for the first time. Stops are in the order of the
truck's route; the first and the last are the depot. A sortie's home is a stop that the truck
promises (safety rule 3): the truck is there before the drone lands, and stays until the drone is
down or has confirmed another home.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.core.base.place import Place
from companion.core.base.wire_message import Name
from companion.fleet.messages import Id, Words

Seconds = Annotated[float, Meta(ge=0.0)]
Metres = Annotated[float, Meta(gt=0.0)]


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Unknown fields are refused."""


class PlannedStop(_Part, frozen=True, kw_only=True):
    """The truck stands here from `arrive_s` to `depart_s`. `serves`: orders that the driver
    delivers.

    `pads`: one for each drone that launches or lands here, far enough apart for two drones to
    climb and descend at once.
    """

    id: Id
    place: Place
    arrive_s: Seconds
    depart_s: Seconds
    serves: list[Id] = []
    pads: dict[Name, Place] = {}


class PlannedSortie(_Part, frozen=True, kw_only=True):
    """One flight: `order` by `vehicle`, from the pad at stop `launch` to that at stop `home`.

    `launch_s` is its launch slot, `land_s` the expected touchdown. Heights are above the launch
    pad: one layer for the way out, one for the way back (safety rule 7). `others`: further stops
    where it could land if the truck promised them. `energy_wh`: expected energy. `sure_wh`: the
    same at the accepted loss. `usable_wh`: what it may use.
    """

    order: Id
    vehicle: Name
    launch: Id
    home: Id
    launch_s: Seconds
    land_s: Seconds
    outbound_height_m: Metres
    return_height_m: Metres
    energy_wh: Seconds
    sure_wh: Seconds
    usable_wh: Seconds
    others: list[Id] = []


class Unplanned(_Part, frozen=True, kw_only=True):
    """An order that nobody can bring as things are, and what would make it possible."""

    order: Id
    why: Words
    remedy: Words


class DayPlan(_Part, frozen=True, kw_only=True):
    """A `day-plan/1` file. `revision` counts re-plans of one day.

    `policy`, `seed` and `trials` reproduce it.
    """

    format: Literal["day-plan/1"]
    day: str
    policy: str
    seed: int
    trials: int
    makespan_s: Seconds
    stops: list[PlannedStop]
    sorties: list[PlannedSortie]
    unplanned: list[Unplanned] = []
    revision: Annotated[int, Meta(ge=0)] = 0

    def stop(self, id_: str) -> PlannedStop:
        """The stop of this id. Raises KeyError where there is none."""
        for stop in self.stops:
            if stop.id == id_:
                return stop
        raise KeyError(id_)
