"""Days at size: divided among trucks, written, read back, planned and planned anew under way.

Orders lie evenly over a disc, as densely whatever their number; depots stand on a ring within. What
is held against the plans is a bound: no plan with so many trucks, divided or not, ends sooner.
"""

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from companion.adapters.files.params import read_airframe
from companion.core.base.errors import LeewayError
from companion.core.base.geo import moved_deg
from ground_station.adapters.files.compiled_code import keep_compiled_code
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.workers.side_by_side import Workers
from ground_station.app.planning.region_balance import BalanceRound, ShortPlans, balanced
from ground_station.app.planning.region_days import (
    PlanWork,
    RegionDay,
    RegionPlanned,
    divided,
    planned,
    write_region,
)
from ground_station.core.dispatch.replanning import broken_promise
from ground_station.core.schema.day import Day, Depot, Drone, Forecast, Truck
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.day_state import DayState, first_state
from ground_station.core.schema.orders import Order
from sim_bridge.adapters.wall_clock import cpu_s, wall_s
from sim_bridge.research.results.sheet import Sheet

Policy = Literal["search", "dynamic"]
AIRFRAME = "m100"
DRONES_EACH = 10
CENTRE_DEG = (55.47, 8.45)
RADIUS_M_PER_SQRT_ORDER = 110.0
"""As densely as in the bundled day `town`: 26 orders to the square kilometre."""

DEPOTS_AT = 0.5
"""Depots stand so far out, as a share of the radius; a single one in the middle."""

PARCEL_KG, HEAVY_KG, HEAVY_FRAC = (0.1, 0.8), (2.0, 10.0), 0.1
"""A tenth is for the door only."""
TRUCK_KG = 3000.0
CREW_S = {"deliver_s": 40.0, "launch_s": 12.0, "recover_s": 15.0, "ready_s": 60.0}
"""A driver and a mate, as in the bundled day `town`."""


@dataclass(frozen=True, slots=True)
class LargeDay:
    """What is drawn."""

    orders: int
    drones: int
    trucks: int
    depots: int
    seed: int


class LargeDayFigures(msgspec.Struct, frozen=True, kw_only=True):
    """What it came to. Seconds of CPU unless they are of the day (makespans, bounds)."""

    orders: int
    drones: int
    trucks: int
    depots: int
    seed: int
    policy: str
    trials: int
    divide_s: float
    balance_s: float
    """Of all short plans; 0: none were made."""
    read_s: float
    """Of all regions' files, written and read back."""
    work_uneven_frac: float
    """Most driver's work of a region over the mean, less 1."""
    plan_s: float
    plan_most_s: float
    """All regions, and the one that takes longest: what a core for each would take."""
    makespan_s: float
    makespan_mean_s: float
    bound_regions_s: float
    """The greatest of the regions' own bounds."""
    bound_all_s: float
    """For any plan with so many trucks: all drivers' least work, shared out evenly."""
    by_drone: int
    unplanned: int
    replan_s: float
    """The longest region anew from half way, by its own desk."""
    replan_makespan_s: float
    plan_wall_s: float


def drawn_days(large: LargeDay) -> list[DayData]:
    """A day for each depot; the first has all orders."""
    rng = np.random.default_rng(large.seed)
    radius_m = RADIUS_M_PER_SQRT_ORDER * math.sqrt(large.orders)
    away_m = radius_m * np.sqrt(rng.random(large.orders))
    angle = 2.0 * np.pi * rng.random(large.orders)
    light_kg, heavy_kg = (rng.uniform(*kg, large.orders) for kg in (PARCEL_KG, HEAVY_KG))
    kg = np.where(rng.random(large.orders) < HEAVY_FRAC, heavy_kg, light_kg)
    lats, lons = moved_deg(*CENTRE_DEG, away_m * np.cos(angle), away_m * np.sin(angle))
    orders = [
        Order(id=f"o{k}", lat_deg=lat, lon_deg=lon, alt_amsl_m=0.0, mass_kg=round(mass, 3))
        for k, (lat, lon, mass) in enumerate(
            zip(lats.tolist(), lons.tolist(), kg.tolist(), strict=True), 1
        )
    ]
    days: list[DayData] = []
    for number in range(large.depots):
        turn = 2.0 * math.pi * number / large.depots
        out_m = DEPOTS_AT * radius_m if large.depots > 1 else 0.0
        at = moved_deg(
            *CENTRE_DEG, np.array([out_m * math.cos(turn)]), np.array([out_m * math.sin(turn)])
        )
        lat_deg, lon_deg = (float(one[0]) for one in at)
        drones = range(number, large.drones, large.depots)
        day = Day(
            format="day/1",
            name=f"depot-{number + 1}",
            fleet=f"depot-{number + 1}",
            depot=Depot(lat_deg=lat_deg, lon_deg=lon_deg, alt_amsl_m=0.0),
            drones=[Drone(id=f"d{k + 1}", airframe=AIRFRAME) for k in drones],
            truck=Truck(capacity_kg=TRUCK_KG, **CREW_S),
            forecast=Forecast(speed_mps=5.0, from_deg=250.0, std_mps=2.0),
        )
        own = orders if number == 0 else []
        days.append(DayData(day, own, None, {AIRFRAME: read_airframe(AIRFRAME)}, None))
    return days


def sized(orders: int, seed: int, drones_each: int = DRONES_EACH) -> LargeDay:
    """A truck with its drones for each hundred orders, two to ten of them, from up to 3 depots."""
    trucks = min(max(2, orders // 100), 10)
    return LargeDay(orders, drones_each * trucks, trucks, min(3, trucks // 2), seed)


def trucks_of(large: LargeDay) -> list[int]:
    """So many at each depot, as evenly as can be."""
    return [len(range(k, large.trucks, large.depots)) for k in range(large.depots)]


def bench(
    large: LargeDay,
    policy: Policy,
    trials: int | None,
    workers: Workers,
    tell: Callable[[RegionPlanned], None],
    balance: bool = True,
) -> LargeDayFigures:
    """Divide, balance by short plans, write, read, plan, plan anew."""
    keep_compiled_code()  # before the planner's first import
    days = drawn_days(large)
    begun_s = cpu_s()
    regions = divided(days, trucks_of(large))
    divide_s = cpu_s() - begun_s
    rounds: list[BalanceRound] = []
    with tempfile.TemporaryDirectory(prefix="leeway-large-") as name:
        folder = Path(name)
        if balance:
            beside = [folder / "day.toml"] * large.trucks
            short = ShortPlans(trials, large.seed, workers, folder, beside)
            regions = balanced(days, trucks_of(large), regions, short, rounds.append)
        begun_s = cpu_s()
        paths = [write_region(folder, region, folder / "day.toml") for region in regions]
        read = [read_day(path) for path in paths]
        read_s = cpu_s() - begun_s
        begun_s = wall_s()
        work = [PlanWork(str(path), policy, trials, large.seed) for path in paths]
        done = planned(regions, work, workers, tell)
        plan_wall_s = wall_s() - begun_s
    spent = _Spent(divide_s, sum(one.cpu_s for one in rounds), read_s, plan_wall_s)
    return _figures(large, regions, read, done, (policy, trials), spent)


@dataclass(frozen=True, slots=True)
class _Spent:
    divide_s: float
    balance_s: float
    read_s: float
    plan_wall_s: float


def _figures(
    large: LargeDay,
    regions: Sequence[RegionDay],
    read: Sequence[DayData],
    done: Sequence[RegionPlanned],
    searched: tuple[Policy, int | None],
    spent: _Spent,
) -> LargeDayFigures:
    from ground_station.core.planning.day_planner import PlanParams, day_problem, plan_day
    from ground_station.core.planning.plan_bound import plan_bound

    plans = [one.plan for one in done if one.plan is not None]
    bounds = [plan_bound(day_problem(data, first_state(data))) for data in read]
    work_s = np.array([region.work_s for region in regions])
    longest = max(range(len(plans)), key=lambda k: plans[k].makespan_s)
    begun_s = cpu_s()
    start = half_way(read[longest], plans[longest])
    anew = plan_day(read[longest], start, PlanParams(*searched, large.seed))
    replan_s = cpu_s() - begun_s
    if broken := broken_promise(anew, start):
        raise LeewayError(f"{regions[longest].name}: the new plan breaks a promise: {broken}")
    return LargeDayFigures(
        orders=large.orders,
        drones=large.drones,
        trucks=large.trucks,
        depots=large.depots,
        seed=large.seed,
        policy=searched[0],
        trials=max(plan.trials for plan in plans),
        divide_s=spent.divide_s,
        balance_s=spent.balance_s,
        read_s=spent.read_s,
        work_uneven_frac=float(work_s.max() / work_s.mean() - 1.0),
        plan_s=sum(one.cpu_s for one in done),
        plan_most_s=max(one.cpu_s for one in done),
        makespan_s=max(plan.makespan_s for plan in plans),
        makespan_mean_s=float(np.mean([plan.makespan_s for plan in plans])),
        bound_regions_s=max(bound.makespan_s for bound in bounds),
        bound_all_s=sum(bound.driver_work_s for bound in bounds) / len(regions),
        by_drone=sum(len(plan.sorties) for plan in plans),
        unplanned=sum(len(plan.unplanned) for plan in plans),
        replan_s=replan_s,
        replan_makespan_s=anew.makespan_s,
        plan_wall_s=spent.plan_wall_s,
    )


def half_way(data: DayData, plan: DayPlan) -> DayState:
    """The day under way: the truck at the first stop after half of the plan, nothing late.

    What is in the air then, and the stops that it is promised, stay as they are.
    """
    at = next(k for k, stop in enumerate(plan.stops) if stop.arrive_s >= 0.5 * plan.makespan_s)
    here_s = plan.stops[at].arrive_s
    place = {stop.id: k for k, stop in enumerate(plan.stops)}
    gone = [sortie for sortie in plan.sorties if sortie.launch_s <= here_s]
    last = max([at, *(place[sortie.home] for sortie in gone)])
    kept = tuple(plan.stops[: last + 1])
    flying = tuple(sortie for sortie in gone if sortie.land_s > here_s)
    brought = {id_ for stop in kept for id_ in stop.serves} | {sortie.order for sortie in gone}
    brought |= {line.order for line in plan.unplanned}
    free_s = {drone.id: here_s for drone in data.day.drones}
    recover_s = data.day.truck.recover_s
    free_s |= {sortie.vehicle: sortie.land_s + recover_s for sortie in flying}
    left = tuple(order.id for order in data.orders if order.id not in brought)
    return DayState(kept, flying, left, free_s, plan.revision + 1)


def sheet(found: Sequence[LargeDayFigures]) -> Sheet:
    """A line for each day. The bounds: of the regions as they are divided, and of any division."""
    head = [
        "orders", "trucks", "drones", "depots", "divided, s", "short plans, s",
        "files written and read, s",
        "all plans, s", "longest plan, s", "planned anew, s", "policy, trials",
        "last truck back, min",
        "mean truck, min", "bound of the regions, min", "bound of all, min", "by drone", "nobody",
    ]  # fmt: skip
    rows: list[list[str]] = []
    for one in found:
        cells = (
            f"{one.orders:,}",
            str(one.trucks),
            str(one.drones),
            str(one.depots),
            f"{one.divide_s:.1f}",
            f"{one.balance_s:.0f}" if one.balance_s else "-",
            f"{one.read_s:.1f}",
            f"{one.plan_s:.0f}",
            f"{one.plan_most_s:.0f}",
            f"{one.replan_s:.0f}",
            one.policy if one.policy == "dynamic" else f"{one.policy}, {one.trials:,}",
            *(
                f"{seconds / 60.0:.0f}"
                for seconds in (
                    one.makespan_s,
                    one.makespan_mean_s,
                    one.bound_regions_s,
                    one.bound_all_s,
                )
            ),
            f"{one.by_drone:,}",
            str(one.unplanned),
        )
        rows.append(list(cells))
    return Sheet("Days at size", head, rows)
