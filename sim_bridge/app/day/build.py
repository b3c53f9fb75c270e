"""Build the world of a day from its file: wind, drones, companions, truck, network and faults.

All random draws derive from the seed, with an independent stream for each part.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from companion.adapters.files.params import params_dir
from companion.app.flight.fleet_port import FleetPort
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, location_to_ground_ned_m
from companion.core.mission.flight_plan import depot_frame
from companion.core.pilot.context import PilotOptions
from ground_station.app.truck.truck_member import TruckMember
from ground_station.core.fleet.truck_state import TRUCK, TaskKind
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import order_location
from sim_bridge.app.day.bus import Bus
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.companion import SteppedCompanion
from sim_bridge.app.day.crew import DepotHandling, GroundHandling
from sim_bridge.app.day.drone import DayDrone, DroneWorld
from sim_bridge.app.day.faults import DayWorldOptions, draw_faults
from sim_bridge.app.day.truck import DayTruck
from sim_bridge.app.day.world import DayWorld
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.front import LinearFront, draw_front
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.terrain import PlaneTerrain
from sim_bridge.truth.wind_field import MeanWind
from sim_bridge.truth.wind_log import WindLog, load_wind_log
from sim_bridge.truth.wind_params import (
    RampedWindParams,
    WindParams,
    WindPoint,
    build_mean_wind,
    parse_wind,
)

PACK_CHARGE_SPREAD_FRAC = 0.03
"""Packs are stored after charging: their charge is up to this fraction below the day's value."""

FORECAST_WINDOW_S = 600.0
"""The forecast of a recorded day is the mean of the ten minutes before its start, as measured by
an anemometer at the depot."""

WIND_POINT_INTERVAL_S = 300.0
DEVIATION_STEP_FRAC = 0.5
"""Synthetic wind: the mean differs from the forecast by the forecast's std. Every five minutes a
step of half that std is added to a deviation that decays towards that mean."""


@dataclass(frozen=True, slots=True)
class DayWind:
    """The true wind, and the forecast that the desk uses."""

    params: WindParams
    mean: MeanWind
    forecast: Forecast


def build_day_wind(
    data: DayData,
    world_options: DayWorldOptions,
    rng: np.random.Generator,
    required_duration_s: float,
) -> DayWind:
    """Return wind from a recording (with a drawn start), from a table, or drawn about the forecast.

    Raises LeewayError if the wind cannot be read or the recording is too short.
    """
    forecast = data.day.forecast
    try:
        if world_options.wind_log is not None:
            return _recorded_wind_with_random_start(
                world_options.wind_log.absolute(), forecast, rng, required_duration_s
            )
        if world_options.wind_table is not None:
            table = msgspec.toml.decode(world_options.wind_table.read_bytes())
            params = parse_wind(table.get("wind", table))
            return DayWind(
                params, build_mean_wind(params, world_options.wind_table.parent), forecast
            )
    except (TruthError, OSError, msgspec.DecodeError) as error:
        raise LeewayError(f"wind: {error}") from error
    params = _draw_wind(forecast, rng, required_duration_s)
    return DayWind(params, build_mean_wind(params, Path()), forecast)


def _recorded_wind_with_random_start(
    path: Path, forecast: Forecast, rng: np.random.Generator, required_duration_s: float
) -> DayWind:
    log = load_wind_log(path)
    first, last = log.t_s[0] + FORECAST_WINDOW_S, log.t_s[-1] - required_duration_s
    if last < first:
        raise LeewayError(
            f"{path}: recording of {log.t_s[-1] - log.t_s[0]:.0f} s, expected at least"
            f" {required_duration_s + FORECAST_WINDOW_S:.0f} s"
        )
    start_s = float(rng.uniform(first, last))
    params = parse_wind({"kind": "log", "log": str(path), "start_s": start_s})
    return DayWind(
        params,
        build_mean_wind(params, Path()),
        _forecast_from_preceding_mean_wind(log, start_s, forecast),
    )


def _forecast_from_preceding_mean_wind(
    log: WindLog, start_s: float, forecast: Forecast
) -> Forecast:
    t = np.asarray(log.t_s)
    before = (t >= start_s - FORECAST_WINDOW_S) & (t < start_s)
    north = float(np.mean(np.asarray(log.to_north_mps)[before]))
    east = float(np.mean(np.asarray(log.to_east_mps)[before]))
    from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
    return msgspec.structs.replace(
        forecast, speed_mps=round(math.hypot(north, east), 2), from_deg=round(from_deg, 1)
    )


def _draw_wind(
    forecast: Forecast, rng: np.random.Generator, required_duration_s: float
) -> RampedWindParams:
    mean = np.asarray(forecast.to_ne_mps) + rng.normal(0.0, forecast.std_mps, 2) / math.sqrt(2.0)
    deviation_ne_mps = np.zeros(2)
    winds: list[np.ndarray] = []
    for _ in range(math.ceil(required_duration_s / WIND_POINT_INTERVAL_S) + 1):
        winds.append(mean + deviation_ne_mps)
        step = rng.normal(0.0, DEVIATION_STEP_FRAC * forecast.std_mps, 2) / math.sqrt(2.0)
        deviation_ne_mps = 0.7 * deviation_ne_mps + step
    times_s = [k * WIND_POINT_INTERVAL_S for k in range(len(winds))]
    return RampedWindParams(points=_wind_points(times_s, winds), turbulence="dryden")


def _wind_points(times_s: list[float], winds_to_ne_mps: list[np.ndarray]) -> list[WindPoint]:
    points: list[WindPoint] = []
    for t_s, (north, east) in zip(times_s, winds_to_ne_mps, strict=True):
        from_deg = math.degrees(math.atan2(-east, -north)) % 360.0
        if points:  # directions are interpolated numerically: unwrap them
            turn = (from_deg - points[-1].from_deg + 180.0) % 360.0 - 180.0
            from_deg = points[-1].from_deg + turn
        speed_mps = float(np.hypot(north, east))
        points.append(WindPoint(t_s=t_s, speed_mps=speed_mps, from_deg=from_deg))
    return points


def _companion_starter(
    data: DayData, bus: Bus, clock: DayClock, folder: Path
) -> Callable[[DayDrone], SteppedCompanion]:
    """Return a function that starts a drone's companion on the day's network and clock."""
    airframe_of = {drone.id: drone.airframe for drone in data.day.drones}
    has_neighbours = bool(data.day.neighbours)

    def start_companion(drone: DayDrone) -> SteppedCompanion:
        name = airframe_of[drone.name]
        port = FleetPort.open(
            drone.name,
            name,
            data.airframes[name],
            folder / drone.name,
            lambda instance_id: bus.join(drone.name, instance_id),
            clock.monotonic_s,
            lambda: clock.epoch_us() + round(drone.wall_clock_offset_s * 1e6),
        )
        pilot = PilotOptions(
            configure=True, separation_enabled=has_neighbours, name=drone.name, fleet=data.day.fleet
        )
        return SteppedCompanion(port, name, clock.monotonic_s, pilot)

    return start_companion


def build_day(
    data: DayData,
    world_options: DayWorldOptions,
    seed: int,
    folder: Path,
    required_duration_s: float,
) -> DayWorld:
    """Build the world of one day without its desk. Its `data` holds the forecast in use."""
    seeds = np.random.SeedSequence(seed).spawn(6)
    wind_seed, bus_seed, truck_seed, fault_seed, drone_seed, front_seed = seeds
    wind = build_day_wind(
        data, world_options, np.random.default_rng(wind_seed), required_duration_s
    )
    data = replace(data, day=msgspec.structs.replace(data.day, forecast=wind.forecast))
    depot = data.day.depot
    frame = depot_frame(depot.location)
    clock = DayClock()
    bus = Bus(np.random.default_rng(bus_seed), world_options.loss)
    world = DroneWorld(
        site=(depot.lat_deg, depot.lon_deg, depot.alt_amsl_m),
        terrain=_build_terrain(data),
        wind=wind.params,
        mean=wind.mean,
        mavlink_loss=world_options.loss,
        air_temperature_c=data.day.forecast.air_temperature_c,
    )
    drones = _build_drones(
        data, world_options, world, folder, drone_seed, _companion_starter(data, bus, clock, folder)
    )
    ground_handling: GroundHandling = DepotHandling(
        drones,
        {order.id: order.mass_kg for order in data.orders},
        bus.states,
        data.day.truck.recover_s + data.day.truck.launch_s,  # the driver's times
    )
    if world_options.truck:
        truck_rng = np.random.default_rng(truck_seed)
        ground_handling = _build_truck(data, frame, drones, bus, clock, folder, truck_rng)
        ground_handling.second_drive_delay_s = world_options.truck_late_s
    faults = draw_faults(world_options, np.random.default_rng(fault_seed))
    customers = {
        order.id: location_to_ground_ned_m(frame, order_location(order)) for order in data.orders
    }
    front = _draw_passing_front(world_options, wind, np.random.default_rng(front_seed))
    return DayWorld(
        data,
        frame,
        clock,
        bus,
        drones,
        ground_handling,
        faults,
        customers,
        front,
        world_options.shares_wind,
    )


def _draw_passing_front(
    world_options: DayWorldOptions, wind: DayWind, rng: np.random.Generator
) -> LinearFront | None:
    size_mps = world_options.passing_front_mps
    if size_mps <= 0.0:
        return None
    mean_ne_mps = np.asarray(wind.mean.to_ne_mps(world_options.front_at_s))
    return draw_front(world_options.front_at_s, mean_ne_mps, size_mps, size_mps, rng)


def _build_terrain(data: DayData) -> PlaneTerrain:
    ground = data.day.depot.terrain
    if ground is None:
        return PlaneTerrain()
    return PlaneTerrain(ground.slope_north_frac, ground.slope_east_frac)


def _build_drones(
    data: DayData,
    world_options: DayWorldOptions,
    world: DroneWorld,
    folder: Path,
    seed: np.random.SeedSequence,
    start_companion: Callable[[DayDrone], SteppedCompanion],
) -> list[DayDrone]:
    seeds = seed.spawn(len(data.day.drones))
    return [
        DayDrone(
            name=drone.id,
            number=k + 1,
            autopilot_kind=world_options.autopilots[k % len(world_options.autopilots)],
            airframe=load_airframe(params_dir() / "truth" / f"{drone.airframe}.toml"),
            temperature_c=drone.temperature_c,
            battery_health_frac=drone.battery_health_frac,
            pack_charge_range_frac=(
                max(0.05, drone.charge_frac - PACK_CHARGE_SPREAD_FRAC),
                drone.charge_frac,
            ),
            world=world,
            folder=folder / drone.id,
            seeds=seeds[k],
            start_companion=start_companion,
        )
        for k, drone in enumerate(data.day.drones)
    ]


def _build_truck(
    data: DayData,
    frame: LocalFrame,
    drones: list[DayDrone],
    bus: Bus,
    clock: DayClock,
    folder: Path,
    rng: np.random.Generator,
) -> DayTruck:
    day = data.day
    port = TruckMember.load_or_create(
        TRUCK,
        folder / TRUCK,
        lambda instance_id: bus.join(TRUCK, instance_id),
        initial_stop="depot",
        lat_deg=day.depot.lat_deg,
        lon_deg=day.depot.lon_deg,
        capacity_kg=day.truck.capacity_kg,
        clock_s=clock.monotonic_s,
        epoch_us=clock.epoch_us,
    )
    task_s = {
        TaskKind.PUT_OUT: day.truck.launch_s,
        TaskKind.RECOVER: day.truck.recover_s,
        TaskKind.SERVE: day.truck.deliver_s,
    }
    return DayTruck(
        port=port,
        frame=frame,
        drones={drone.name: drone for drone in drones},
        payload_kg={order.id: order.mass_kg for order in data.orders},
        task_s=task_s,
        speed_mps=day.truck.speed_mps,
        detour_factor=day.truck.detour_factor,
        rng=rng,
    )
