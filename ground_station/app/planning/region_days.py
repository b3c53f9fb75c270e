"""Large days: several day files as one, divided into a day for each truck, each of them planned.

Each day has its own orders, drones and fleet, so that each truck has a desk of its own; nothing
flies from one region's truck to another's. Fleets that may meet in the air are neighbours.
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
from companion.core.base.geo import place_ned
from companion.core.base.place import Place
from companion.core.mission.flight_file import check_neighbours
from companion.core.mission.flight_plan import frame_at
from ground_station.adapters.files.compiled_code import keep_compiled_code
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.plan_files import write_day_plan, write_text
from ground_station.adapters.workers.side_by_side import PieceLost, Workers, side_by_side
from ground_station.core.planning.regions import (
    RegionProblem,
    meeting,
    order_work_s,
    regions_of,
)
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.orders import Order, Service, place_of

COLUMNS = ("id", "lat_deg", "lon_deg", "alt_amsl_m", "mass_kg", "service", "note")
LONGEST_NAME = 32
MEET_M = 2000.0
"""Between the hulls about two regions' places, each flown as straight lines: who flies around what
may not be flown over, or dodges, leaves its own by less than half of that.
"""


@dataclass(frozen=True, slots=True)
class RegionDay:
    """One truck's day. `work_s`: of its driver, by the measure that the division balances."""

    name: str
    data: DayData
    work_s: float


@dataclass(frozen=True, slots=True)
class RegionPlanned:
    """A region's plan, and the CPU seconds that it took; `plan` None: `lost` says why."""

    region: RegionDay
    plan: DayPlan | None
    cpu_s: float
    lost: str = ""


class PlanWork(msgspec.Struct, frozen=True):
    """What a worker is sent: the region's day file, and how to search."""

    path: str
    policy: Literal["search", "dynamic"]
    trials: int | None
    seed: int


def divided(
    days: Sequence[DayData],
    trucks: Sequence[int],
    share: Floats | None = None,
    before: Sequence[RegionDay] = (),
) -> list[RegionDay]:
    """A day for each truck. `trucks`: how many start from each of the days' depots. `share`
    (trucks,): of all drivers' work, by truck, 1 in all; each the same by default. `before`: these
    days divided already, to be changed as little as that asks.

    The days' orders are pooled; one that several days name is one order where it is the same.
    Raises LeewayError where the days cannot be divided together.
    """
    _check(days, trucks)
    orders = _pooled(days)
    frame = frame_at(days[0].day.depot.place)
    orders_ne_m = np.array([place_ned(frame, place_of(order))[:2] for order in orders])
    truck = days[0].day.truck
    problem = RegionProblem(
        depots_ne_m=np.array([place_ned(frame, data.day.depot.place)[:2] for data in days]),
        trucks=tuple(trucks),
        orders_ne_m=orders_ne_m,
        work_s=_work_s(days, sum(trucks), orders, orders_ne_m),
        metres_per_s=truck.speed_mps / truck.detour_factor,
    )
    number_of = {order.id: k for k, one in enumerate(before) for order in one.data.orders}
    now = np.array([number_of[order.id] for order in orders]) if before else None
    region = regions_of(problem, share, now)
    found: list[RegionDay] = []
    for data, count in zip(days, trucks, strict=True):
        for number in range(count):
            mine = region == len(found)
            drones = data.day.drones[number::count]
            suffix = f"-{number + 1}"
            day = msgspec.structs.replace(
                data.day,
                name=f"{data.day.name}{suffix}",
                fleet=f"{data.day.fleet[: LONGEST_NAME - len(suffix)]}{suffix}",
                drones=drones,
            )
            own = [order for order, is_mine in zip(orders, mine.tolist(), strict=True) if is_mine]
            region_data = replace(data, day=day, orders=own)
            found.append(RegionDay(day.name, region_data, float(problem.work_s[mine].sum())))
    return _with_neighbours(found, {data.day.fleet for data in days})


def _with_neighbours(regions: Sequence[RegionDay], divided_up: set[str]) -> list[RegionDay]:
    """Each with the others that it may meet in the air, beside those that its day names already;
    fleets that are divided up are no more.
    """
    frame = frame_at(regions[0].data.day.depot.place)
    areas_ne_m = [
        np.array([place_ned(frame, place)[:2] for place in _places(region.data)])
        for region in regions
    ]
    found: list[RegionDay] = []
    for region, near in zip(regions, meeting(areas_ne_m, MEET_M), strict=True):
        day = region.data.day
        others = [name for name in day.neighbours if name not in divided_up]
        names = dict.fromkeys([*others, *(regions[k].data.day.fleet for k in near)])
        day = msgspec.structs.replace(day, neighbours=list(names))
        check_neighbours(f"{day.name}: neighbours", day.neighbours)
        found.append(replace(region, data=replace(region.data, day=day)))
    return found


def _places(data: DayData) -> list[Place]:
    """Where its drones take off, deliver and may land."""
    return [data.day.depot.place, *data.day.rally, *(place_of(order) for order in data.orders)]


def _check(days: Sequence[DayData], trucks: Sequence[int]) -> None:
    for data, count in zip(days, trucks, strict=True):
        if len(data.day.drones) < count:
            raise LeewayError(
                f"{data.day.name}: {len(data.day.drones)} drones for {count} trucks:"
                " expected one or more for each"
            )
        if data.roads_s is not None:
            raise LeewayError(
                f"{data.day.name}: a road matrix is of one truck's day; expected speed and detour"
            )
    names = [data.day.name for data in days]
    fleets = [data.day.fleet for data in days]
    for what, found in (("name", names), ("fleet", fleets)):
        if len(set(found)) < len(found):
            raise LeewayError(f"{what}: expected another in each day, not {', '.join(found)}")


def _pooled(days: Sequence[DayData]) -> list[Order]:
    orders: dict[str, Order] = {}
    for data in days:
        for order in data.orders:
            if orders.setdefault(order.id, order) != order:
                raise LeewayError(f"{data.day.name}: order {order.id} is another in another day")
    return list(orders.values())


def _work_s(
    days: Sequence[DayData], trucks: int, orders: Sequence[Order], orders_ne_m: Floats
) -> Floats:
    """By the first day's truck: what a door and what a drone cost its driver."""
    truck = days[0].day.truck
    most_kg = max(
        airframe.mass.max_payload_kg for data in days for airframe in data.airframes.values()
    )
    flies = [order.service is not Service.TRUCK and order.mass_kg <= most_kg for order in orders]
    return order_work_s(
        truck.deliver_s,
        truck.launch_s + truck.recover_s,
        np.array(flies, bool),
        orders_ne_m,
        truck.speed_mps / truck.detour_factor,
        sum(len(data.day.drones) for data in days) / trucks,
    )


def write_region(folder: Path, region: RegionDay, beside: Path) -> Path:
    """Write a region's day and its orders; `beside`: the day file that it came from.

    Returns the day's file. Files that the day names are named from where it is now.
    """
    orders = f"{region.name}_orders.csv"
    write_text(folder / orders, _orders_csv(region.data.orders))
    changed: dict[str, Any] = {"orders": [orders]}
    day = region.data.day
    if day.no_fly is not None:
        changed["no_fly"] = _from(folder, beside.parent / day.no_fly)
    if day.forecast.file is not None:
        file = _from(folder, beside.parent / day.forecast.file)
        changed["forecast"] = msgspec.structs.replace(day.forecast, file=file)
    changed["elevation"] = [_from(folder, beside.parent / one) for one in day.elevation]
    drones = [
        drone
        if not drone.airframe.endswith(".toml")
        else msgspec.structs.replace(drone, airframe=_from(folder, beside.parent / drone.airframe))
        for drone in day.drones
    ]
    table = msgspec.to_builtins(msgspec.structs.replace(day, drones=drones, **changed))
    path = folder / f"{region.name}.toml"
    write_text(path, msgspec.toml.encode(_without_none(table)).decode())
    return path


def _from(folder: Path, path: Path) -> str:
    return os.path.relpath(path, folder)


def _orders_csv(orders: Sequence[Order]) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    for order in orders:
        rows.writerow(
            (
                order.id,
                f"{order.lat_deg:.7f}",
                f"{order.lon_deg:.7f}",
                f"{order.alt_amsl_m:.2f}",
                f"{order.mass_kg:g}",
                order.service.value,
                order.note,
            )
        )
    return text.getvalue()


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(one) for key, one in value.items() if one is not None}
    if isinstance(value, list):
        return [_without_none(one) for one in value]
    return value


def planned(
    regions: Sequence[RegionDay],
    work: Sequence[PlanWork],
    workers: Workers,
    tell: Callable[[RegionPlanned], None],
    say: Callable[[str], None] = lambda words: None,
) -> list[RegionPlanned]:
    """Plan each region's day from its file, side by side; `tell` is told each as it ends.

    Plans are written beside the day files as `NAME_plan.json`, and are the same whoever makes them.
    """
    found: dict[int, RegionPlanned] = {}
    for ended in side_by_side(work, plan_region, workers, say):
        region = regions[ended.index]
        if isinstance(ended, PieceLost):
            done = RegionPlanned(region, None, 0.0, ended.why)
        else:
            plan, cpu_s = ended.result
            path = Path(work[ended.index].path)
            write_day_plan(path.with_name(f"{path.stem}_plan.json"), plan)
            done = RegionPlanned(region, plan, cpu_s)
        found[ended.index] = done
        tell(done)
    return [found[index] for index in range(len(regions))]


def plan_region(work: PlanWork) -> tuple[DayPlan, float]:
    """The plan, and the CPU seconds from the read day to it, without compiling."""
    keep_compiled_code()  # before the planner's first import
    from ground_station.adapters.clock import cpu_s
    from ground_station.core.planning.day_planner import PlanParams, plan_day
    from ground_station.core.schema.day_state import first_state

    data = read_day(Path(work.path))
    few = replace(data, orders=data.orders[:3])
    plan_day(few, first_state(few), PlanParams(trials=20))  # loads what is compiled
    begun_s = cpu_s()
    params = PlanParams(work.policy, work.trials, work.seed)
    plan = plan_day(data, first_state(data), params)
    return plan, cpu_s() - begun_s
