"""A day as a truck-and-drones problem: places, road times, kinds of drones, who may bring what.

Node 0 is where the truck is (the depot, or the last stop that it has promised), then come the
orders, then the depot where the day ends.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, ShortInts
from companion.core.base.geo import LocalFrame, Ned, ObstacleMap, place_ned
from companion.core.mission.flight_plan import CLEARANCE_M, CLEARANCE_UP_M, frame_at
from ground_station.core.deconfliction.pads import PAD_APART_M, RING_PADS
from ground_station.core.deconfliction.separation import APART_M, LAYER_GAP_M, SLACK_S
from ground_station.core.feasibility.hills import hills_of
from ground_station.core.feasibility.obstacle_routes import ObstacleRoutes
from ground_station.core.feasibility.reach import Reach, day_energy
from ground_station.core.feasibility.sortie_model import WindSorties
from ground_station.core.schema.day import Drone
from ground_station.core.schema.day_data import DEPOT, DayData
from ground_station.core.schema.orders import Order, Service, place_of
from ground_station.core.truck_drones.problem import Air, DroneKind, Legs, TruckAndDrones

LEAD_S = 30.0
"""A drone lands at least this long after the planned arrival of the truck."""
TOP_M = 120.0
"""Greatest height above ground: EU 2019/947, UAS.OPEN.010; 14 CFR 107.51 (400 ft)."""
LEAST_ROOM_M = 10.0
"""Least height of a layer above pads and customers."""
PRICED_LAYER = 2
"""Sorties are priced in the third layer until each has its own."""


@dataclass(frozen=True, slots=True)
class DroneClass:
    """Drones that are alike: same airframe and pack, available from the same time."""

    ids: tuple[str, ...]
    reach: Reach
    from_s: float


@dataclass(frozen=True, slots=True)
class DayProblem:
    """The day's places (NED about the depot) and the problem over them."""

    frame: LocalFrame
    obstacles: ObstacleMap
    orders: tuple[Order, ...]
    ned_m: Floats
    classes: tuple[DroneClass, ...]
    ways: ObstacleRoutes
    problem: TruckAndDrones
    cruise_height_m: float

    def ned(self, node: int) -> Ned:
        """The ground point of a node."""
        north, east, down = self.ned_m[node].tolist()
        return north, east, down


def obstacle_map(data: DayData) -> ObstacleMap:
    """The day's obstacles, with the companion's own clearances. Geo-zones count from the ground up:
    a sortie is planned before its layer is known.
    """
    return ObstacleMap(data.obstacles(frame_at(data.day.depot.place)), CLEARANCE_M, CLEARANCE_UP_M)


def drone_classes(data: DayData, free_from_s: dict[str, float]) -> tuple[DroneClass, ...]:
    """The available drones, grouped by what makes them alike."""
    day = data.day
    energies = {name: day_energy(day, airframe) for name, airframe in data.airframes.items()}
    hills = hills_of(day, data.elevation)
    alike: dict[tuple[Drone, float], list[str]] = {}
    for drone in day.drones:
        if drone.id in free_from_s:
            key = (_nameless(drone), free_from_s[drone.id])
            alike.setdefault(key, []).append(drone.id)
    return tuple(
        DroneClass(
            tuple(ids),
            Reach(
                drone,
                data.airframes[drone.airframe],
                day.mission,
                day.forecast,
                energies[drone.airframe],
                hills,
            ),
            from_s,
        )
        for (drone, from_s), ids in alike.items()
    )


def _nameless(drone: Drone) -> Drone:
    return Drone(
        id="any",
        airframe=drone.airframe,
        charge_frac=drone.charge_frac,
        temperature_c=drone.temperature_c,
        battery_health_frac=drone.battery_health_frac,
    )


def build_day_problem(
    data: DayData,
    orders: list[Order],
    start_ned_m: Ned,
    start_name: str,
    free_from_s: dict[str, float],
    hold_s: float,
    pads_m: float,
) -> DayProblem:
    """The problem of bringing these orders. `start_name`: the start's name in the road matrix.

    Times count from the truck's arrival at the start.
    """
    frame = frame_at(data.day.depot.place)
    places = [
        start_ned_m,
        *(place_ned(frame, place_of(order)) for order in orders),
        (0.0, 0.0, 0.0),
    ]
    ned_m = np.array(places)
    obstacles = obstacle_map(data)
    classes = drone_classes(data, free_from_s)
    mission = data.day.mission
    height_m = np.full(len(places), layer_height_m(mission.cruise_height_m, PRICED_LAYER))
    ways = ObstacleRoutes(obstacles, ned_m[:, :2], mission.cruise_height_m)
    mass_kg = np.array([0.0, *(order.mass_kg for order in orders), 0.0])
    most_kg = max((c.reach.airframe.mass.max_payload_kg for c in classes), default=0.0)
    sorties = WindSorties(
        ned_m, np.minimum(mass_kg, most_kg), height_m, [c.reach for c in classes], ways, pads_m
    )
    truck = data.day.truck
    by_truck = _flags(orders, [order.service is not Service.DRONE for order in orders])
    kinds = tuple(
        DroneKind(len(c.ids), truck.launch_s, truck.recover_s, _can_fly(orders, c), c.from_s)
        for c in classes
    )
    rises = [sorties.rise(number, LAYER_GAP_M) for number in range(len(classes))]
    problem = TruckAndDrones(
        travel_s=_travel_s(data, orders, ned_m, start_name),
        deliver_s=np.where(_flags(orders, [True] * len(orders)), truck.deliver_s, 0.0),
        kinds=kinds or (_nobody(len(places)),),
        legs=tuple(
            _ready_first(sorties.legs(number), truck.ready_s) for number in range(len(classes))
        )
        or (_nowhere(len(places)),),
        truck_can_serve=by_truck,
        pads=True,
        lead_s=LEAD_S,
        stay_s=truck.ready_s,
        hold_s=hold_s,
        air=Air(
            ned_m[:, :2],
            *layers_over(-ned_m[:, 2], mission.cruise_height_m),
            RING_PADS,
            pads_m,
            PAD_APART_M,
            truck.ready_s,
            APART_M,
            SLACK_S,
            PRICED_LAYER,
            tuple(one[0] for one in rises),
            tuple(one[1] for one in rises),
            ways.bends(),
            ways.corners_ne_m,
        ),
    )
    cruise_m = mission.cruise_height_m
    return DayProblem(frame, obstacles, tuple(orders), ned_m, classes, ways, problem, cruise_m)


def _nobody(nodes: int) -> DroneKind:
    """The kind of a fleet without drones."""
    return DroneKind(0, 1.0, 1.0, np.zeros(nodes, dtype=np.bool_))


def _nowhere(nodes: int) -> Legs:
    never = np.full((nodes, nodes), np.inf)
    return Legs(never, never, never, never, 0.0)


def _ready_first(legs: Legs, ready_s: float) -> Legs:
    """The same, with the time on the pad before each flight."""
    return replace(legs, out_s=legs.out_s + ready_s)


def without(nodes: DayProblem, lost: set[str]) -> DayProblem:
    """The same without these orders."""
    keep = [
        0,
        *(i for i, o in enumerate(nodes.orders, 1) if o.id not in lost),
        len(nodes.ned_m) - 1,
    ]
    at = np.ix_(keep, keep)
    problem = nodes.problem
    legs = tuple(
        replace(
            of,
            out_s=of.out_s[at],
            back_s=of.back_s[at],
            out_hover_s=of.out_hover_s[at],
            back_hover_s=of.back_hover_s[at],
        )
        for of in problem.legs
    )
    smaller = replace(
        problem,
        travel_s=problem.travel_s[at],
        deliver_s=problem.deliver_s[keep],
        kinds=tuple(replace(kind, can_serve=kind.can_serve[keep]) for kind in problem.kinds),
        legs=legs,
        truck_can_serve=problem.truck_can_serve[keep],
        air=None if problem.air is None else _air_of(problem.air, keep),
    )
    orders = tuple(order for order in nodes.orders if order.id not in lost)
    ned_m = nodes.ned_m[keep]
    ways = ObstacleRoutes(nodes.obstacles, ned_m[:, :2], nodes.ways.height_m)
    return replace(nodes, orders=orders, ned_m=ned_m, ways=ways, problem=smaller)


def _air_of(air: Air, keep: list[int]) -> Air:
    return replace(
        air,
        ne_m=air.ne_m[keep],
        lowest=air.lowest[keep],
        layers=air.layers[keep],
        bends=air.bends[np.ix_(keep, keep)] if len(air.bends) else air.bends,
    )


def layer_height_m(cruise_height_m: float, number: int) -> float:
    """The height of a layer above the depot."""
    return cruise_height_m + LAYER_GAP_M * number


def layers_over(ground_up_m: Floats, cruise_height_m: float) -> tuple[ShortInts, ShortInts]:
    """By place: the lowest layer with room above the ground, and the first that is too high."""
    lowest = np.ceil((ground_up_m + LEAST_ROOM_M - cruise_height_m) / LAYER_GAP_M - 1e-9)
    layers = np.floor((TOP_M + ground_up_m - cruise_height_m) / LAYER_GAP_M) + 1
    return np.maximum(lowest, 0).astype(np.int32), np.maximum(layers, 0).astype(np.int32)


def _flags(orders: list[Order], each: list[bool]) -> NDArray[np.bool_]:
    assert len(each) == len(orders)
    return np.array([False, *each, False], dtype=np.bool_)


def _can_fly(orders: list[Order], drones: DroneClass) -> NDArray[np.bool_]:
    most_kg = drones.reach.airframe.mass.max_payload_kg
    can = [o.service is not Service.TRUCK and o.mass_kg <= most_kg for o in orders]
    return _flags(orders, can)


def _travel_s(data: DayData, orders: list[Order], ned_m: Floats, start_name: str) -> Floats:
    """The truck's times, by the road matrix or by its speed; 0 from a place to itself."""
    names = [start_name, *(order.id for order in orders), DEPOT]
    if data.roads_s is not None:
        roads_s = data.roads_s
        table = [[0.0 if a == b else roads_s[a, b] for b in names] for a in names]
        return np.array(table)
    away = ned_m[None, :, :2] - ned_m[:, None, :2]
    truck = data.day.truck
    return truck.detour_factor * np.hypot(away[..., 0], away[..., 1]) / truck.speed_mps
