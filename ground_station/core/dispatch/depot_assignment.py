"""Who flies what next from the depot, by the paper's rule (IV-A): the nearest customer that a free
drone can reach at the accepted loss, to the drone that is back first.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, place_ned
from companion.core.base.place import Place
from companion.core.mission.flight_plan import frame_at
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.airframe import Airframe
from ground_station.core.feasibility.reach import CanBring, CannotBring, Reach
from ground_station.core.schema.day import Day, Drone
from ground_station.core.schema.day_plan import PlannedSortie
from ground_station.core.schema.order_parsing import place_of
from ground_station.core.schema.orders import (
    AssignmentRow,
    AssignmentState,
    Order,
    OrderRow,
    OrderState,
    Service,
)

ANY_CHARGE = [0.05, 1.0]
"""The desk does not know the charge of a pack: the companion finds it out at rest."""


@dataclass(frozen=True, slots=True)
class Free:
    """A drone that may be given work, with its charge where its resting voltage tells it."""

    vehicle: str
    charge_frac: float | None


@dataclass(frozen=True, slots=True)
class Choice:
    """Give this order to this drone."""

    order: Order
    vehicle: str


class Chooser:
    """Chooses for one day. Reaches are kept: the energy model's tables take a moment to make."""

    def __init__(self, day: Day, airframes: Mapping[str, Airframe]) -> None:
        self._day = day
        self._frame = frame_at(day.depot.place)
        energies = {
            name: RouteEnergy(airframe, cruise_airspeed_mps=day.mission.cruise_airspeed_mps)
            for name, airframe in airframes.items()
        }
        self._reach = {
            d.id: Reach(d, airframes[d.airframe], day.mission, day.forecast, energies[d.airframe])
            for d in day.drones
        }

    def choose(
        self, orders: list[OrderRow], assignments: list[AssignmentRow], free: list[Free]
    ) -> list[Choice]:
        """New work for free drones, at most one order each."""
        waiting = [
            row.order
            for row in orders
            if row.state is OrderState.OPEN and row.order.service is not Service.TRUCK
        ]
        refused = {
            (row.order_id, row.vehicle)
            for row in assignments
            if row.state is AssignmentState.REFUSED
        }
        return self._nearest(waiting, refused, list(free))

    def _nearest(
        self, waiting: list[Order], refused: set[tuple[str, str]], free: list[Free]
    ) -> list[Choice]:
        chosen: list[Choice] = []
        for order in sorted(waiting, key=lambda o: (math.hypot(*self.ground_ned(o)[:2]), o.id)):
            if not free:
                break
            able: list[tuple[float, str, Free]] = []
            for drone in free:
                time_s = self._time_s(order, drone)
                if time_s is not None and (order.id, drone.vehicle) not in refused:
                    able.append((time_s, drone.vehicle, drone))
            if able:
                _, vehicle, drone = min(able, key=lambda a: a[:2])
                free.remove(drone)
                chosen.append(Choice(order, vehicle))
        return chosen

    def _time_s(self, order: Order, drone: Free) -> float | None:
        """How long this drone takes to bring it; None: it cannot, as it is charged."""
        reach = self._reach.get(drone.vehicle)
        if reach is None:
            return None
        return reach.time_s(order.mass_kg, self.ground_ned(order), drone.charge_frac)

    def ground_ned(self, order: Order) -> Ned:
        """The ground at an order's place, NED about the depot."""
        return place_ned(self._frame, place_of(order))

    def can_bring(
        self, order: Order, vehicle: str, charge_frac: float | None = None
    ) -> CanBring | CannotBring:
        """Whether a drone can bring an order from the depot and come home to it."""
        reach = self._reach.get(vehicle)
        if reach is None:
            return CannotBring("not in the day's fleet", "name it under [[drones]]")
        ned = self.ground_ned(order)
        return reach.can_bring(order.mass_kg, ned, charge_frac=charge_frac)

    def impossible(self, order: Order) -> CannotBring | None:
        """Why no drone of the day can bring an order from the depot; the least bad reason."""
        if order.service is Service.TRUCK:
            return None
        found = [self.can_bring(order, drone.id) for drone in self._day.drones]
        cannot = [f for f in found if isinstance(f, CannotBring)]
        if len(cannot) < len(found) or not cannot:
            return None
        # Out of reach can be mended by a stop of the truck; too heavy cannot.
        return max(cannot, key=lambda f: "short" in f.why)

    def flight_of(self, order: Order, vehicle: str) -> dict[str, Any]:
        """The `flight/1` table that a drone is assigned."""
        drone = self._day.drone(vehicle)
        if drone is None:
            raise LeewayError(f"{vehicle}: not in the day's fleet")
        return flight_table(self._day, drone, order)


def flight_table(day: Day, drone: Drone, order: Order) -> dict[str, Any]:
    """A delivery from the depot as a `flight/1` table; unknown charge stays unknown."""
    site = {"depot": day.depot.place, "customer": place_of(order), "rally": day.rally}
    return {
        "format": "flight/1",
        "name": order.id,
        "site": {key: _bare(value) for key, value in site.items()},
        "vehicle": {
            "airframe": drone.airframe,
            "payload_kg": order.mass_kg,
            "charge_frac": ANY_CHARGE,
            "temperature_c": drone.temperature_c,
            "battery_health_frac": drone.battery_health_frac,
        },
        "mission": _bare(day.mission),
    }


def sortie_table(
    day: Day, drone: Drone, order: Order, sortie: PlannedSortie, pads: Mapping[str, Place]
) -> dict[str, Any]:
    """A flight from a truck's stop to the stop that the truck promises; `pads`: by stop, where it
    could land.
    """
    table = flight_table(day, drone, order)
    mission = msgspec.structs.replace(
        day.mission,
        cruise_height_m=sortie.outbound_height_m,
        return_height_m=sortie.return_height_m,
    )
    stops = [msgspec.structs.replace(place, name=stop) for stop, place in pads.items()]
    site = table["site"] | {
        "depot": _bare(msgspec.structs.replace(pads[sortie.launch], name="pad")),
        "stops": _bare(stops),
        "home": sortie.home,
    }
    return table | {"site": site, "mission": _bare(mission)}


def _bare(value: Any) -> Any:
    """Plain values, without what is not set."""
    if isinstance(value, list):
        return [_bare(item) for item in value]
    table = msgspec.to_builtins(value)
    return {k: v for k, v in table.items() if v is not None and (k, v) != ("up_m", 0.0)}
