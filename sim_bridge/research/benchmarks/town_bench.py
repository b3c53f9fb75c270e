"""A town with many vehicles in service: how much faster than its own time it is simulated.

The town has depots of up to eight drones, each with its desk, store, crew and network, all of them
those of `sim-bridge day`. A process steps its depots on one clock; depots share no airspace and no
fleet, so others may be stepped by other processes. Every drone of a depot is switched on all the
time but for the change of its pack, and orders are never short.
"""

import contextlib
import gc
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import psutil

from companion.adapters.files.params import read_airframe
from companion.core.base.geo import LocalFrame
from ground_station.core.schema.day import Day, Depot, Drone, Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import Order
from sim_bridge.adapters.wall_clock import cpu_s, wall_s
from sim_bridge.app.day.build import BuiltDay, build_day, here
from sim_bridge.app.day.desk import DeskHere
from sim_bridge.app.day.faults import DayWish
from sim_bridge.app.day.world import DayWorld
from sim_bridge.research.results.sheet import Sheet

MOST_AT_A_DEPOT = 8
DEPOT_LAT_DEG, DEPOT_LON_DEG, DEPOT_ALT_M = 55.47, 8.45, 12.0
APART_LON_DEG = 0.2
"""12 km between depots: further than any drone flies."""

ORDERS_NE_M = (300.0, 900.0)
"""Orders lie on a ring about their depot, drawn evenly over its area."""

ORDERS_EACH = 12
MASS_KG = 0.5
WARM_UP_S = 90.0
"""Boot, first assignments and first climbs are not timed."""

AIRFRAME = "m100"


class TownPart(msgspec.Struct, frozen=True, kw_only=True):
    """Depots of a town that one process simulates: their numbers and how many drones each has."""

    depots: list[tuple[int, int]]
    seed: int
    minutes: float
    folder: str


class TownPartFlown(msgspec.Struct, frozen=True, kw_only=True):
    """What it took, without the first two minutes. `air_s`: seconds of all vehicles in the air."""

    vehicles: int
    simulated_s: float
    cpu_s: float
    wall_s: float
    air_s: float
    delivered: int
    lost: int
    desk_cpu_s: float
    gc_s: float
    """Of it by the desks, and by Python's garbage collector."""
    rss_mb: float


class TownFlown(msgspec.Struct, frozen=True, kw_only=True):
    """A town by its processes. `cpu_s` is of all, `busiest_cpu_s` of the one with most work."""

    vehicles: int
    processes: int
    simulated_s: float
    cpu_s: float
    busiest_cpu_s: float
    wall_s: float
    in_the_air: float
    delivered: int
    lost: int
    desk_cpu_s: float
    gc_s: float
    rss_mb: float

    @classmethod
    def of(cls, parts: Sequence[TownPartFlown]) -> "TownFlown":
        """The town of these parts."""
        simulated_s = parts[0].simulated_s
        return cls(
            vehicles=sum(part.vehicles for part in parts),
            processes=len(parts),
            simulated_s=simulated_s,
            cpu_s=sum(part.cpu_s for part in parts),
            busiest_cpu_s=max(part.cpu_s for part in parts),
            wall_s=max(part.wall_s for part in parts),
            in_the_air=sum(part.air_s for part in parts) / simulated_s,
            delivered=sum(part.delivered for part in parts),
            lost=sum(part.lost for part in parts),
            desk_cpu_s=sum(part.desk_cpu_s for part in parts),
            gc_s=sum(part.gc_s for part in parts),
            rss_mb=sum(part.rss_mb for part in parts),
        )


def depots_of(vehicles: int) -> list[tuple[int, int]]:
    """As few depots as it takes, as evenly filled as can be."""
    count = math.ceil(vehicles / MOST_AT_A_DEPOT)
    return [(k, vehicles // count + (k < vehicles % count)) for k in range(count)]


def parts_of(
    vehicles: int, processes: int, seed: int, minutes: float, folder: Path
) -> list[TownPart]:
    """The town's depots dealt out to processes."""
    depots = depots_of(vehicles)
    return [
        TownPart(depots=depots[k::processes], seed=seed, minutes=minutes, folder=str(folder))
        for k in range(min(processes, len(depots)))
    ]


def depot_day(number: int, drones: int, seed: int) -> DayData:
    """The day of one depot: its drones, and more orders than they can bring in the time."""
    lon_deg = DEPOT_LON_DEG + number * APART_LON_DEG
    depot = Depot(lat_deg=DEPOT_LAT_DEG, lon_deg=lon_deg, alt_amsl_m=DEPOT_ALT_M)
    day = Day(
        format="day/1",
        name=f"depot-{number}",
        fleet=f"depot-{number}",
        depot=depot,
        drones=[Drone(id=f"d{number}-{k + 1}", airframe=AIRFRAME) for k in range(drones)],
        forecast=Forecast(speed_mps=4.0, from_deg=250.0, std_mps=2.0),
    )
    rng = np.random.default_rng([seed, number])
    frame = LocalFrame(math.radians(DEPOT_LAT_DEG), math.radians(lon_deg), DEPOT_ALT_M)
    orders = [_order(k, frame, rng) for k in range(ORDERS_EACH * drones)]
    return DayData(day, orders, None, {AIRFRAME: read_airframe(AIRFRAME)}, None)


def _order(number: int, frame: LocalFrame, rng: np.random.Generator) -> Order:
    low_m, high_m = ORDERS_NE_M
    away_m = math.sqrt(rng.uniform(low_m**2, high_m**2))
    angle_rad = rng.uniform(0.0, 2.0 * math.pi)
    at = (away_m * math.cos(angle_rad), away_m * math.sin(angle_rad), 0.0)
    lat_rad, lon_rad, _ = frame.to_geodetic(at)
    return Order(
        id=f"o{number:03d}",
        lat_deg=math.degrees(lat_rad),
        lon_deg=math.degrees(lon_rad),
        alt_amsl_m=DEPOT_ALT_M,
        mass_kg=MASS_KG,
    )


@dataclass(slots=True)
class _TimedSeat:
    """A desk whose turns are timed."""

    seat: DeskHere
    cpu_s: float = 0.0

    def turn(self) -> None:
        before_s = cpu_s()
        self.seat.turn()
        self.cpu_s += cpu_s() - before_s

    def kill(self) -> None:
        self.seat.kill()

    def start(self) -> None:
        self.seat.start()

    @property
    def is_done(self) -> bool:
        return self.seat.is_done


def fly_part(part: TownPart) -> TownPartFlown:
    """Step these depots together; the clock of each is the same."""
    with contextlib.ExitStack() as stack:
        built = [_depot_of(part, number, drones, stack) for number, drones in part.depots]
        worlds = [world for world, _, _ in built]
        for _ in range(round(WARM_UP_S / 0.1)):
            for world in worlds:
                world.step()
        for _, seat, _ in built:
            seat.cpu_s = 0.0
        collector = stack.enter_context(_collector_timed())
        before = cpu_s(), wall_s()
        air_s = 0.0
        steps = round(60.0 * part.minutes / 0.1)
        for _ in range(steps):
            for world in worlds:
                world.step()
                air_s += 0.1 * sum(drone.is_airborne for drone in world.drones)
        spent_s, took_s = cpu_s() - before[0], wall_s() - before[1]
        return TownPartFlown(
            vehicles=sum(drones for _, drones in part.depots),
            simulated_s=0.1 * steps,
            cpu_s=spent_s,
            wall_s=took_s,
            air_s=air_s,
            delivered=sum(_delivered(day) for _, _, day in built),
            lost=sum(_crashed(day) for _, _, day in built),
            desk_cpu_s=sum(seat.cpu_s for _, seat, _ in built),
            gc_s=sum(collector),
            rss_mb=psutil.Process().memory_info().rss / 1e6,
        )


@contextlib.contextmanager
def _collector_timed() -> Iterator[list[float]]:
    """CPU seconds of each of Python's garbage collections while inside."""
    spent: list[float] = []
    begun_s = 0.0

    def note(phase: str, info: dict[str, int]) -> None:
        nonlocal begun_s
        del info
        if phase == "start":
            begun_s = cpu_s()
        else:
            spent.append(cpu_s() - begun_s)

    gc.callbacks.append(note)
    try:
        yield spent
    finally:
        gc.callbacks.remove(note)


def _depot_of(
    part: TownPart, number: int, drones: int, stack: contextlib.ExitStack
) -> tuple[DayWorld, _TimedSeat, BuiltDay]:
    folder = Path(part.folder) / f"depot-{number}"
    folder.mkdir(parents=True)
    data = depot_day(number, drones, part.seed)
    need_s = WARM_UP_S + 60.0 * part.minutes
    made = build_day(
        data, DayWish(truck=False), part.seed + number, folder, need_s, here(0.0, folder)
    )
    stack.callback(made.plumbing.close)
    for drone in made.drones:
        stack.callback(drone.switch_off)
    seat = DeskHere.at_depot(made, folder)
    stack.callback(seat.close)
    timed = _TimedSeat(seat)
    world = DayWorld(made.clock, made.plumbing, made.drones, made.crew, timed, made.faults)
    return world, timed, made


def _delivered(day: BuiltDay) -> int:
    return sum(up.released_s is not None for drone in day.drones for up in drone.power_ups)


def _crashed(day: BuiltDay) -> int:
    return sum(up.vehicle.is_crashed for drone in day.drones for up in drone.power_ups)


def sheet(flown: Sequence[TownFlown]) -> Sheet:
    """A line for each town. Real time: simulated seconds over those of the busiest process."""
    head = [
        "vehicles", "processes", "in the air, mean", "times real time by CPU", "by the wall",
        "CPU ms a vehicle and second", "of it desks %", "garbage collector %", "MB", "lost",
    ]  # fmt: skip
    rows: list[list[str]] = []
    for one in flown:
        each_ms = 1000.0 * one.cpu_s / (one.vehicles * one.simulated_s)
        cells = (
            str(one.vehicles),
            str(one.processes),
            f"{one.in_the_air:.1f}",
            f"{one.simulated_s / one.busiest_cpu_s:.2f}",
            f"{one.simulated_s / one.wall_s:.2f}",
            f"{each_ms:.1f}",
            f"{100.0 * one.desk_cpu_s / one.cpu_s:.1f}",
            f"{100.0 * one.gc_s / one.cpu_s:.1f}",
            f"{one.rss_mb:.0f}",
            str(one.lost),
        )
        rows.append(list(cells))
    return Sheet("A town in service", head, rows)
