"""Assignment from the depot: who flies which order next.

The rule of arXiv 2604.13441, section IV-A: the nearest customer that a free drone can reach at the
accepted loss goes to the drone that is back first.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, place_ned
from companion.core.base.place import Place
from companion.core.mission.flight_plan import frame_at
from companion.core.vehicle.airframe import Airframe
from ground_station.core.deconfliction.depot_layers import DepotLayers
from ground_station.core.dispatch.dispatch_rules import ON_PAD_M, distance_m
from ground_station.core.dispatch.flight_tables import delivery_table
from ground_station.core.feasibility.hills import hills_of
from ground_station.core.feasibility.reach import (
    Feasible,
    Infeasible,
    Reach,
    SortieNeed,
    day_energy,
)
from ground_station.core.planning.day_problem import TOP_M
from ground_station.core.schema.day import Day, Drone, Forecast
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.orders import (
    IN_FORCE,
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
    known. `stand`: where it stands; None: where the day's depot is.
    """

    vehicle: str
    charge_frac: float | None
    stand: Place | None = None


@dataclass(frozen=True, slots=True)
class DroneAssignment:
    """This order goes to this drone, in this layer over the depot; it lands where it stands."""

    order: Order
    vehicle: str
    layer: int = 0
    stand: Place | None = None


_Kind = tuple[str, float | None, float, float]
"""Airframe, temperature, health and charge of a drone: all that what it can bring depends on."""


class DepotAssigner:
    """Assigns the orders of one day.

    What a delivery takes is worked out once for each airframe and order and kept, since it takes a
    thousand times as long as to ask whether a pack pays for it; and what is possible at all once
    for each kind of drone. A day may have a hundred drones of one kind.
    """

    def __init__(
        self,
        day: Day,
        airframes: Mapping[str, Airframe],
        elevation: SiteElevation | None = None,
    ) -> None:
        self._day = day
        self._elevation = elevation
        self._frame = frame_at(day.depot.place)
        energies = {name: day_energy(day, airframe) for name, airframe in airframes.items()}
        hills = hills_of(day, elevation)
        self._reach = {
            d.id: Reach(
                d, airframes[d.airframe], day.mission, day.forecast, energies[d.airframe], hills
            )
            for d in day.drones
        }
        self._of_kind: dict[_Kind, Reach] = {_kind(r.drone): r for r in self._reach.values()}
        self._ned: dict[str, Ned] = {}
        self._need: dict[tuple[str, str, int], SortieNeed] = {}
        self.layers = DepotLayers(day.mission, TOP_M)
        self._at_best: dict[tuple[_Kind, str], bool] = {}

    def plan_in(self, wind: Forecast) -> None:
        """Price all in this wind from now on."""
        self._reach = {name: reach.in_wind(wind) for name, reach in self._reach.items()}
        self._of_kind = {_kind(r.drone): r for r in self._reach.values()}
        self._need.clear()
        self._at_best.clear()

    def assign(
        self,
        orders: list[OrderRow],
        assignments: list[AssignmentRow],
        free: list[FreeDrone],
        first: Sequence[str] = (),
    ) -> list[DroneAssignment]:
        """New assignments for free drones, at most one order each; `first`: orders that go before
        nearer ones, in this order.
        """
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
        rank = {id_: number for number, id_ in enumerate(first)}
        last = len(rank)
        away_m = {order.id: math.hypot(*self.ground_ned(order)[:2]) for order in waiting}
        waiting.sort(key=lambda o: (rank.get(o.id, last), away_m[o.id], o.id))
        return self._next(waiting, refused, list(free), _taken(assignments))

    def is_full(self, assignments: list[AssignmentRow]) -> bool:
        """Whether every layer is taken over ground as high as the depot's."""
        return self.layers.lowest_free(_taken(assignments), 0.0) is None

    def _next(
        self,
        waiting: list[Order],
        refused: set[tuple[str, str]],
        free: list[FreeDrone],
        taken: set[int],
    ) -> list[DroneAssignment]:
        chosen: list[DroneAssignment] = []
        for order in waiting:
            if not free:
                break
            layer = self.layers.lowest_free(taken, -self.ground_ned(order)[2])
            if layer is None:
                continue
            able: list[tuple[float, str, FreeDrone]] = []
            for drone in free:
                time_s = self._time_s(order, drone, layer)
                if time_s is not None and (order.id, drone.vehicle) not in refused:
                    able.append((time_s, drone.vehicle, drone))
            if able:
                _, vehicle, drone = min(able, key=lambda a: a[:2])
                free.remove(drone)
                taken.add(layer)
                chosen.append(DroneAssignment(order, vehicle, layer, drone.stand))
        return chosen

    def _time_s(self, order: Order, drone: FreeDrone, layer: int) -> float | None:
        """How long this drone takes to bring it in a layer; None: it cannot, as it is charged."""
        reach = self._reach.get(drone.vehicle)
        if reach is None or not self._can_when_full(order, reach):
            return None
        need = self._need_of(order, reach, layer)
        return need.time_s if reach.pays(need, order.mass_kg, drone.charge_frac) else None

    def _can_when_full(self, order: Order, reach: Reach) -> bool:
        """Whether a drone of this kind could bring it with a full pack."""
        key = (_kind(reach.drone), order.id)
        if key not in self._at_best:
            mass_kg = order.mass_kg
            can = reach.lifts(mass_kg) and reach.pays(self._need_of(order, reach), mass_kg, 1.0)
            self._at_best[key] = can
        return self._at_best[key]

    def _need_of(self, order: Order, reach: Reach, layer: int = 0) -> SortieNeed:
        """What its delivery takes from the depot and back, of drones of this airframe."""
        key = (reach.drone.airframe, order.id, layer)
        if key not in self._need:
            depot, there = (0.0, 0.0, 0.0), self.ground_ned(order)
            up_m = self.layers.mission_in(layer).cruise_height_m
            self._need[key] = reach.need(order.mass_kg, depot, there, depot, up_m)
        return self._need[key]

    def ground_ned(self, order: Order) -> Ned:
        """The ground at an order's place, NED about the depot."""
        if order.id not in self._ned:
            self._ned[order.id] = place_ned(self._frame, place_of(order))
        return self._ned[order.id]

    def can_bring(
        self, order: Order, vehicle: str, charge_frac: float | None = None
    ) -> Feasible | Infeasible:
        """Whether a drone can bring an order from the depot and come home to it."""
        reach = self._reach.get(vehicle)
        if reach is None:
            return Infeasible("not in the day's fleet", "name it under [[drones]]")
        return self._can_bring(order, reach, charge_frac)

    def _can_bring(
        self, order: Order, reach: Reach, charge_frac: float | None = None
    ) -> Feasible | Infeasible:
        need = self._need_of(order, reach) if reach.lifts(order.mass_kg) else None
        ned = self.ground_ned(order)
        return reach.can_bring(order.mass_kg, ned, charge_frac=charge_frac, need=need)

    def impossible(self, order: Order) -> Infeasible | None:
        """Why no drone of the day can bring an order from the depot: the reason that is easiest to
        mend.
        """
        if order.service is Service.TRUCK:
            return None
        found = [self._can_bring(order, reach) for reach in self._of_kind.values()]
        cannot = [f for f in found if isinstance(f, Infeasible)]
        if len(cannot) < len(found) or not cannot:
            return None
        # A stop of the truck can mend "out of reach", not "too heavy".
        return max(cannot, key=lambda f: "short" in f.why)

    def flight_of(
        self, order: Order, vehicle: str, layer: int = 0, stand: Place | None = None
    ) -> dict[str, Any]:
        """The `flight/1` table of an order for a drone, in a layer over the depot.

        It lands at `stand`, where it takes off: each drone of a depot has a landing place of its
        own, as far from others as it stands from them. None: where the day's depot is.
        """
        drone = self._day.drone(vehicle)
        if drone is None:
            raise LeewayError(f"{vehicle}: not in the day's fleet")
        mission = self.layers.mission_in(layer)
        depot = self._day.depot
        if stand is not None:
            depot = msgspec.structs.replace(depot, lat_deg=stand.lat_deg, lon_deg=stand.lon_deg)
        day = msgspec.structs.replace(self._day, mission=mission, depot=depot)
        return delivery_table(day, drone, order, self._elevation)

    def stand_of(self, lat_deg: float | None, lon_deg: float | None) -> Place | None:
        """Where a drone stands that is seen at the depot; None where it is not."""
        depot = self._day.depot.place
        away_m = distance_m(lat_deg, lon_deg, depot)
        if away_m is None or away_m > ON_PAD_M:
            return None
        return Place(lat_deg=lat_deg, lon_deg=lon_deg, alt_amsl_m=depot.alt_amsl_m)


def _taken(assignments: list[AssignmentRow]) -> set[int]:
    """Layers that are taken; an assignment without one is of a time before there were layers, and
    flies at the mission's own heights.
    """
    return {row.layer or 0 for row in assignments if row.state in IN_FORCE}


def _kind(drone: Drone) -> _Kind:
    return drone.airframe, drone.temperature_c, drone.battery_health_frac, drone.charge_frac
