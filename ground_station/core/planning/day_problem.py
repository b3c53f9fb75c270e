"""A day as a truck-and-drones problem: positions, road times, drone kinds, permitted services.

Node 0 is the truck's position (the depot, or its last promised stop), followed by the orders and
the depot at the end of the day.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.base.geo import LocalFrame, Ned, ObstacleMap, location_to_ground_ned_m
from companion.core.mission.flight_plan import (
    AVOIDANCE_LEVELS,
    AVOIDANCE_STEP_M,
    CLEARANCE_M,
    VERTICAL_CLEARANCE_M,
    depot_frame,
)
from ground_station.core.deconfliction.pads import FIRST_RING_PADS, PAD_SPACING_M
from ground_station.core.deconfliction.separation import (
    HORIZONTAL_SEPARATION_M,
    LATE_MARGIN_S,
    LAYER_GAP_M,
)
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.feasibility.reach import (
    DayFeasibility,
    SortieFeasibility,
    SortieGeometry,
)
from ground_station.core.feasibility.sortie_model import WindSortieModel
from ground_station.core.schema.day import Drone, Truck
from ground_station.core.schema.day_data import DEPOT, DayData
from ground_station.core.schema.orders import Order, Service, order_location
from ground_station.core.truck_drones.problem import (
    LATE_PRICE,
    DroneKind,
    LayeredAirspace,
    LegTables,
    TimedOrders,
    TruckAndDrones,
)

LEAD_S = 30.0
"""Minimum time from the planned arrival of the truck to a landing."""
MAX_HEIGHT_AGL_M = 120.0
"""Greatest height above ground: EU 2019/947, UAS.OPEN.010; 14 CFR 107.51 (400 ft)."""
MIN_LAYER_CLEARANCE_M = 10.0
"""Least height of a layer above pads and customers."""
AVOIDANCE_M = max(AVOIDANCE_LEVELS) * AVOIDANCE_STEP_M
"""Most that a companion climbs to avoid a neighbour."""
PRICED_LAYER = 2
"""Sorties are priced in the third layer until a layer is assigned."""


ANY_TIME_S = (-math.inf, math.inf)
URGENT_WEIGHT = 10.0
"""[est] Weight of an urgent order's lateness."""


@dataclass(frozen=True, slots=True)
class DroneClass:
    """Identical drones: same airframe and pack, available from the same time."""

    ids: tuple[str, ...]
    feasibility: SortieFeasibility
    from_s: float


@dataclass(frozen=True, slots=True)
class DayProblem:
    """The day's positions (NED about the depot) and the problem over them."""

    frame: LocalFrame
    obstacles: ObstacleMap
    orders: tuple[Order, ...]
    ned_m: Floats
    classes: tuple[DroneClass, ...]
    routes: ObstacleRoutes
    problem: TruckAndDrones
    cruise_height_m: float
    windows_s: Mapping[str, tuple[float, float]]
    """Delivery windows by order, from the truck's arrival at the start."""

    def window_s(self, node: int) -> tuple[float, float]:
        """Return the delivery window of a node; infinite without one."""
        is_order = 0 < node <= len(self.orders)
        id_ = self.orders[node - 1].id if is_order else ""
        return self.windows_s.get(id_, ANY_TIME_S)

    def is_timed(self, customer: int) -> bool:
        """Return whether an order has a window or priority."""
        order = self.orders[customer - 1]
        return order.is_urgent or order.window != (None, None)

    def ground_ned_m(self, node: int) -> Ned:
        """Return the ground point of a node."""
        north, east, down = self.ned_m[node].tolist()
        return north, east, down

    def sortie_geometry(
        self,
        launch_customer_rendezvous: tuple[int, int, int],
        start: Ned,
        end: Ned,
        height_m: float,
    ) -> SortieGeometry:
        """Return the geometry of a delivery between pads at two nodes."""
        launch, customer, rendezvous = launch_customer_rendezvous
        return SortieGeometry(
            self.orders[customer - 1].mass_kg,
            start,
            self.ground_ned_m(customer),
            end,
            height_m,
            self.routes.waypoints_between(launch, customer),
            self.routes.waypoints_between(customer, rendezvous),
        )


def obstacle_map(data: DayData) -> ObstacleMap:
    """Return the day's obstacles with the companion's clearances.

    A geo-zone extends from the ground, unless the priced layer and the companion's avoidance stay
    below its floor: a sortie is planned before its layer is known.
    """
    mission, frame = data.day.mission, depot_frame(data.day.depot.location)
    level_m = max(mission.cruise_height_m, mission.return_height_m or 0.0)
    if data.elevation is not None:  # flights climb over hills
        _, hill_m = data.ground_bounds_m(frame) or (0.0, math.inf)
        level_m = max(level_m, hill_m + mission.clearance_m + VERTICAL_CLEARANCE_M)
    return ObstacleMap(
        data.obstacles_to_avoid(frame),
        CLEARANCE_M,
        VERTICAL_CLEARANCE_M,
        layer_height_m(level_m, PRICED_LAYER) + AVOIDANCE_M,
    )


def max_layer_height_m(obstacles: ObstacleMap) -> float:
    """Return the greatest height of a layer below all zones that the day's flights stay under."""
    return obstacles.lowest_floor_flown_under_m - VERTICAL_CLEARANCE_M - AVOIDANCE_M


def group_identical_drones(
    data: DayData, available_from_s_by_drone: dict[str, float]
) -> tuple[DroneClass, ...]:
    """Group the available drones into identical ones."""
    day = data.day
    feasibility = DayFeasibility(day, data.airframes, data.elevation)
    grouped: dict[tuple[Drone, float], list[str]] = {}
    for drone in day.drones:
        if drone.id in available_from_s_by_drone:
            key = (msgspec.structs.replace(drone, id="any"), available_from_s_by_drone[drone.id])
            grouped.setdefault(key, []).append(drone.id)
    return tuple(
        DroneClass(tuple(ids), feasibility.of_drone(drone), from_s)
        for (drone, from_s), ids in grouped.items()
    )


def build_day_problem(
    data: DayData,
    orders: list[Order],
    start_ned_m: Ned,
    start_name: str,
    available_from_s_by_drone: dict[str, float],
    first_stop_hold_s: float,
    pad_offset_m: float,
    t0_s: float = 0.0,
) -> DayProblem:
    """Build the problem for these orders. `start_name`: the start's name in the road matrix.

    Times are relative to the truck's arrival at the start, at `t0_s` of the day.
    """
    frame = depot_frame(data.day.depot.location)
    positions_ned_m = [
        start_ned_m,
        *(location_to_ground_ned_m(frame, order_location(order)) for order in orders),
        (0.0, 0.0, 0.0),
    ]
    ned_m = np.array(positions_ned_m)
    obstacles = obstacle_map(data)
    classes = group_identical_drones(data, available_from_s_by_drone)
    mission = data.day.mission
    height_m = np.full(len(positions_ned_m), layer_height_m(mission.cruise_height_m, PRICED_LAYER))
    routes = ObstacleRoutes(obstacles, ned_m[:, :2], mission.cruise_height_m)
    mass_kg = np.array([0.0, *(order.mass_kg for order in orders), 0.0])
    most_kg = max((c.feasibility.airframe.mass.max_payload_kg for c in classes), default=0.0)
    sorties = WindSortieModel(
        ned_m,
        np.minimum(mass_kg, most_kg),
        height_m,
        [c.feasibility for c in classes],
        routes,
        pad_offset_m,
    )
    truck = data.day.truck
    by_truck = _flags_by_node(orders, [order.service is not Service.DRONE for order in orders])
    kinds = tuple(
        DroneKind(
            len(c.ids), truck.launch_s, truck.recover_s, _can_fly_by_node(orders, c), c.from_s
        )
        for c in classes
    )
    rises = [
        sorties.extra_climb_time_and_hover_s(number, LAYER_GAP_M) for number in range(len(classes))
    ]
    windows_s = _windows_s(data, orders, t0_s)
    problem = TruckAndDrones(
        travel_s=_truck_travel_matrix_s(data, orders, ned_m, start_name),
        deliver_s=np.array([0.0, *(_deliver_s(order, truck) for order in orders), 0.0]),
        kinds=kinds  # a fleet without drones has one kind of none
        or (DroneKind(0, 1.0, 1.0, np.zeros(len(positions_ned_m), dtype=np.bool_)),),
        leg_tables=tuple(
            replace(legs, out_s=legs.out_s + truck.ready_s)
            for legs in map(sorties.leg_tables, range(len(classes)))
        )
        or (_infeasible_leg_tables(len(positions_ned_m)),),
        truck_can_serve=by_truck,
        pads=True,
        lead_s=LEAD_S,
        takeoff_wait_s=truck.ready_s,
        hold_s=first_stop_hold_s,
        air=LayeredAirspace(
            ned_m[:, :2],
            *layer_range_by_position(
                -ned_m[:, 2], mission.cruise_height_m, max_layer_height_m(obstacles)
            ),
            FIRST_RING_PADS,
            pad_offset_m,
            PAD_SPACING_M,
            truck.ready_s,
            HORIZONTAL_SEPARATION_M,
            LATE_MARGIN_S,
            PRICED_LAYER,
            tuple(one[0] for one in rises),
            tuple(one[1] for one in rises),
            routes.corner_indices_by_start_and_end(),
            routes.corners_ne_m,
        ),
        timed=_timed_orders(orders, windows_s),
    )
    cruise_m = mission.cruise_height_m
    return DayProblem(
        frame, obstacles, tuple(orders), ned_m, classes, routes, problem, cruise_m, windows_s
    )


def _windows_s(data: DayData, orders: list[Order], t0_s: float) -> dict[str, tuple[float, float]]:
    """Return the windows of the orders that have one; none if the time of the plan is unknown."""
    if data.start_us is None:
        return {}

    def at_s(epoch_us: int | None, unlimited_s: float) -> float:
        return unlimited_s if epoch_us is None else (epoch_us - start_us) / 1e6 - t0_s

    start_us = data.start_us
    return {
        order.id: (at_s(order.earliest_us, -math.inf), at_s(order.latest_us, math.inf))
        for order in orders
        if order.window != (None, None)
    }


def _timed_orders(
    orders: list[Order], windows_s: Mapping[str, tuple[float, float]]
) -> TimedOrders | None:
    """Return windows and prices by node; None if no order has a window or priority."""
    if not windows_s and not any(order.is_urgent for order in orders):
        return None
    windows = np.array([windows_s.get(order.id, ANY_TIME_S) for order in orders])
    urgent = np.array([order.is_urgent for order in orders])
    late_price = np.where(urgent, URGENT_WEIGHT, 1.0) * LATE_PRICE
    by_node = (windows[:, 0], windows[:, 1], late_price, np.where(urgent, 1.0, 0.0))
    ends = (ANY_TIME_S[0], ANY_TIME_S[1], 0.0, 0.0)
    return TimedOrders(
        *(np.array([end, *row, end]) for row, end in zip(by_node, ends, strict=True))
    )


def _infeasible_leg_tables(node_count: int) -> LegTables:
    infinite = np.full((node_count, node_count), np.inf)
    return LegTables(infinite, infinite, infinite, infinite, 0.0)


def without_orders(nodes: DayProblem, order_ids: set[str]) -> DayProblem:
    """Return a copy without these orders."""
    keep = [
        0,
        *(i for i, o in enumerate(nodes.orders, 1) if o.id not in order_ids),
        len(nodes.ned_m) - 1,
    ]
    at = np.ix_(keep, keep)
    problem = nodes.problem
    leg_tables = tuple(
        replace(
            of,
            out_s=of.out_s[at],
            back_s=of.back_s[at],
            out_hover_s=of.out_hover_s[at],
            back_hover_s=of.back_hover_s[at],
        )
        for of in problem.leg_tables
    )
    filtered = replace(
        problem,
        travel_s=problem.travel_s[at],
        deliver_s=problem.deliver_s[keep],
        kinds=tuple(replace(kind, can_serve=kind.can_serve[keep]) for kind in problem.kinds),
        leg_tables=leg_tables,
        truck_can_serve=problem.truck_can_serve[keep],
        air=None if problem.air is None else _select_air_nodes(problem.air, keep),
        timed=None if problem.timed is None else problem.timed.of_nodes(keep),
    )
    orders = tuple(order for order in nodes.orders if order.id not in order_ids)
    ned_m = nodes.ned_m[keep]
    routes = ObstacleRoutes(nodes.obstacles, ned_m[:, :2], nodes.routes.height_m)
    return replace(nodes, orders=orders, ned_m=ned_m, routes=routes, problem=filtered)


def _select_air_nodes(air: LayeredAirspace, node_indices: list[int]) -> LayeredAirspace:
    return replace(
        air,
        ne_m=air.ne_m[node_indices],
        lowest=air.lowest[node_indices],
        layers=air.layers[node_indices],
        bends=air.bends[np.ix_(node_indices, node_indices)] if len(air.bends) else air.bends,
    )


def layer_height_m(cruise_height_m: float, layer: int) -> float:
    """Return the height of a layer above the depot."""
    return cruise_height_m + LAYER_GAP_M * layer


def layer_range_by_position(
    ground_up_m: Floats, cruise_height_m: float, max_height_m: float
) -> tuple[Ints, Ints]:
    """Return by position: the lowest layer with ground clearance, and the first too high."""
    lowest = np.ceil((ground_up_m + MIN_LAYER_CLEARANCE_M - cruise_height_m) / LAYER_GAP_M - 1e-9)
    most_m = np.minimum(MAX_HEIGHT_AGL_M + ground_up_m, max_height_m)
    layers = np.floor((most_m - cruise_height_m) / LAYER_GAP_M) + 1
    return np.maximum(lowest, 0).astype(np.int64), np.maximum(layers, 0).astype(np.int64)


def _deliver_s(order: Order, truck: Truck) -> float:
    return truck.deliver_s if order.service_s is None else order.service_s


def _flags_by_node(orders: list[Order], flag_by_order: list[bool]) -> NDArray[np.bool_]:
    assert len(flag_by_order) == len(orders)
    return np.array([False, *flag_by_order, False], dtype=np.bool_)


def _can_fly_by_node(orders: list[Order], drone_class: DroneClass) -> NDArray[np.bool_]:
    most_kg = drone_class.feasibility.airframe.mass.max_payload_kg
    can = [o.service is not Service.TRUCK and o.mass_kg <= most_kg for o in orders]
    return _flags_by_node(orders, can)


def _truck_travel_matrix_s(
    data: DayData, orders: list[Order], ned_m: Floats, start_name: str
) -> Floats:
    """Return truck travel times by road matrix or speed; 0 from a node to itself."""
    names = [start_name, *(order.id for order in orders), DEPOT]
    if data.road_times_s is not None:
        roads_s = data.road_times_s
        table = [[0.0 if a == b else roads_s[a, b] for b in names] for a in names]
        return np.array(table)
    away = ned_m[None, :, :2] - ned_m[:, None, :2]
    truck = data.day.truck
    return truck.detour_factor * np.hypot(away[..., 0], away[..., 1]) / truck.speed_mps
