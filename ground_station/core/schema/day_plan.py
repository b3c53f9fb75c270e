"""The day plan (`day-plan/1`, JSON) shared by planner, desk, simulator and operators.

Times are seconds after the truck first leaves the depot. Stops are in the order of the truck's
route; the first and the last are the depot. A sortie's home is a stop that the truck promises
(safety rule 3): the truck is there before the drone lands, and stays until the drone has landed or
has confirmed another home.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType

from companion.core.base.location import Location
from companion.core.base.wire_message import Name
from companion.fleet.messages import Id, OperatorText

Seconds = Annotated[float, Meta(ge=0.0)]
Metres = Annotated[float, Meta(gt=0.0)]


class _StrictStruct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class that refuses unknown fields."""


class PlannedStop(_StrictStruct, frozen=True, kw_only=True):
    """A stop of the truck."""

    id: Id
    """The stop's name."""
    location: Location = msgspec.field(name="place")
    """Position of the truck."""
    arrive_s: Seconds
    """Arrival of the truck."""
    depart_s: Seconds
    """Departure of the truck."""
    serves: list[Id] = []
    """Orders that the driver delivers from here."""
    pads: dict[Name, Location] = {}
    """Pad of each drone for launch and landing. The spacing lets two drones climb and descend at
    once.
    """


class PlannedSortie(_StrictStruct, frozen=True, kw_only=True):
    """One flight: `order` by `vehicle`, from the pad at stop `launch` to that at stop `home`."""

    order: Id
    """The delivered order."""
    vehicle: Name
    """The drone that delivers it."""
    launch: Id
    """The stop where it takes off."""
    home: Id
    """The stop where it lands."""
    launch_s: Seconds
    """Its launch slot."""
    land_s: Seconds
    """Expected touchdown."""
    outbound_height_m: Metres
    """Layer of the outbound route, above the launch pad (safety rule 7)."""
    return_height_m: Metres
    """Layer of the return route, above the launch pad (safety rule 7)."""
    energy_wh: Seconds
    """Expected energy use."""
    required_wh: Seconds = msgspec.field(name="sure_wh")
    """Energy use at the accepted loss."""
    usable_wh: Seconds
    """Usable energy."""
    alternative_stops: list[Id] = msgspec.field(default_factory=list, name="others")
    """Alternative landing stops, in case the truck promises them."""
    out_s: Seconds | UnsetType = UNSET
    """Time from the launch to the drop, of an order with a window or priority."""

    @property
    def drop_s(self) -> float:
        """Expected drop; half-way to the touchdown if its time is not stated."""
        half_s = 0.5 * (self.land_s - self.launch_s)
        return self.launch_s + (self.out_s if isinstance(self.out_s, float) else half_s)


class UnplannedOrder(_StrictStruct, frozen=True, kw_only=True):
    """An order that cannot be delivered under present conditions, and the remedy."""

    order: Id
    """The order."""
    reason: OperatorText = msgspec.field(name="why")
    """Cause that prevents the delivery."""
    remedy: OperatorText
    """Change that would make the delivery possible."""


class SkippedPart(_StrictStruct, frozen=True, kw_only=True):
    """A part of a file that is not used."""

    place: str
    """The row or feature."""
    reason: str
    """Cause that prevents its use."""


class ImportedFile(_StrictStruct, frozen=True, kw_only=True):
    """The import of one file."""

    file: str
    """Name of the file."""
    content: str
    """Kind of its parts."""
    used: int
    """Number of parts in use."""
    skipped: list[SkippedPart] = []
    """Parts that are not used."""
    suspicious: list[str] = []
    """What an operator should check."""
    notes: list[str] = []
    """How it was read, where that differs from the documented format."""


class DayPlan(_StrictStruct, frozen=True, kw_only=True):
    """A `day-plan/1` file: the truck's stops and the drones' flights of a day.

    Times are seconds after the truck first leaves the depot. `policy`, `seed` and `trials`
    reproduce it.
    """

    format: Literal["day-plan/1"]
    """The kind of file and its version."""
    day: str
    """The day's name."""
    policy: str
    """The planning policy."""
    seed: int
    """Seed of the search."""
    trials: int
    """Trials of the search."""
    makespan_s: Seconds
    """Return of the truck with all orders delivered."""
    stops: list[PlannedStop]
    """The truck's route; the first and the last stop are the depot."""
    sorties: list[PlannedSortie]
    """The drones' flights."""
    unplanned: list[UnplannedOrder] = []
    """Orders that cannot be delivered."""
    revision: Annotated[int, Meta(ge=0)] = 0
    """Number of re-plans of this day."""
    imports: list[ImportedFile] | UnsetType = UNSET
    """What `ground-station plan` used of each file of the day, and skipped. A desk drops it."""

    def delivery_times_s(self) -> dict[str, tuple[float, str]]:
        """Return by order the expected drop or arrival of the driver, and the vehicle as text."""
        served = {
            order: (stop.arrive_s, f"by the truck at {stop.id}")
            for stop in self.stops
            for order in stop.serves
        }
        return served | {one.order: (one.drop_s, f"by {one.vehicle}") for one in self.sorties}

    def get_stop(self, id_: str) -> PlannedStop:
        """Return the stop with this id. Raises KeyError if there is none."""
        for stop in self.stops:
            if stop.id == id_:
                return stop
        raise KeyError(id_)


def format_minutes_and_seconds(plan_time_s: float) -> str:
    """Format a time of the plan: minutes and seconds since its start, as 4:05."""
    minutes, seconds = divmod(max(0, round(plan_time_s)), 60)
    return f"{minutes}:{seconds:02d}"
