"""`ground-station benchmark day-plan`: how long a day's plan takes, on a day that is drawn.

Customers evenly over a disc about the depot, roads as the crow flies times a detour, drones of the
shipped airframe with the energy model that they fly with, under a stated wind.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.route_energy import RouteEnergy
from ground_station.adapters.files import read_airframe
from ground_station.app.timed_search import TimedPlan, plan_within
from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.problem import DroneKind, TruckAndDrones
from ground_station.core.truck_drones.schedule import Schedule, schedule_of
from ground_station.core.truck_drones.search import SearchParams
from ground_station.core.truck_drones.tables import tables_of
from ground_station.core.truck_drones.tour import truck_alone
from ground_station.core.wind_sorties import WindSortieParams, WindSorties

DETOUR = 1.3
TRUCK_MPS = 9.0
DELIVER_S, LAUNCH_S, RECOVER_S, DRONE_SERVICE_S = 90.0, 60.0, 30.0, 30.0
PARCEL_KG = (0.1, 1.6)
RADIUS_M_PER_SQRT_CUSTOMER = 350.0
"""As dense a town whatever the number of customers: 200 of them on a disc of 5 km radius."""


@dataclass(frozen=True, slots=True)
class DayParams:
    """A drawn day."""

    customers: int
    drones: int
    wind_mps: float
    seed: int
    max_loss: float = 0.02
    airframe: str = "m100"


@dataclass(frozen=True, slots=True)
class DayResult:
    """Makespans, s, and processor seconds."""

    truck_alone_s: float
    dynamic_s: float
    dynamic_seconds: float
    timed: TimedPlan
    schedule: Schedule
    ne_m: np.ndarray


def drawn_day(params: DayParams) -> tuple[TruckAndDrones, np.ndarray]:
    """The problem and the nodes' places, metres north and east."""
    rng = np.random.default_rng(params.seed)
    count = params.customers
    radius_m = RADIUS_M_PER_SQRT_CUSTOMER * np.sqrt(count) * np.sqrt(rng.random(count))
    angle = rng.random(count) * 2.0 * np.pi
    ne_m = np.zeros((count + 2, 2))
    ne_m[1:-1] = radius_m[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    parcel_kg = np.zeros(count + 2)
    parcel_kg[1:-1] = rng.uniform(*PARCEL_KG, count)
    airframe = read_airframe(params.airframe)
    energy = RouteEnergy(airframe)
    draw_w = energy.hover_power_w(0.0)
    usable_wh = airframe.battery.usable_wh(draw_w, 15.0, 1.0)
    model = WindSorties(
        ne_m,
        np.minimum(parcel_kg, airframe.mass.max_payload_kg),
        [(energy, usable_wh, airframe.battery.usable_std_frac * usable_wh)],
        WindSortieParams(
            wind_to_ne_mps=np.array([0.0, params.wind_mps]),
            wind_cov_ne_m2ps2=1.5**2 * np.eye(2),
            max_loss=params.max_loss,
            reserve_frac=0.1,
            cruise_height_m=60.0,
            service_s=DRONE_SERVICE_S,
        ),
    )
    is_customer = np.ones(count + 2, dtype=np.bool_)
    is_customer[[0, -1]] = False
    can_fly = is_customer & (parcel_kg <= airframe.mass.max_payload_kg)
    road_m = DETOUR * np.hypot(*np.moveaxis(ne_m[None, :] - ne_m[:, None], 2, 0))
    problem = TruckAndDrones(
        travel_s=road_m / TRUCK_MPS,
        deliver_s=np.where(is_customer, DELIVER_S, 0.0),
        kinds=(DroneKind(params.drones, LAUNCH_S, RECOVER_S, can_fly),),
        legs=(model.legs(0),),
        truck_can_serve=is_customer,
    )
    return problem, ne_m


def bench_day(params: DayParams, seconds: float, tell: Callable[[float, float], None]) -> DayResult:
    """Plan the day by each policy."""
    warm, _ = drawn_day(DayParams(5, 1, params.wind_mps, params.seed))
    plan_within(warm, np.random.default_rng(0), SearchParams(), 0.05)
    problem, ne_m = drawn_day(params)
    alone = truck_alone(problem, tables_of(problem))
    rng = np.random.default_rng(params.seed)
    begin_s = time.process_time()
    dynamic = DynamicAssignment().plan(problem, rng)
    dynamic_seconds = time.process_time() - begin_s
    timed = plan_within(problem, rng, SearchParams(), seconds, tell)
    return DayResult(
        schedule_of(problem, alone).makespan_s,
        schedule_of(problem, dynamic).makespan_s,
        dynamic_seconds,
        timed,
        schedule_of(problem, timed.plan),
        ne_m,
    )
