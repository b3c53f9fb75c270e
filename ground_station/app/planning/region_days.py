"""Large days: several day files combined, divided into a day for each truck, each one planned.

Each day has its own orders, drones and fleet, so that each truck has its own desk; no drone flies
between two regions' trucks. Fleets that may meet in the air are neighbours.
"""

import csv
import io
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.geo import location_to_ground_ned_m
from companion.core.mission.flight_file import check_neighbour_fleets
from companion.core.mission.flight_plan import depot_frame
from ground_station.adapters.files.atomic_file import write_file_atomically
from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from ground_station.adapters.files.day_files import read_day, write_day_plan
from ground_station.adapters.workers.side_by_side import ItemLost, WorkerOptions, run_parallel
from ground_station.core.planning.regions import (
    RegionProblem,
    adjacent_area_indices_by_area,
    driver_work_by_order_s,
    truck_by_order_with_equal_work,
)
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.order_changes import order_cells
from ground_station.core.schema.orders import Order, Priority, Service, order_location

ORDER_COLUMNS = ("id", "lat_deg", "lon_deg", "alt_amsl_m", "mass_kg", "service", "note")
EXTRA_COLUMNS = ("customer", "phone", "address", "window", "priority", "service_s")
DEFAULTS = ("", Priority.NORMAL.value)
MAX_FLEET_NAME_LENGTH = 32
NEIGHBOUR_DISTANCE_M = 2000.0
"""Minimum distance of two regions' convex hulls of straight flights: detours around obstacles and
avoidance leave a hull by less than half of it.
"""


@dataclass(frozen=True, slots=True)
class RegionDay:
    """Day of one truck. `work_s`: driver's work by the measure that the division balances."""

    name: str
    data: DayData
    work_s: float


@dataclass(frozen=True, slots=True)
class RegionResult:
    """Plan of a region and its CPU time in seconds; `plan` None: `error_text` states the reason."""

    region: RegionDay
    plan: DayPlan | None
    cpu_s: float
    error_text: str = ""


class PlanTask(msgspec.Struct, frozen=True):
    """Task of a worker: the region's day file and the search settings."""

    path: str
    policy: Literal["search", "dynamic"]
    trials: int | None
    seed: int
    start_us: int | None = None
    """Departure of the truck, for delivery windows."""


def divide_days_among_trucks(
    days: Sequence[DayData], truck_counts: Sequence[int]
) -> list[RegionDay]:
    """Return a day for each truck. `truck_counts`: number of trucks from each of the days' depots.

    The days' orders are pooled; equal orders of several days count once. Raises LeewayError if the
    days cannot be divided together.
    """
    _check_days_can_be_split_by_truck(days, truck_counts)
    orders = _pool_orders(days)
    frame = depot_frame(days[0].day.depot.location)
    orders_ne_m = np.array(
        [location_to_ground_ned_m(frame, order_location(order))[:2] for order in orders]
    )
    truck = days[0].day.truck
    problem = RegionProblem(
        depots_ne_m=np.array(
            [location_to_ground_ned_m(frame, data.day.depot.location)[:2] for data in days]
        ),
        trucks=tuple(truck_counts),
        orders_ne_m=orders_ne_m,
        work_s=_driver_work_s_by_order(days, sum(truck_counts), orders, orders_ne_m),
        metres_per_s=truck.speed_mps / truck.detour_factor,
    )
    region = truck_by_order_with_equal_work(problem)
    found: list[RegionDay] = []
    for data, count in zip(days, truck_counts, strict=True):
        for number in range(count):
            in_region = region == len(found)
            drones = data.day.drones[number::count]
            suffix = f"-{number + 1}"
            day = msgspec.structs.replace(
                data.day,
                name=f"{data.day.name}{suffix}",
                fleet=f"{data.day.fleet[: MAX_FLEET_NAME_LENGTH - len(suffix)]}{suffix}",
                drones=drones,
            )
            region_orders = [
                order
                for order, is_in_region in zip(orders, in_region.tolist(), strict=True)
                if is_in_region
            ]
            region_data = replace(data, day=day, orders=region_orders)
            found.append(RegionDay(day.name, region_data, float(problem.work_s[in_region].sum())))
    return _with_neighbour_fleets(found, {data.day.fleet for data in days})


def _with_neighbour_fleets(
    regions: Sequence[RegionDay], divided_fleets: set[str]
) -> list[RegionDay]:
    """Add to each region the fleets that it may meet in the air, in addition to those that its day
    names; fleets that have been divided are removed.
    """
    frame = depot_frame(regions[0].data.day.depot.location)
    areas_ne_m = [
        np.array(
            [
                location_to_ground_ned_m(frame, location)[:2]
                for location in (
                    region.data.day.depot.location,
                    *region.data.day.rally,
                    *map(order_location, region.data.orders),
                )
            ]
        )
        for region in regions
    ]
    found: list[RegionDay] = []
    for region, near in zip(
        regions, adjacent_area_indices_by_area(areas_ne_m, NEIGHBOUR_DISTANCE_M), strict=True
    ):
        day = region.data.day
        others = [name for name in day.neighbours if name not in divided_fleets]
        names = dict.fromkeys([*others, *(regions[k].data.day.fleet for k in near)])
        day = msgspec.structs.replace(day, neighbours=list(names))
        check_neighbour_fleets(f"{day.name}: neighbours", day.neighbours)
        found.append(replace(region, data=replace(region.data, day=day)))
    return found


def _check_days_can_be_split_by_truck(days: Sequence[DayData], truck_counts: Sequence[int]) -> None:
    """Raise LeewayError unless each truck can have a drone and names and fleets are unique."""
    for data, count in zip(days, truck_counts, strict=True):
        if len(data.day.drones) < count:
            raise LeewayError(
                f"{data.day.name}: {len(data.day.drones)} drones for {count} trucks:"
                " expected one or more for each"
            )
        if data.road_times_s is not None:
            raise LeewayError(
                f"{data.day.name}: a road matrix fits one truck only; expected speed and detour"
            )
    names = [data.day.name for data in days]
    fleets = [data.day.fleet for data in days]
    for field_name, found in (("name", names), ("fleet", fleets)):
        if len(set(found)) < len(found):
            raise LeewayError(
                f"{field_name}: expected a different one in each day, not {', '.join(found)}"
            )


def _pool_orders(days: Sequence[DayData]) -> list[Order]:
    orders: dict[str, Order] = {}
    for data in days:
        for order in data.orders:
            if orders.setdefault(order.id, order) != order:
                raise LeewayError(
                    f"{data.day.name}: order {order.id} differs from the one in another day"
                )
    return list(orders.values())


def _driver_work_s_by_order(
    days: Sequence[DayData], truck_count: int, orders: Sequence[Order], orders_ne_m: Floats
) -> Floats:
    """Return the driver's work of each order, by truck or drone, with the first day's truck."""
    truck = days[0].day.truck
    most_kg = max(
        airframe.mass.max_payload_kg for data in days for airframe in data.airframes.values()
    )
    can_fly = [order.service is not Service.TRUCK and order.mass_kg <= most_kg for order in orders]
    return driver_work_by_order_s(
        truck.deliver_s,
        truck.launch_s + truck.recover_s,
        np.array(can_fly, bool),
        orders_ne_m,
        truck.speed_mps / truck.detour_factor,
        sum(len(data.day.drones) for data in days) / truck_count,
    )


def write_region_day_and_orders(folder: Path, region: RegionDay, source_path: Path) -> Path:
    """Write a region's day and its orders; `source_path`: the day file of its origin.

    Returns the path of the day's file. Paths in the day are relative to its new folder.
    """
    orders = f"{region.name}_orders.csv"
    write_file_atomically(folder / orders, _orders_csv(region.data.orders).encode())
    changed: dict[str, Any] = {"orders": [orders], "columns": {}}
    day = region.data.day
    if day.no_fly is not None:
        changed["no_fly"] = _relative_path(folder, source_path.parent / day.no_fly)
    if day.forecast.file is not None:
        file = _relative_path(folder, source_path.parent / day.forecast.file)
        changed["forecast"] = msgspec.structs.replace(day.forecast, file=file)
    changed["elevation"] = [
        _relative_path(folder, source_path.parent / one) for one in day.elevation
    ]
    drones = [
        drone
        if not drone.airframe.endswith(".toml")
        else msgspec.structs.replace(
            drone, airframe=_relative_path(folder, source_path.parent / drone.airframe)
        )
        for drone in day.drones
    ]
    table = msgspec.to_builtins(msgspec.structs.replace(day, drones=drones, **changed))
    path = folder / f"{region.name}.toml"
    write_file_atomically(path, msgspec.toml.encode(_without_none(table)))
    return path


def _relative_path(folder: Path, path: Path) -> str:
    return os.path.relpath(path, folder)


def _orders_csv(orders: Sequence[Order]) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    cells_of_orders = [order_cells(order) for order in orders]
    used = [name for name in EXTRA_COLUMNS if any(c[name] not in DEFAULTS for c in cells_of_orders)]
    rows.writerow((*ORDER_COLUMNS, *used))
    for order, cells in zip(orders, cells_of_orders, strict=True):
        cells |= {
            "lat_deg": f"{order.lat_deg:.7f}",
            "lon_deg": f"{order.lon_deg:.7f}",
            "alt_amsl_m": f"{order.alt_amsl_m:.2f}",
            "mass_kg": f"{order.mass_kg:g}",
        }
        rows.writerow([cells[name] for name in (*ORDER_COLUMNS, *used)])
    return text.getvalue()


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(one) for key, one in value.items() if one is not None}
    if isinstance(value, list):
        return [_without_none(one) for one in value]
    return value


def plan_and_write_regions(
    regions: Sequence[RegionDay],
    plan_tasks: Sequence[PlanTask],
    workers: WorkerOptions,
    on_finished_region: Callable[[RegionResult], None],
    log: Callable[[str], None] = lambda words: None,
) -> list[RegionResult]:
    """Plan each region's day from its file in parallel; `on_finished_region` is called for each
    finished one.

    Plans are written next to the day files as `NAME_plan.json`, independent of the worker.
    """
    found: dict[int, RegionResult] = {}
    for outcome in run_parallel(plan_tasks, plan_region_and_measure_cpu_time, workers, log):
        region = regions[outcome.index]
        if isinstance(outcome, ItemLost):
            done = RegionResult(region, None, 0.0, outcome.reason)
        else:
            plan, cpu_s = outcome.result
            path = Path(plan_tasks[outcome.index].path)
            write_day_plan(path.with_name(f"{path.stem}_plan.json"), plan)
            done = RegionResult(region, plan, cpu_s)
        found[outcome.index] = done
        on_finished_region(done)
    return [found[index] for index in range(len(regions))]


def plan_region_and_measure_cpu_time(plan_task: PlanTask) -> tuple[DayPlan, float]:
    """Return the plan and its CPU time in seconds after reading the day, without compiling."""
    enable_compile_cache_and_check_if_known()  # before the planner's first import
    from ground_station.adapters.clock import process_cpu_time_s
    from ground_station.core.planning.day_planner import PlanParams, plan_day
    from ground_station.core.schema.day_state import initial_state

    data = replace(read_day(Path(plan_task.path)), start_us=plan_task.start_us)
    sample_data = replace(data, orders=data.orders[:3])
    plan_day(sample_data, initial_state(sample_data), PlanParams(trials=20))  # loads compiled code
    start_s = process_cpu_time_s()
    params = PlanParams(plan_task.policy, plan_task.trials, plan_task.seed)
    plan = plan_day(data, initial_state(data), params)
    return plan, process_cpu_time_s() - start_s
