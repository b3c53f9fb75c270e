"""Scene of vehicles that take off from one truck simultaneously, in one layer, on crossing paths.

Launch slots and layers are deliberately disabled. Separation depends only on the tracks that
companions exchange and on their avoidance set-points (docs/explanation/avoidance.md).
Drones, network and stepped clock are those of the simulated day; there is no desk.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import params_dir, read_airframe
from companion.app.flight.fleet_port import FleetPort
from companion.core.base.geo import LocalFrame, offset_position_deg
from companion.core.mission.events import MissionAuthorised
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.transitions import Phase
from companion.core.separation.track import Track as Told
from companion.fleet.messages import decode_message, encode_message
from sim_bridge.app.day.bus import Bus
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.companion import SteppedCompanion
from sim_bridge.app.day.drone import DayDrone, DroneWorld
from sim_bridge.app.day.judge import VehicleTrack
from sim_bridge.app.world.vehicle_host import EXCHANGE_S, STEPS_PER_EXCHANGE
from sim_bridge.autopilot.kinds import AUTOPILOTS
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.terrain import PlaneTerrain
from sim_bridge.truth.wind_params import RampedWindParams, WindPoint, build_mean_wind

SITE = (55.47, 8.45, 12.0)
AIRFRAME = "m100"
RING_RADIUS_M = 46.0
"""Distance from the truck to each pad; eight pads are then 35 m from each other."""

CUSTOMER_DISTANCE_M = 100.0
"""Distance from the truck to each customer, on the far side: all routes pass the truck."""

CUSTOMER_BEARING_SPREAD_RAD = math.radians(20.0)
"""Largest deviation of a customer's bearing from the direction opposite to the pad."""

WIND_MAX_MPS = 6.0
TRACK_DELAY_S, TRACK_ERROR_STD_M = 0.2, 2.0
"""Delay of the tracks that neighbours receive, and their 1-sigma error per axis."""

ERROR_CORRELATION_S = 30.0
"""Correlation time of the errors in neighbours' tracks. GNSS errors change slowly, so averaging
does not reduce them."""

VERTICAL_ERROR_FRAC = 0.25
"""Vertical error as a fraction of the horizontal error: heights come from barometers."""

PAYLOAD_KG, DROP_HEIGHT_M, RESERVE_FRAC = 0.3, 15.0, 0.15
TIME_LIMIT_S = 420.0


@dataclass(frozen=True, slots=True)
class CrossOptions:
    """Options of a crossing.

    `fleets`: number of fleets; vehicles are assigned in rotation. Each fleet has its own network
    and receives the others' tracks if `neighbours`. Without `separation_filter` set-points ignore
    traffic. `ring_radius_m`, `customer_distance_m`: distances from the truck.
    `customer_bearing_spread_rad`: spread of bearings.
    """

    vehicles: int = 8
    seed: int = 1
    fleets: int = 1
    neighbours: bool = True
    separation_filter: bool = True
    ring_radius_m: float = RING_RADIUS_M
    customer_distance_m: float = CUSTOMER_DISTANCE_M
    customer_bearing_spread_rad: float = CUSTOMER_BEARING_SPREAD_RAD
    cruise_height_m: float = 30.0
    run_root: Path = Path("logs")


@dataclass(slots=True)
class CrossingVehicle:
    """One vehicle of the scene."""

    drone: DayDrone
    fleet: str
    pad_ne_m: tuple[float, float]
    customer_ne_m: tuple[float, float]
    companion: SteppedCompanion | None = None
    setpoint_time_s: float = 0.0
    is_killed: bool = False

    @property
    def name(self) -> str:
        """Name that is unique among all fleets."""
        return self.drone.folder.name

    def build_vehicle_track(self) -> VehicleTrack:
        """Return its true track, under the name that is unique among all fleets."""
        assert self.drone.power_cycle is not None
        track = self.drone.build_vehicle_track(self.drone.power_cycle, RESERVE_FRAC)
        return replace(track, vehicle=self.name, order=self.name)

    @property
    def is_ready(self) -> bool:
        """Whether the mission is uploaded and verified."""
        run = None if self.companion is None else self.companion.run
        return run is not None and run.pilot.phase is Phase.READY

    @property
    def has_ended_on_ground(self) -> bool:
        """Whether the vehicle is on the ground and its companion has ended."""
        ended = self.is_killed or (
            self.companion is not None and self.companion.exit_code is not None
        )
        return ended and not self.drone.is_airborne


class TrackErrorModel:
    """Adds time-correlated position errors to the tracks that neighbours receive."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._std = TRACK_ERROR_STD_M * np.array([1.0, 1.0, VERTICAL_ERROR_FRAC])
        self._rng = rng
        self._error_by_vehicle: dict[str, tuple[float, np.ndarray]] = {}

    def __call__(self, raw: bytes, t_s: float) -> bytes:
        """Return the track with the current GNSS error of its sender added."""
        track = decode_message(Told, raw)
        if not isinstance(track, Told):
            return raw
        previous_s, error_ned_m = self._error_by_vehicle.get(
            track.vehicle, (t_s, self._std * self._rng.standard_normal(3))
        )
        correlation = math.exp(-(t_s - previous_s) / ERROR_CORRELATION_S)
        error_ned_m = correlation * error_ned_m + math.sqrt(
            1.0 - correlation**2
        ) * self._std * self._rng.standard_normal(3)
        self._error_by_vehicle[track.vehicle] = (t_s, error_ned_m)
        north, east, down = (float(x) for x in error_ned_m)
        lat, lon = (
            float(x) for x in offset_position_deg(track.lat_deg, track.lon_deg, north, east)
        )
        return encode_message(
            msgspec.structs.replace(
                track, lat_deg=lat, lon_deg=lon, alt_amsl_m=track.alt_amsl_m - down
            )
        )


class Crossing:
    """The scene. Call `run_until_over`, then read the results from `crossers`."""

    def __init__(self, options: CrossOptions, folder: Path) -> None:
        self.options, self.folder = options, folder
        self.clock = DayClock()
        seeds = np.random.SeedSequence(options.seed).spawn(4)
        scene_seed, bus_seed, error_seed, drone_seed = seeds
        self.buses = _build_networks(options, bus_seed, error_seed)
        self.airframe = read_airframe(AIRFRAME)
        self.authorised_s: float | None = None
        self.crossers = self._build_vehicles(np.random.default_rng(scene_seed), drone_seed)
        self._steps = 0

    # --- building ------------------------------------------------------------------------------

    def _build_vehicles(
        self, rng: np.random.Generator, seed: np.random.SeedSequence
    ) -> list[CrossingVehicle]:
        count = self.options.vehicles
        speed = float(rng.uniform(0.0, WIND_MAX_MPS))
        wind = RampedWindParams(
            points=[WindPoint(t_s=0.0, speed_mps=speed, from_deg=float(rng.uniform(0.0, 360.0)))],
            turbulence="dryden",
        )
        world = DroneWorld(
            site=SITE,
            terrain=PlaneTerrain(),
            wind=wind,
            mean=build_mean_wind(wind, Path()),
        )
        truth = load_airframe(params_dir() / "truth" / f"{AIRFRAME}.toml")
        start_angle_rad = float(rng.uniform(0.0, 2.0 * math.pi))
        found: list[CrossingVehicle] = []
        for k, child_seed in enumerate(seed.spawn(count)):
            angle = start_angle_rad + 2.0 * math.pi * k / count
            customer_bearing_rad = (
                angle
                + math.pi
                + float(rng.uniform(-1.0, 1.0)) * self.options.customer_bearing_spread_rad
            )
            fleet = list(self.buses)[k % len(self.buses)]
            name = f"d{k // len(self.buses) + 1}"  # fleets use the same names
            is_single_fleet = len(self.buses) == 1
            drone = DayDrone(
                name=name,
                number=k + 1,
                autopilot_kind=AUTOPILOTS[k % 2],
                airframe=truth,
                temperature_c=20.0,
                battery_health_frac=1.0,
                pack_charge_range_frac=(0.9, 0.95),
                world=world,
                folder=self.folder / (name if is_single_fleet else f"{fleet}-{name}"),
                seeds=child_seed,
                start_companion=self._start_companion,
            )
            found.append(
                CrossingVehicle(
                    drone,
                    fleet,
                    _polar_to_ne_m(self.options.ring_radius_m, angle),
                    _polar_to_ne_m(self.options.customer_distance_m, customer_bearing_rad),
                )
            )
        for crosser in found:
            drone = crosser.drone
            drone.switch_on_at_pad(
                0.0, crosser.pad_ne_m, PAYLOAD_KG, drone.name, already_booted=True
            )
        return found

    def _start_companion(self, drone: DayDrone) -> SteppedCompanion:
        crosser = next(c for c in self.crossers if c.drone is drone)
        port = FleetPort.open(
            drone.name,
            AIRFRAME,
            self.airframe,
            drone.folder,
            lambda instance_id: self.buses[crosser.fleet].join(drone.name, instance_id),
            self.clock.monotonic_s,
            self.clock.epoch_us,
        )
        pilot = PilotOptions(
            configure=True,
            separation_enabled=True,
            separation_filter=self.options.separation_filter,
            name=drone.name,
            fleet=crosser.fleet,
        )
        mission, clock_s = self._write_flight_file(crosser), self.clock.monotonic_s
        crosser.companion = SteppedCompanion(port, AIRFRAME, clock_s, pilot, mission)
        return crosser.companion

    def _write_flight_file(self, crosser: CrossingVehicle) -> Path:
        frame = LocalFrame(math.radians(SITE[0]), math.radians(SITE[1]), SITE[2])
        lat, lon, _ = frame.to_geodetic((*crosser.pad_ne_m, 0.0))
        north, east = (c - p for c, p in zip(crosser.customer_ne_m, crosser.pad_ne_m, strict=True))
        table: dict[str, Any] = {
            "format": "flight/1",
            "name": crosser.drone.name,
            "site": {
                "depot": {
                    "lat_deg": math.degrees(lat),
                    "lon_deg": math.degrees(lon),
                    "alt_amsl_m": SITE[2],
                },
                "customer": {"name": "customer", "north_m": north, "east_m": east},
            },
            "vehicle": {"airframe": AIRFRAME, "payload_kg": PAYLOAD_KG, "charge_frac": [0.9, 0.95]},
            "mission": {
                "cruise_height_m": self.options.cruise_height_m,
                "drop_height_m": DROP_HEIGHT_M,
                "reserve_frac": RESERVE_FRAC,
                "leg_length_m": 100.0,
                "wind_settle_s": 4.0,
            },
        }
        if self.options.neighbours and len(self.buses) > 1:
            others = [fleet for fleet in self.buses if fleet != crosser.fleet]
            table["neighbours"] = [{"fleet": fleet} for fleet in others]
        path = crosser.drone.folder / "flight.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(msgspec.toml.encode(table))
        return path

    # --- time ----------------------------------------------------------------------------------

    def run_until_over(
        self, should_continue: Callable[["Crossing"], bool] = lambda _: True
    ) -> None:
        """Run until all vehicles are over, `TIME_LIMIT_S`, or `should_continue` returns False (each
        second).
        """
        try:
            while self.clock.t_s < TIME_LIMIT_S and not all(
                c.has_ended_on_ground for c in self.crossers
            ):
                self.advance_one_step()
                if self._steps % 10 == 0 and not should_continue(self):
                    return
        finally:
            self.stop_companions()

    def stop_companions(self) -> None:
        """Stop every companion in an orderly way."""
        for crosser in self.crossers:
            if crosser.companion is not None:
                crosser.companion.stop()

    def advance_one_step(self) -> None:
        """Advance the scene by EXCHANGE_S (0.1 s)."""
        self._steps += 1
        t_s = self.clock.t_s = self._steps * EXCHANGE_S
        for bus in self.buses.values():
            bus.advance_and_run_due_calls(t_s)
        for crosser in self.crossers:
            if not crosser.has_ended_on_ground:
                crosser.drone.advance_and_exchange_messages(t_s, STEPS_PER_EXCHANGE)
                if crosser.companion is not None and crosser.companion.run is not None:
                    pilot = crosser.companion.run.pilot
                    crosser.setpoint_time_s += EXCHANGE_S * pilot.is_on_setpoints
        if self.authorised_s is None and all(c.is_ready for c in self.crossers):
            self.authorised_s = t_s
        if self.authorised_s is not None:
            for crosser in self.crossers:
                if crosser.is_ready and crosser.companion and crosser.companion.run:
                    loop = crosser.companion.run.loop
                    loop.submit_event(MissionAuthorised(loop.clock.t_s, "the truck"))

    def kill_companion(self, vehicle_index: int) -> None:
        """Kill a companion without restarting it."""
        crosser = self.crossers[vehicle_index]
        crosser.drone.kill_companion_and_schedule_restart(self.clock.t_s)
        crosser.drone.companion_due_s = None
        crosser.is_killed = True


def _build_networks(
    options: CrossOptions, bus_seed: np.random.SeedSequence, error_seed: np.random.SeedSequence
) -> dict[str, Bus]:
    """Create one network per fleet, keyed by fleet name."""
    is_multi_fleet, buses = options.fleets > 1, dict[str, Bus]()
    own_seeds = bus_seed.spawn(options.fleets) if is_multi_fleet else [bus_seed]
    error_seeds = error_seed.spawn(options.fleets) if is_multi_fleet else [error_seed]
    for number, (child_seed, errors) in enumerate(zip(own_seeds, error_seeds, strict=True)):
        bus = Bus(np.random.default_rng(child_seed), fleet=f"fleet-{number + 1}")
        bus.track_delay_s = TRACK_DELAY_S
        bus.distort_track = TrackErrorModel(np.random.default_rng(errors))
        buses[bus.fleet] = bus
    for bus in buses.values():
        bus.neighbour_buses = [other for other in buses.values() if other is not bus]
    return buses


def _polar_to_ne_m(radius_m: float, angle_rad: float) -> tuple[float, float]:
    return radius_m * math.cos(angle_rad), radius_m * math.sin(angle_rad)
