"""Build a day's world from its file: wind, drones with their companions, truck, network, faults.

All random draws derive from the seed, with an independent stream for each part.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np

from companion.adapters.files.params import params_dir
from companion.app.flight.fleet_port import FleetPort
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Ned, place_ned
from companion.core.mission.flight_plan import frame_at
from companion.core.pilot.context import PilotOptions
from companion.fleet.messages import State
from companion.fleet.network import MemberLink
from ground_station.app.truck.truck_member import TruckMember
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import place_of
from sim_bridge.app.day.bus import Bus
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.companion import MemoryLink, SteppedCompanion
from sim_bridge.app.day.crew import DepotCrew, GroundCrew
from sim_bridge.app.day.drone import Companion, DayDrone, DroneWorld
from sim_bridge.app.day.faults import AUTOPILOTS, DayWish, Faults, draw_faults
from sim_bridge.app.day.truck import DayTruck, DriverTimes
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.front import PassingFront, drawn_front
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.terrain import PlaneTerrain
from sim_bridge.truth.wind_field import MeanWind
from sim_bridge.truth.wind_log import WindLog, load_wind_log
from sim_bridge.truth.wind_params import (
    RampedWindParams,
    WindParams,
    WindPoint,
    mean_wind,
    parse_wind,
)

SHELF_SPREAD_FRAC = 0.03
"""Packs wait after charging: their charge is below the day's by up to this fraction."""

FORECAST_FROM_S = 600.0
"""The forecast of a recorded day is the mean of the ten minutes before it began, as a dispatcher
with an anemometer at the depot has it."""

FRONT_WITHIN = (0.2, 0.6)
FRONT_TAKES_S = 120.0
"""A front comes within this share of the wind's time, and the mean wind changes over two minutes:
a vehicle that is out meets it in flight."""

WIND_EVERY_S = 300.0
WANDER_FRAC = 0.5
"""Synthetic wind: its mean differs from the forecast by the forecast's std. Every five minutes a
step of half that std is added to a deviation that decays towards that mean."""


@dataclass(frozen=True, slots=True)
class DayWind:
    """The true wind, and the forecast of it that the desk has."""

    params: WindParams
    mean: MeanWind
    forecast: Forecast


class Network(Protocol):
    """What the world needs of the fleet's network: stepping, vehicle states, message counts."""

    @property
    def states(self) -> dict[str, State]: ...
    @property
    def sent(self) -> int: ...
    @property
    def lost(self) -> int: ...
    def deliver(self, t_s: float) -> None:
        """Advance time to `t_s` and deliver what is due."""
        ...


@dataclass(frozen=True, slots=True)
class Plumbing:
    """How world, companions and truck connect: in this process (`bus`), or between processes."""

    network: Network
    start: Callable[[DayDrone], Companion]
    truck_link: Callable[[str], MemberLink]
    epoch_us: Callable[[], int]
    pace: Callable[[float], None] = lambda t_s: None
    close: Callable[[], None] = lambda: None
    bus: Bus | None = None


Plumb = Callable[[DayData, DayClock, np.random.Generator], Plumbing]


@dataclass(slots=True)
class BuiltDay:
    """Everything of a day except its desk."""

    data: DayData
    frame: LocalFrame
    clock: DayClock
    plumbing: Plumbing
    drones: list[DayDrone]
    crew: GroundCrew
    faults: Faults
    customers: dict[str, Ned] = field(default_factory=dict)
    front: PassingFront | None = None
    shares_wind: bool = True


def day_wind(data: DayData, wish: DayWish, rng: np.random.Generator, need_s: float) -> DayWind:
    """Wind from a recording (start drawn from the seed), from a table, or drawn about the forecast.

    Raises LeewayError for wind that cannot be read or a recording that is too short.
    """
    forecast = data.day.forecast
    try:
        if wish.wind_log is not None:
            return _recorded(wish.wind_log.absolute(), forecast, rng, need_s)
        if wish.wind_table is not None:
            table = msgspec.toml.decode(wish.wind_table.read_bytes())
            params = parse_wind(table.get("wind", table))
            return DayWind(params, mean_wind(params, wish.wind_table.parent), forecast)
    except (TruthError, OSError, msgspec.DecodeError) as error:
        raise LeewayError(f"wind: {error}") from error
    params = _made(forecast, rng, need_s)
    if wish.front_mps > 0.0:
        params = with_front(params, wish.front_mps, rng, need_s)
    return DayWind(params, mean_wind(params, Path()), forecast)


def _recorded(path: Path, forecast: Forecast, rng: np.random.Generator, need_s: float) -> DayWind:
    log = load_wind_log(path)
    first, last = log.t_s[0] + FORECAST_FROM_S, log.t_s[-1] - need_s
    if last < first:
        raise LeewayError(
            f"{path}: {log.t_s[-1] - log.t_s[0]:.0f} s, expected {need_s + FORECAST_FROM_S:.0f}"
        )
    start_s = float(rng.uniform(first, last))
    params = parse_wind({"kind": "log", "log": str(path), "start_s": start_s})
    return DayWind(params, mean_wind(params, Path()), _persisting(log, start_s, forecast))


def _persisting(log: WindLog, start_s: float, forecast: Forecast) -> Forecast:
    t = np.asarray(log.t_s)
    before = (t >= start_s - FORECAST_FROM_S) & (t < start_s)
    north = float(np.mean(np.asarray(log.to_north_mps)[before]))
    east = float(np.mean(np.asarray(log.to_east_mps)[before]))
    from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
    return msgspec.structs.replace(
        forecast, speed_mps=round(math.hypot(north, east), 2), from_deg=round(from_deg, 1)
    )


def _made(forecast: Forecast, rng: np.random.Generator, need_s: float) -> RampedWindParams:
    mean = np.asarray(forecast.to_ne_mps) + rng.normal(0.0, forecast.std_mps, 2) / math.sqrt(2.0)
    off = np.zeros(2)
    winds: list[np.ndarray] = []
    for _ in range(math.ceil(need_s / WIND_EVERY_S) + 1):
        winds.append(mean + off)
        step = rng.normal(0.0, WANDER_FRAC * forecast.std_mps, 2) / math.sqrt(2.0)
        off = 0.7 * off + step
    times_s = [k * WIND_EVERY_S for k in range(len(winds))]
    return RampedWindParams(points=_points(times_s, winds), turbulence="dryden")


def _points(times_s: list[float], winds_to_ne_mps: list[np.ndarray]) -> list[WindPoint]:
    points: list[WindPoint] = []
    for t_s, (north, east) in zip(times_s, winds_to_ne_mps, strict=True):
        from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
        if points:  # directions are interpolated as the numbers stand: the short way round
            turn = (from_deg - points[-1].from_deg + 180.0) % 360.0 - 180.0
            from_deg = points[-1].from_deg + turn
        speed_mps = float(np.hypot(north, east))
        points.append(WindPoint(t_s=t_s, speed_mps=speed_mps, from_deg=from_deg))
    return points


def with_front(
    wind: RampedWindParams, change_mps: float, rng: np.random.Generator, need_s: float
) -> RampedWindParams:
    """This wind; from a drawn time on another of `change_mps` to a drawn side is added to it."""
    at_s = float(rng.uniform(*FRONT_WITHIN)) * need_s
    towards_rad = float(rng.uniform(0.0, 2.0 * math.pi))
    change = change_mps * np.array([math.cos(towards_rad), math.sin(towards_rad)])
    mean = mean_wind(wind, Path())
    times_s = sorted({*(point.t_s for point in wind.points), at_s, at_s + FRONT_TAKES_S})
    winds = [
        np.asarray(mean.to_ne_mps(t_s)) + np.clip((t_s - at_s) / FRONT_TAKES_S, 0.0, 1.0) * change
        for t_s in times_s
    ]
    return RampedWindParams(points=_points(times_s, winds), turbulence=wind.turbulence)


def here(loss: float, folder: Path) -> Plumb:
    """Everything in this process, on simulated time."""

    def plumb(data: DayData, clock: DayClock, rng: np.random.Generator) -> Plumbing:
        bus = Bus(rng, loss)
        airframe_of = {drone.id: drone.airframe for drone in data.day.drones}

        def start(drone: DayDrone) -> Companion:
            name = airframe_of[drone.name]
            port = FleetPort.open(
                drone.name,
                name,
                data.airframes[name],
                folder / drone.name,
                lambda life: bus.join(drone.name, life),
                clock.monotonic_s,
                lambda: clock.epoch_us() + round(drone.wall_off_s * 1e6),
            )
            beside = bool(data.day.neighbours)
            pilot = PilotOptions(
                configure=True, keep_apart=beside, name=drone.name, fleet=data.day.fleet
            )
            return SteppedCompanion(port, name, MemoryLink(), clock.monotonic_s, pilot)

        def truck_link(life: str) -> MemberLink:
            return bus.join(TRUCK, life)

        return Plumbing(bus, start, truck_link, clock.epoch_us, bus=bus)

    return plumb


def build_day(
    data: DayData, wish: DayWish, seed: int, folder: Path, need_s: float, plumb: Plumb
) -> BuiltDay:
    """Build the world of one day. The returned `data` holds the forecast in force."""
    seeds = np.random.SeedSequence(seed).spawn(6)
    wind_seed, bus_seed, truck_seed, fault_seed, drone_seed, front_seed = seeds
    wind = day_wind(data, wish, np.random.default_rng(wind_seed), need_s)
    data = replace(data, day=msgspec.structs.replace(data.day, forecast=wind.forecast))
    depot = data.day.depot
    frame = frame_at(depot.place)
    clock = DayClock()
    plumbing = plumb(data, clock, np.random.default_rng(bus_seed))
    world = DroneWorld(
        site=(depot.lat_deg, depot.lon_deg, depot.alt_amsl_m),
        terrain=_terrain(data),
        wind=wind.params,
        mean=wind.mean,
        parameters={
            f: read_parameters(params_dir() / "autopilots" / f"{f}.toml") for f in AUTOPILOTS
        },
        mavlink_loss=wish.loss,
        air_temperature_c=data.day.forecast.air_temperature_c,
    )
    drones = _drones(data, wish, world, folder, drone_seed, plumbing.start)
    crew: GroundCrew = _depot_crew(data, drones, plumbing)
    if wish.truck:
        truck_rng = np.random.default_rng(truck_seed)
        crew = _truck(data, frame, drones, plumbing, clock, folder, truck_rng)
        crew.late_s = wish.truck_late_s
    faults = draw_faults(wish, np.random.default_rng(fault_seed))
    customers = {order.id: place_ned(frame, place_of(order)) for order in data.orders}
    front = _passing_front(wish, wind, np.random.default_rng(front_seed))
    return BuiltDay(
        data, frame, clock, plumbing, drones, crew, faults, customers, front, wish.shares_wind
    )


def _passing_front(wish: DayWish, wind: DayWind, rng: np.random.Generator) -> PassingFront | None:
    size_mps = wish.passing_front_mps
    if size_mps <= 0.0:
        return None
    mean_ne_mps = np.asarray(wind.mean.to_ne_mps(wish.front_at_s))
    return drawn_front(wish.front_at_s, mean_ne_mps, size_mps, size_mps, rng)


def _terrain(data: DayData) -> PlaneTerrain:
    ground = data.day.depot.terrain
    if ground is None:
        return PlaneTerrain()
    return PlaneTerrain(ground.slope_north_frac, ground.slope_east_frac)


def _drones(
    data: DayData,
    wish: DayWish,
    world: DroneWorld,
    folder: Path,
    seed: np.random.SeedSequence,
    start: Callable[[DayDrone], Companion],
) -> list[DayDrone]:
    made: list[DayDrone] = []
    for k, (drone, own) in enumerate(
        zip(data.day.drones, seed.spawn(len(data.day.drones)), strict=True)
    ):
        made.append(
            DayDrone(
                name=drone.id,
                number=k + 1,
                autopilot_kind=wish.autopilots[k % len(wish.autopilots)],
                airframe=load_airframe(params_dir() / "truth" / f"{drone.airframe}.toml"),
                temperature_c=drone.temperature_c,
                battery_health_frac=drone.battery_health_frac,
                shelf_frac=(
                    max(0.05, drone.charge_frac - SHELF_SPREAD_FRAC),
                    drone.charge_frac,
                ),
                world=world,
                folder=folder / drone.id,
                seeds=own,
                start_companion=start,
            )
        )
    return made


def _depot_crew(data: DayData, drones: list[DayDrone], plumbing: Plumbing) -> DepotCrew:
    """The times are those of the day's driver for a drone that is taken in and one put out."""
    payload_kg = {order.id: order.mass_kg for order in data.orders}
    change_s = data.day.truck.recover_s + data.day.truck.launch_s
    return DepotCrew(drones, payload_kg, plumbing.network.states, change_s)


def _truck(
    data: DayData,
    frame: LocalFrame,
    drones: list[DayDrone],
    plumbing: Plumbing,
    clock: DayClock,
    folder: Path,
    rng: np.random.Generator,
) -> DayTruck:
    day = data.day
    port = TruckMember.open(
        TRUCK,
        folder / TRUCK,
        plumbing.truck_link,
        stop="depot",
        lat_deg=day.depot.lat_deg,
        lon_deg=day.depot.lon_deg,
        capacity_kg=day.truck.capacity_kg,
        clock_s=clock.monotonic_s,
        epoch_us=plumbing.epoch_us,
    )
    times = DriverTimes(day.truck.launch_s, day.truck.recover_s, day.truck.deliver_s)
    return DayTruck(
        port=port,
        frame=frame,
        drones={drone.name: drone for drone in drones},
        payload_kg={order.id: order.mass_kg for order in data.orders},
        times=times,
        drive_s=lambda before, after, metres: metres / day.truck.speed_mps,
        detour_factor=day.truck.detour_factor,
        rng=rng,
    )
