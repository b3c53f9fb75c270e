"""`ground-station benchmark day-plan`: how long the plan of a whole day takes, on a random day.

Customers lie evenly over a disc about the depot. Roads are straight lines times a detour. Drones
are of the bundled airframe, with the energy model that they fly with, in a stated wind. The time is
that of `ground-station plan` from the day's data to the plan, without compiling.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from companion.core.base.geo import moved_deg
from ground_station.adapters.files.params import read_airframe
from ground_station.core.planning.day_planner import (
    PlanParams,
    day_problem,
    plan_day,
    road_searched_plans,
    tried_plans,
)
from ground_station.core.planning.forward_pass import TriedPlan
from ground_station.core.planning.plan_bound import PlanBound, plan_bound
from ground_station.core.schema.day import Day, Depot, Drone, Forecast, Truck
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import first_state
from ground_station.core.schema.orders import Order
from ground_station.core.truck_drones.first_plan import first_plan
from ground_station.core.truck_drones.schedule import schedule_of
from ground_station.core.truck_drones.tables import tables_of, work_for
from ground_station.core.truck_drones.tour import truck_alone

AIRFRAME = "m100"
PARCEL_KG = (0.1, 1.6)
RADIUS_M_PER_SQRT_CUSTOMER = 350.0
"""The same density for any number of customers: 200 of them on a disc of 5 km radius."""


@dataclass(frozen=True, slots=True)
class DayParams:
    """A random day."""

    customers: int
    drones: int
    wind_mps: float
    seed: int


@dataclass(frozen=True, slots=True)
class DayResult:
    """Makespans, s, and processor seconds."""

    truck_alone_s: float
    first_s: float
    first_seconds: float
    dynamic: DayPlan
    dynamic_seconds: float
    search: DayPlan
    search_seconds: float


def drawn_day(params: DayParams) -> DayData:
    """The random day's data."""
    rng = np.random.default_rng(params.seed)
    count = params.customers
    radius_m = RADIUS_M_PER_SQRT_CUSTOMER * np.sqrt(count) * np.sqrt(rng.random(count))
    angle = rng.random(count) * 2.0 * np.pi
    parcel_kg = rng.uniform(*PARCEL_KG, count)
    lats_deg, lons_deg = moved_deg(0.0, 0.0, radius_m * np.cos(angle), radius_m * np.sin(angle))
    orders = [
        Order(
            id=f"o{number}",
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_amsl_m=0.0,
            mass_kg=float(kg),
        )
        for number, (lat_deg, lon_deg, kg) in enumerate(
            zip(lats_deg.tolist(), lons_deg.tolist(), parcel_kg, strict=True), 1
        )
    ]
    day = Day(
        format="day/1",
        name=f"drawn {params.seed}",
        depot=Depot(lat_deg=0.0, lon_deg=0.0, alt_amsl_m=0.0),
        drones=[Drone(id=f"d{n}", airframe=AIRFRAME) for n in range(1, params.drones + 1)],
        truck=Truck(capacity_kg=10.0 * count),
        forecast=Forecast(speed_mps=params.wind_mps, from_deg=270.0, std_mps=1.5),
    )
    return DayData(day, orders, None, {AIRFRAME: read_airframe(AIRFRAME)}, None)


def bench_day(
    params: DayParams, trials: int | None, tell: Callable[[float, float], None]
) -> DayResult:
    """Plan the day by each policy."""
    warm = drawn_day(DayParams(5, 1, params.wind_mps, params.seed))
    for policy in ("search", "dynamic"):
        plan_day(warm, first_state(warm), PlanParams(policy, trials=100))
    data = drawn_day(params)
    begin_s = time.process_time()
    problem = day_problem(data, first_state(data))
    tables = tables_of(problem)
    first = schedule_of(problem, first_plan(problem, tables, work_for(tables)))
    first_seconds = time.process_time() - begin_s
    alone = schedule_of(problem, truck_alone(problem, tables))
    plans: list[tuple[DayPlan, float]] = []
    for policy in ("dynamic", "search"):
        begin_s = time.process_time()
        plan = plan_day(data, first_state(data), PlanParams(policy, trials, params.seed), tell)
        plans.append((plan, time.process_time() - begin_s))
    (dynamic, dynamic_seconds), (search, search_seconds) = plans
    return DayResult(
        alone.makespan_s,
        first.makespan_s,
        first_seconds,
        dynamic,
        dynamic_seconds,
        search,
        search_seconds,
    )


@dataclass(frozen=True, slots=True)
class DayPromises:
    """Each plan that the search found with what became of it, the one that is kept, what a long
    search on driven plans found; and what no plan can beat.
    """

    day: str
    seed: int
    plans: list[TriedPlan]
    bound: PlanBound


def bench_promises(
    data: DayData, params: PlanParams, drives: int, tell: Callable[[float, float], None]
) -> DayPromises:
    """Plan the day; `drives`: of the long search, from each plan that was found; 0: none."""
    start = first_state(data)
    plans = [*tried_plans(data, start, params, tell), _kept(plan_day(data, start, params))]
    if drives:
        plans += road_searched_plans(data, start, params, drives, tell)
    return DayPromises(data.day.name, params.seed, plans, plan_bound(day_problem(data, start)))


def _kept(plan: DayPlan) -> TriedPlan:
    """The plan that is kept, after its polish."""
    stops = len({sortie.launch for sortie in plan.sorties})
    elsewhere = sum(sortie.launch != sortie.home for sortie in plan.sorties)
    lost = len(plan.unplanned)
    return TriedPlan("kept, polished", None, plan.makespan_s, stops, elsewhere, None, lost)


def print_promises(console: Console, found: DayPromises) -> None:
    """Promised and driven makespans, and the bound."""
    title = f"{found.day}, seed {found.seed}: makespan, s"
    table = Table(title=title, title_justify="left")
    for name in ("plan", "promised", "driven", "launch stops", "elsewhere", "moved"):
        table.add_column(name, justify="left" if name == "plan" else "right")
    for one in found.plans:
        promised = "" if one.promised_s is None else f"{one.promised_s:.0f}"
        lost = f", {one.lost} lost" if one.lost else ""
        moved = "" if one.moved is None else str(one.moved)
        counts = (str(one.launch_stops), str(one.elsewhere), moved)
        table.add_row(one.name, promised, f"{one.driven_s:.0f}{lost}", *counts)
    console.print(table)
    bound = found.bound
    console.print(
        f"no plan takes less than {bound.makespan_s:.0f} s: the driver's work"
        f" {bound.driver_work_s:.0f} s, the way past {bound.forced_stops} places only for the"
        f" truck {bound.way_s:.0f} s (the drones alone: {bound.fleet_s:.0f} s)",
        highlight=False,
    )


def print_day(console: Console, params: DayParams, found: DayResult) -> None:
    """Makespan and processor time of each policy."""
    table = Table(title=f"{params.customers} customers, {params.drones} drones")
    for name in ("plan", "makespan s", "over the truck alone %", "cpu s"):
        table.add_column(name, justify="left" if name == "plan" else "right")
    for name, makespan_s, seconds in (
        ("truck alone", found.truck_alone_s, None),
        ("first plan (no layers yet)", found.first_s, found.first_seconds),
        ("dynamic assignment (paper)", found.dynamic.makespan_s, found.dynamic_seconds),
        ("search (default)", found.search.makespan_s, found.search_seconds),
    ):
        over = 100.0 * (makespan_s / found.truck_alone_s - 1.0)
        spent = "-" if seconds is None else f"{seconds:.2f}"
        table.add_row(name, f"{makespan_s:.0f}", f"{over:+.1f}", spent)
    console.print(table)
    plan = found.search
    by_truck = sum(len(stop.serves) for stop in plan.stops)
    console.print(
        f"{by_truck} customers by truck, {len(plan.sorties)} by drone,"
        f" {len(plan.unplanned)} by nobody; {plan.trials} trials",
        highlight=False,
    )
