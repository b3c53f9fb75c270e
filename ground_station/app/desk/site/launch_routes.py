"""Routes of assigned flights: start, delivery, landing and height."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from companion.core.base.geo import Ned, location_to_ground_ned_m
from companion.core.base.location import Location
from companion.core.mission.flight_plan import depot_frame
from companion.fleet.messages import State
from ground_station.adapters.store.order_store import Store
from ground_station.core.deconfliction.depot_layers import DepotLayers
from ground_station.core.dispatch.wind_holds import PlannedLaunch, flight_duration_upper_bound_s
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.fleet.uploaded_route import route_from_state
from ground_station.core.planning.day_problem import MAX_HEIGHT_AGL_M
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import AssignmentRow, Order, order_location
from ground_station.core.schema.sortie_rows import SortieRow

UNKNOWN_AIRSPEED_MPS = 10.0
"""Cruise airspeed of a drone that the day does not name."""

PositionsNe = tuple[tuple[float, float], ...]
"""Positions (north, east) in metres from the depot."""


@dataclass(slots=True)
class LaunchRoutes:
    """Assignments in force with their orders and sorties. `to_ne_m` converts latitude and
    longitude in degrees; `find_sorties` returns the sorties of a day with a truck.
    """

    store: Store
    data: DayData
    to_ne_m: Callable[[float, float], tuple[float, float]]
    find_sorties: Callable[[], Sequence[SortieRow]]
    orders: dict[str, Order] = field(default_factory=dict)
    sorties: dict[str, SortieRow] = field(default_factory=dict)
    _layers: DepotLayers = field(init=False)
    _read_ids: set[str] = field(default_factory=set[str])

    def __post_init__(self) -> None:
        self._layers = DepotLayers(self.data.day.mission, MAX_HEIGHT_AGL_M)

    def refresh_assignments_in_force(self) -> list[AssignmentRow]:
        """Read the drones' assignments in force, with their orders and sorties."""
        rows = [r for r in self.store.assignments(in_force=True) if r.vehicle != TRUCK]
        ids = {row.id for row in rows}
        if ids != self._read_ids:  # a person may have changed an order that was withdrawn
            found = self.store.orders_by_id({row.order_id for row in rows})
            self.orders = {one.order.id: one.order for one in found}
            self._read_ids = ids
        self.sorties = {sortie.id: sortie for sortie in self.find_sorties()} if rows else {}
        return rows

    def planned_launch_of(self, row: AssignmentRow, status: FleetStatus) -> PlannedLaunch:
        """Return the flight of an assignment, from its drone's current position."""
        position = self.position_ne_m(row.vehicle, status) or (0.0, 0.0)
        customer, home = self.customer_ned_m(row), self.home_ned_m(row)
        stops = [home] if customer is None else [customer, home]
        positions: PositionsNe = (position, *((north, east) for north, east, _ in stops))
        drone = self.data.day.find_drone(row.vehicle)
        airframe = None if drone is None else self.data.airframes.get(drone.airframe)
        cruise = UNKNOWN_AIRSPEED_MPS if airframe is None else airframe.speeds.cruise_airspeed_mps
        return PlannedLaunch(
            row.vehicle, positions, flight_duration_upper_bound_s(positions, cruise)
        )

    def reported_route_ne_m(self, row: AssignmentRow, status: FleetStatus) -> PositionsNe:
        """Return the route of the uploaded mission as reported by its vehicle; empty: unknown."""
        state = status.status_of(row.vehicle).state
        route = None if state is None or state.assignment != row.id else route_from_state(state)
        if route is None:
            return ()
        return tuple(self.to_ne_m(*location) for location in (*route.outbound, *route.homebound))

    def max_height_above_depot_m(self, row: AssignmentRow) -> float:
        """Return the maximum height above the depot; unlimited where routes follow the terrain."""
        if self.data.elevation is not None:
            return math.inf
        sortie = self.sorties.get(row.id)
        if sortie is None:
            return self._layers.level_flight_height_range_m(row.layer or 0)[1]
        plan, pad = sortie.sortie, sortie.pads[sortie.sortie.launch]
        return max(plan.outbound_height_m, plan.return_height_m) - self._location_ned_m(pad)[2]

    def position_ne_m(self, vehicle: str, status: FleetStatus) -> tuple[float, float] | None:
        """Return the position of a vehicle; None: unknown."""
        state = status.status_of(vehicle).state
        position = None if state is None else self.position_ned_m(state)
        return None if position is None else position[:2]

    def position_ned_m(self, state: State) -> Ned | None:
        """Return the position of a vehicle relative to the depot; None: unknown."""
        if state.lat_deg is None or state.lon_deg is None:
            return None
        north, east = self.to_ne_m(state.lat_deg, state.lon_deg)
        return north, east, -(state.height_rel_m or 0.0)

    def customer_ned_m(self, row: AssignmentRow) -> Ned | None:
        """Return the delivery position of an assignment's order; None: the order is unknown."""
        order = self.orders.get(row.order_id)
        return None if order is None else self._location_ned_m(order_location(order))

    def home_ned_m(self, row: AssignmentRow) -> Ned:
        """Return the landing position of a flight: its promised pad, or the depot."""
        sortie = self.sorties.get(row.id)
        if sortie is None or sortie.promised_stop not in sortie.pads:
            return (0.0, 0.0, 0.0)
        return self._location_ned_m(sortie.pads[sortie.promised_stop])

    def _location_ned_m(self, location: Location) -> Ned:
        return location_to_ground_ned_m(depot_frame(self.data.day.depot.location), location)
