"""Assignment from the depot: who flies which order next.

The rule of arXiv 2604.13441, section IV-A: the nearest customer that a free drone can reach at the
accepted loss goes to the drone that is back first.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, place_ned
from companion.core.mission.flight_plan import frame_at
from companion.core.vehicle.airframe import Airframe
from ground_station.core.dispatch.flight_tables import delivery_table
from ground_station.core.feasibility.reach import Feasible, Infeasible, Reach, day_energy
from ground_station.core.schema.day import Day
from ground_station.core.schema.orders import (
    AssignmentRow,
    AssignmentState,
    Order,
    OrderRow,
    OrderState,
    Service,
    place_of,
)


@dataclass(frozen=True, slots=True)
class FreeDrone:
    """A drone that may be given work. `charge_frac`: by its resting voltage, None where not
    known.
    """

    vehicle: str
    charge_frac: float | None


@dataclass(frozen=True, slots=True)
class DroneAssignment:
    """This order goes to this drone."""

    order: Order
    vehicle: str


class DepotAssigner:
    """Assigns the orders of one day. Each drone's `Reach` is kept: its energy tables take a
    moment.
    """

    def __init__(self, day: Day, airframes: Mapping[str, Airframe]) -> None:
        self._day = day
        self._frame = frame_at(day.depot.place)
        energies = {name: day_energy(day, airframe) for name, airframe in airframes.items()}
        self._reach = {
            d.id: Reach(d, airframes[d.airframe], day.mission, day.forecast, energies[d.airframe])
            for d in day.drones
        }

    def assign(
        self, orders: list[OrderRow], assignments: list[AssignmentRow], free: list[FreeDrone]
    ) -> list[DroneAssignment]:
        """New assignments for free drones, at most one order each."""
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
        self, waiting: list[Order], refused: set[tuple[str, str]], free: list[FreeDrone]
    ) -> list[DroneAssignment]:
        chosen: list[DroneAssignment] = []
        for order in sorted(waiting, key=lambda o: (math.hypot(*self.ground_ned(o)[:2]), o.id)):
            if not free:
                break
            able: list[tuple[float, str, FreeDrone]] = []
            for drone in free:
                time_s = self._time_s(order, drone)
                if time_s is not None and (order.id, drone.vehicle) not in refused:
                    able.append((time_s, drone.vehicle, drone))
            if able:
                _, vehicle, drone = min(able, key=lambda a: a[:2])
                free.remove(drone)
                chosen.append(DroneAssignment(order, vehicle))
        return chosen

    def _time_s(self, order: Order, drone: FreeDrone) -> float | None:
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
    ) -> Feasible | Infeasible:
        """Whether a drone can bring an order from the depot and come home to it."""
        reach = self._reach.get(vehicle)
        if reach is None:
            return Infeasible("not in the day's fleet", "name it under [[drones]]")
        ned = self.ground_ned(order)
        return reach.can_bring(order.mass_kg, ned, charge_frac=charge_frac)

    def impossible(self, order: Order) -> Infeasible | None:
        """Why no drone of the day can bring an order from the depot: the reason that is easiest to
        mend.
        """
        if order.service is Service.TRUCK:
            return None
        found = [self.can_bring(order, drone.id) for drone in self._day.drones]
        cannot = [f for f in found if isinstance(f, Infeasible)]
        if len(cannot) < len(found) or not cannot:
            return None
        # A stop of the truck can mend "out of reach", not "too heavy".
        return max(cannot, key=lambda f: "short" in f.why)

    def flight_of(self, order: Order, vehicle: str) -> dict[str, Any]:
        """The `flight/1` table of an order for a drone."""
        drone = self._day.drone(vehicle)
        if drone is None:
            raise LeewayError(f"{vehicle}: not in the day's fleet")
        return delivery_table(self._day, drone, order)
