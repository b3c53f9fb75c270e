"""Assignment of orders to the drones of a depot.

The rule of arXiv 2604.13441, section IV-A: the nearest customer that a free drone can reach at the
accepted loss is assigned to the drone with the shortest flight.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, ObstacleMap, location_to_ground_ned_m
from companion.core.base.location import Location
from companion.core.mission.flight_plan import depot_frame
from companion.core.vehicle.airframe import Airframe
from ground_station.core.deconfliction.depot_layers import DepotLayers
from ground_station.core.dispatch.dispatch_rules import off_pad_text
from ground_station.core.dispatch.flight_tables import depot_delivery_flight_table
from ground_station.core.feasibility.reach import (
    DayFeasibility,
    Feasible,
    Infeasible,
    SortieFeasibility,
    SortieGeometry,
    SortieNeed,
)
from ground_station.core.planning.day_problem import MAX_HEIGHT_AGL_M, obstacle_map
from ground_station.core.schema.day import Day, Drone, Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.order_window import late_text
from ground_station.core.schema.orders import (
    IN_FORCE,
    AssignmentRow,
    AssignmentState,
    Order,
    OrderRow,
    OrderState,
    Service,
    order_location,
)


@dataclass(frozen=True, slots=True)
class FreeDrone:
    """A drone available for an assignment. `charge_frac`: from its resting voltage; None: unknown.
    `position`: its position on the ground; None: the day's depot.
    """

    vehicle: str
    charge_frac: float | None
    position: Location | None = None


@dataclass(frozen=True, slots=True)
class DroneAssignment:
    """An order assigned to a drone, in a layer over the depot. The drone lands at `position`."""

    order: Order
    vehicle: str
    layer: int = 0
    launch_position: Location | None = None


LOADING_S = 60.0
"""[est] Time from an assignment to its launch: planning, upload, checks, confirmation."""

_DroneKind = tuple[str, float | None, float, float]
"""Airframe, temperature, health and charge of a drone; they determine feasibility."""


def obstruction(
    obstacles: ObstacleMap | None, ground_ned_m: Ned, cruise_height_m: float
) -> Infeasible | None:
    """Return the obstacle that is too close to a customer, as the companion checks it."""
    if obstacles is None:
        return None
    over = (*ground_ned_m[:2], -cruise_height_m)
    found = obstacles.first_blocking_obstacle(over, over)
    if found is None:
        return None
    reason = f"within {obstacles.clearance_m:g} m of {found.name}"
    return Infeasible(reason, "a destination outside its clearance")


def assigner_of_day(data: DayData, elevation: SiteElevation | None) -> "DepotAssigner":
    """Return the assigner of a day, with its obstacles."""
    return DepotAssigner(data.day, data.airframes, elevation, obstacle_map(data))


class DepotAssigner:
    """Assigns the orders of one day.

    The need of a delivery is cached for each airframe, order and layer, because it takes a thousand
    times as long to compute as the check against a pack. Feasibility with a full pack is cached for
    each kind of drone: a day may have a hundred drones of one kind.
    """

    def __init__(
        self,
        day: Day,
        airframes: Mapping[str, Airframe],
        elevation: SiteElevation | None = None,
        obstacles: ObstacleMap | None = None,
    ) -> None:
        self._day = day
        self._obstacles = obstacles
        self._elevation = elevation
        self._frame = depot_frame(day.depot.location)
        models = DayFeasibility(day, airframes, elevation)
        self._feasibility = {d.id: models.of_drone(d) for d in day.drones}
        self._feasibility_by_kind: dict[_DroneKind, SortieFeasibility] = {
            _kind_of(r.drone): r for r in self._feasibility.values()
        }
        self._order_ned: dict[Order, Ned] = {}
        self._sortie_needs: dict[tuple[str, Order, int], SortieNeed] = {}
        self.layers = DepotLayers(day.mission, MAX_HEIGHT_AGL_M)
        self._feasible_when_full: dict[tuple[_DroneKind, Order], bool] = {}

    def set_wind_and_clear_caches(self, wind: Forecast) -> None:
        """Compute all needs in this wind from now on."""
        self._feasibility = {
            name: feasibility.copy_for_wind(wind) for name, feasibility in self._feasibility.items()
        }
        self._feasibility_by_kind = {_kind_of(r.drone): r for r in self._feasibility.values()}
        self._sortie_needs.clear()
        self._feasible_when_full.clear()

    def assign_orders_to_free_drones(
        self,
        orders: list[OrderRow],
        assignments: list[AssignmentRow],
        free_drones: list[FreeDrone],
        priority_orders: Sequence[str] = (),
        now_us: int | None = None,
    ) -> list[DroneAssignment]:
        """Return new assignments for free drones, at most one order each; `priority_orders`: orders
        that take precedence over nearer ones, in this order.

        Then urgent orders precede, then the earliest end of a window that can be kept at `now_us`.
        An order is not assigned long before its window; None: windows are not considered.
        """
        waiting = [
            row.order
            for row in orders
            if row.state is OrderState.OPEN
            and row.order.service is not Service.TRUCK
            and not (now_us and self.is_before_window(row.order, now_us, LOADING_S))
        ]
        refused = {
            (row.order_id, row.vehicle)
            for row in assignments
            if row.state is AssignmentState.REFUSED
        }
        rank = {id_: number for number, id_ in enumerate(priority_orders)}
        last = len(rank)
        distance_m_by_order = {
            order.id: math.hypot(*self.order_ground_ned(order)[:2]) for order in waiting
        }

        def precedence(o: Order) -> tuple[object, ...]:
            end_us = self._end_of_window_if_kept(o, now_us)
            return rank.get(o.id, last), not o.is_urgent, end_us, distance_m_by_order[o.id], o.id

        waiting.sort(key=precedence)
        return self._assign_orders_in_given_order(
            waiting, refused, list(free_drones), _occupied_layers(assignments)
        )

    def drop_us(self, order: Order, now_us: int, loading_s: float = 0.0) -> int | None:
        """Return the earliest drop of an order that is launched in `loading_s`; None: no drone can
        deliver it.
        """
        needs = (
            self._cached_depot_sortie_need(order, feasibility)
            for feasibility in self._feasibility_by_kind.values()
            if self._is_feasible_when_full(order, feasibility)
        )
        drop_s = min((need.drop_s for need in needs), default=None)
        return None if drop_s is None else now_us + round(1e6 * (loading_s + drop_s))

    def is_before_window(self, order: Order, now_us: int, loading_s: float = 0.0) -> bool:
        """Return whether an order that is launched in `loading_s` would be dropped too early."""
        if order.earliest_us is None:
            return False
        drop_us = self.drop_us(order, now_us, loading_s)
        return drop_us is not None and drop_us < order.earliest_us

    def late_text(self, order: Order, now_us: int, *, is_loaded: bool = False) -> str | None:
        """Return how late an order on the ground would be with a launch as soon as possible."""
        loading_s = 0.0 if is_loaded else LOADING_S
        if order.latest_us is None or (at_us := self.drop_us(order, now_us, loading_s)) is None:
            return None
        return late_text(
            order.window, at_us, f"if {'launched' if is_loaded else 'a drone is loaded'} now"
        )

    def _end_of_window_if_kept(self, order: Order, now_us: int | None) -> float:
        if now_us is None or order.latest_us is None or self.late_text(order, now_us):
            return math.inf
        return order.latest_us

    def are_all_depot_layers_occupied(self, assignments: list[AssignmentRow]) -> bool:
        """Return True if every layer is occupied over ground at the depot's height."""
        return (
            self.layers.lowest_free_layer_below_max_height(_occupied_layers(assignments), 0.0)
            is None
        )

    def _assign_orders_in_given_order(
        self,
        ranked_orders: list[Order],
        refused_order_vehicle_pairs: set[tuple[str, str]],
        free_drones: list[FreeDrone],
        occupied_layers: set[int],
    ) -> list[DroneAssignment]:
        new_assignments: list[DroneAssignment] = []
        for order in ranked_orders:
            if not free_drones:
                break
            layer = self.layers.lowest_free_layer_below_max_height(
                occupied_layers, -self.order_ground_ned(order)[2]
            )
            if layer is None:
                continue
            candidates: list[tuple[float, str, FreeDrone]] = []
            for drone in free_drones:
                time_s = self._flight_time_if_feasible_s(order, drone, layer)
                if (
                    time_s is not None
                    and (order.id, drone.vehicle) not in refused_order_vehicle_pairs
                ):
                    candidates.append((time_s, drone.vehicle, drone))
            if candidates:
                _, vehicle, drone = min(candidates, key=lambda a: a[:2])
                free_drones.remove(drone)
                occupied_layers.add(layer)
                new_assignments.append(DroneAssignment(order, vehicle, layer, drone.position))
        return new_assignments

    def _flight_time_if_feasible_s(
        self, order: Order, drone: FreeDrone, layer: int
    ) -> float | None:
        """Return the flight time of this drone in a layer; None: not feasible with its charge."""
        feasibility = self._feasibility.get(drone.vehicle)
        if feasibility is None or not self._is_feasible_when_full(order, feasibility):
            return None
        need = self._cached_depot_sortie_need(order, feasibility, layer)
        return (
            need.time_s
            if feasibility.is_within_energy_budget(need, order.mass_kg, drone.charge_frac)
            else None
        )

    def _is_feasible_when_full(self, order: Order, feasibility: SortieFeasibility) -> bool:
        """Return True if a drone of this kind can deliver the order with a full pack."""
        key = (_kind_of(feasibility.drone), order)
        if key not in self._feasible_when_full:
            mass_kg = order.mass_kg
            is_feasible = (
                self._obstruction(order) is None
                and feasibility.can_lift(mass_kg)
                and feasibility.is_within_energy_budget(
                    self._cached_depot_sortie_need(order, feasibility), mass_kg, 1.0
                )
            )
            self._feasible_when_full[key] = is_feasible
        return self._feasible_when_full[key]

    def _obstruction(self, order: Order) -> Infeasible | None:
        height_m = self._day.mission.cruise_height_m
        return obstruction(self._obstacles, self.order_ground_ned(order), height_m)

    def _cached_depot_sortie_need(
        self, order: Order, feasibility: SortieFeasibility, layer: int = 0
    ) -> SortieNeed:
        """Return the need of a delivery from the depot and back for the airframe of this drone."""
        key = (feasibility.drone.airframe, order, layer)
        if key not in self._sortie_needs:
            depot, customer_ned = (0.0, 0.0, 0.0), self.order_ground_ned(order)
            up_m = self.layers.mission_in_layer(layer).cruise_height_m
            self._sortie_needs[key] = feasibility.sortie_need(
                SortieGeometry(order.mass_kg, depot, customer_ned, depot, up_m)
            )
        return self._sortie_needs[key]

    def order_ground_ned(self, order: Order) -> Ned:
        """Return the ground position of an order, NED about the depot."""
        if order not in self._order_ned:
            self._order_ned[order] = location_to_ground_ned_m(self._frame, order_location(order))
        return self._order_ned[order]

    def check_delivery(
        self, order: Order, vehicle: str, charge_frac: float | None = None
    ) -> Feasible | Infeasible:
        """Check whether a drone can deliver an order from the depot and return."""
        feasibility = self._feasibility.get(vehicle)
        if feasibility is None:
            return Infeasible("not in the day's fleet", "name it under [[drones]]")
        return self._check_delivery(order, feasibility, charge_frac)

    def _check_delivery(
        self, order: Order, feasibility: SortieFeasibility, charge_frac: float | None = None
    ) -> Feasible | Infeasible:
        if (obstruction := self._obstruction(order)) is not None:
            return obstruction
        need = (
            self._cached_depot_sortie_need(order, feasibility)
            if feasibility.can_lift(order.mass_kg)
            else None
        )
        ned = self.order_ground_ned(order)
        return feasibility.check_delivery(order.mass_kg, ned, charge_frac=charge_frac, need=need)

    def infeasibility_for_all_drones(self, order: Order) -> Infeasible | None:
        """Return the obstacle to delivery of an order by any drone of the depot; of several, the
        one that is easiest to remove. None: some drone can deliver it.
        """
        if order.service is Service.TRUCK:
            return None
        found = [
            self._check_delivery(order, feasibility)
            for feasibility in self._feasibility_by_kind.values()
        ]
        infeasible = [f for f in found if isinstance(f, Infeasible)]
        if len(infeasible) < len(found) or not infeasible:
            return None
        return max(infeasible, key=lambda found: found.is_energy_short)

    def flight_table(
        self, order: Order, vehicle: str, layer: int = 0, take_off_position: Location | None = None
    ) -> dict[str, Any]:
        """Return the `flight/1` table of an order for a drone, in a layer over the depot.

        The drone lands at `take_off_position`, its take-off position, so landing positions of a
        depot keep the distances of the parked drones. None: the day's depot.
        """
        drone = self._day.find_drone(vehicle)
        if drone is None:
            raise LeewayError(f"{vehicle}: not in the day's fleet")
        mission = self.layers.mission_in_layer(layer)
        depot = self._day.depot
        if take_off_position is not None:
            depot = msgspec.structs.replace(
                depot, lat_deg=take_off_position.lat_deg, lon_deg=take_off_position.lon_deg
            )
        day = msgspec.structs.replace(self._day, mission=mission, depot=depot)
        return depot_delivery_flight_table(day, drone, order, self._elevation)

    def position_if_at_depot(self, lat_deg: float | None, lon_deg: float | None) -> Location | None:
        """Return the ground position of a drone at the depot; None: it is not at the depot."""
        depot = self._day.depot.location
        if off_pad_text(lat_deg, lon_deg, depot):
            return None
        return Location(lat_deg=lat_deg, lon_deg=lon_deg, alt_amsl_m=depot.alt_amsl_m)


def _occupied_layers(assignments: list[AssignmentRow]) -> set[int]:
    """Return the occupied layers. An assignment without a layer was written by an older version and
    flies at the mission's own heights.
    """
    return {row.layer or 0 for row in assignments if row.state in IN_FORCE}


def _kind_of(drone: Drone) -> _DroneKind:
    return drone.airframe, drone.temperature_c, drone.battery_health_frac, drone.charge_frac
