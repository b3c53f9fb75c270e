"""What a plan begins from: the start of the day, or a day under way with its promises."""

from dataclasses import dataclass

from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop


@dataclass(frozen=True, slots=True)
class DayState:
    """The part of the day that stays as it is.

    `stops`: past and promised ones, in order, with the times expected now; the new plan begins
    at the last one. `flying`: sorties in the air, or too close to their launch to change; each
    ends at one of `stops`. `open`: orders still to be planned: neither with one of `flying` nor
    served at one of `stops`. `free_from_s`: when each drone can be used again (aboard with a
    fresh pack); a lost drone is absent.
    """

    stops: tuple[PlannedStop, ...]
    flying: tuple[PlannedSortie, ...]
    open: tuple[str, ...]
    free_from_s: dict[str, float]
    revision: int = 0


def first_state(data: DayData) -> DayState:
    """The start of the day: everything at the depot, all orders open."""
    depot = PlannedStop(id="depot", place=data.day.depot.place, arrive_s=0.0, depart_s=0.0)
    return DayState(
        stops=(depot,),
        flying=(),
        open=tuple(order.id for order in data.orders),
        free_from_s={drone.id: 0.0 for drone in data.day.drones},
    )
