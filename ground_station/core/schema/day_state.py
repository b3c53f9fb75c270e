"""What a plan begins from: the start of the day, or a day under way with promises to keep."""

from dataclasses import dataclass

from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop


@dataclass(frozen=True, slots=True)
class DayState:
    """The part of the day that stands.

    `stops`: done and promised, in order, with the times as expected now; the last is where the new
    plan begins, and keeps its id. `flying`: sorties in the air, or so near their launch that they
    stay as they are; each ends at one of `stops`. `open`: the orders still to be planned, neither
    with one of `flying` nor served at one of `stops`. `free_from_s`: the drones that can be used
    again, and from when (aboard with a fresh pack); one that is lost is absent.
    """

    stops: tuple[PlannedStop, ...]
    flying: tuple[PlannedSortie, ...]
    open: tuple[str, ...]
    free_from_s: dict[str, float]
    revision: int = 0


def first_state(data: DayData) -> DayState:
    """Everything at the depot, all orders open."""
    depot = PlannedStop(id="depot", place=data.day.depot.place, arrive_s=0.0, depart_s=0.0)
    return DayState(
        stops=(depot,),
        flying=(),
        open=tuple(order.id for order in data.orders),
        free_from_s={drone.id: 0.0 for drone in data.day.drones},
    )
