"""Initial state of a plan: the start of the day, or a day in progress with its promises."""

from dataclasses import dataclass

from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import PlannedSortie, PlannedStop


@dataclass(frozen=True, slots=True)
class DayState:
    """The fixed part of the day.

    `stops`: past and promised ones, in order, with the times expected now; the new plan begins at
    the last one. `airborne`: sorties in the air, or too close to their launch to change; each ends
    at one of `stops`. `open_orders`: orders still to be planned: neither with one of `airborne` nor
    served at one of `stops`. `available_from_s`: when each drone is available again (on the truck
    with a charged pack); a lost drone is absent.
    """

    stops: tuple[PlannedStop, ...]
    airborne: tuple[PlannedSortie, ...]
    open_orders: tuple[str, ...]
    available_from_s: dict[str, float]
    revision: int = 0


def initial_state(data: DayData) -> DayState:
    """Return the start of the day: truck and drones at the depot, all orders open."""
    depot = PlannedStop(id="depot", location=data.day.depot.location, arrive_s=0.0, depart_s=0.0)
    return DayState(
        stops=(depot,),
        airborne=(),
        open_orders=tuple(order.id for order in data.orders),
        available_from_s={drone.id: 0.0 for drone in data.day.drones},
    )
