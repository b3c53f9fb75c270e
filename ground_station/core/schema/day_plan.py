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
    """A place where the truck stands for a while."""

    id: Id
    """The stop's name."""
    place: Place
    """Where the truck stands."""
    arrive_s: Seconds
    """When the truck comes."""
    depart_s: Seconds
    """When it leaves."""
    serves: list[Id] = []
    """Orders that the driver brings from here."""
    pads: dict[Name, Place] = {}
    """Where each drone stands for launch and landing, apart enough for two to go up and down
    at once.
    """


class PlannedSortie(_Part, frozen=True, kw_only=True):
    """One flight: `order` by `vehicle`, from the pad at stop `launch` to that at stop `home`."""

    order: Id
    """The order that is brought."""
    vehicle: Name
    """The drone that brings it."""
    launch: Id
    """The stop where it takes off."""
    home: Id
    """The stop where it lands."""
    launch_s: Seconds
    """Its launch slot."""
    land_s: Seconds
    """Expected touchdown."""
    outbound_height_m: Metres
    """Layer of the way out, above the launch pad (safety rule 7)."""
    return_height_m: Metres
    """Layer of the way back, above the launch pad (safety rule 7)."""
    energy_wh: Seconds
    """What the flight is expected to use."""
    sure_wh: Seconds
    """What it uses at the accepted loss."""
    usable_wh: Seconds
    """What it may use."""
    others: list[Id] = []
    """Further stops that it could land at, should the truck promise them."""


class Unplanned(_Part, frozen=True, kw_only=True):
    """An order that nobody can bring as things are, and what would make it possible."""

    order: Id
    """The order."""
    why: Words
    """Why nobody can bring it."""
    remedy: Words
    """What would make it possible."""


class DayPlan(_Part, frozen=True, kw_only=True):
    """A `day-plan/1` file: the truck's stops and the drones' flights of a day.

    Times are seconds after the truck first leaves the depot. `policy`, `seed` and `trials` make it
    again.
    """

    format: Literal["day-plan/1"]
    """The kind of file and its version."""
    day: str
    """The day's name."""
    policy: str
    """What made the plan."""
    seed: int
    """Seed of the search."""
    trials: int
    """Trials of the search."""
    makespan_s: Seconds
    """When the truck is back with everything done."""
    stops: list[PlannedStop]
    """The truck's route; the first and the last stop are the depot."""
    sorties: list[PlannedSortie]
    """The drones' flights."""
    unplanned: list[Unplanned] = []
    """Orders that nobody can bring."""
    revision: Annotated[int, Meta(ge=0)] = 0
    """Counts re-plans of one day."""

    def stop(self, id_: str) -> PlannedStop:
        """The stop of this id. Raises KeyError where there is none."""
        for stop in self.stops:
            if stop.id == id_:
                return stop
        raise KeyError(id_)


def since_start(t_s: float) -> str:
    """A time of the plan for people: minutes and seconds since its start, as 4:05."""
    minutes, seconds = divmod(round(t_s), 60)
    return f"{minutes}:{seconds:02d}"
