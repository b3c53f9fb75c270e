"""Vehicles that leave one truck at once, in one layer, and cross each other's paths.

Slots and layers are left out on purpose. Only the tracks that companions exchange, and the
set-points that they fly near neighbours, keep the vehicles apart (docs/explanation/avoidance.md).
The drones, the network and the stepped clock are those of the simulated day; there is no desk.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import params_dir, read_airframe
from companion.app.flight.fleet_port import FleetPort
from companion.app.flight.loaded_flight import LoadedFlight, RunOptions
from companion.app.flight.run import Run
from companion.core.base.geo import LocalFrame, moved_deg
from companion.core.mission.events import Authorised
from companion.core.pilot.context import PilotOptions
from companion.core.pilot.transitions import Phase
from companion.core.separation.track import Track as Told
from companion.fleet.messages import decode_track, encode
from sim_bridge.app.day.bus import Bus
from sim_bridge.app.day.clock import DayClock
from sim_bridge.app.day.companion import MemoryLink
from sim_bridge.app.day.drone import Companion, DayDrone, DroneWorld
from sim_bridge.app.day.faults import AUTOPILOTS
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.terrain import PlaneTerrain
from sim_bridge.truth.wind_params import RampedWindParams, WindPoint, mean_wind

SITE = (55.47, 8.45, 12.0)
AIRFRAME = "m100"
RING_M = 46.0
"""From the truck to each pad; eight are then 35 m from each other."""

CUSTOMER_M = 100.0
"""From the truck to each customer, on the far side: all ways lead past the truck."""

ASTRAY_RAD = math.radians(20.0)
"""How far a customer may lie from straight across."""

WIND_MAX_MPS = 6.0
WANDER_S = 30.0
"""Correlation time of the errors in neighbours' tracks: GNSS errors wander slowly, so averaging
does not help."""

VERTICAL_SHARE = 0.25
"""Of the horizontal error: heights come from barometers."""

PAYLOAD_KG = 0.3
STEP_S = 0.1
STEPS = 10
LIMIT_S = 420.0


@dataclass(frozen=True, slots=True)
class CrossOptions:
    """`late_s`, `off_m`: delay and error of neighbours' tracks (1 sigma a horizontal axis).

    `fleets`: how many they are of, by turns; each fleet has a network and names of its own, and
    (`neighbours`) hears the others'. `keep_apart` False: missions only. `separation_filter` False:
    set-points that are what is wished, by `policy` (a learned actor) or straight on. Pads and
    customers lie so far from the truck, customers at most so far from straight across.
    """

    vehicles: int = 8
    autopilot: str = "mixed"
    seed: int = 1
    late_s: float = 0.2
    off_m: float = 2.0
    fleets: int = 1
    neighbours: bool = True
    keep_apart: bool = True
    separation_filter: bool = True
    policy: str | None = None
    ring_m: float = RING_M
    customer_m: float = CUSTOMER_M
    astray_rad: float = ASTRAY_RAD
    cruise_height_m: float = 30.0
    run_root: Path = Path("logs")


@dataclass(slots=True)
class LoneCompanion:
    """A companion of the fleet with a mission of its own, stepped in this process."""

    port: FleetPort
    link: MemoryLink
    run: Run
    ended: int | None = None
    running: bool = True
    """For the drone: this companion is not started again when its mission is over."""

    @property
    def phase(self) -> Phase:
        """What it does."""
        return self.run.pilot.phase

    def authorise(self) -> None:
        """The operator authorises the mission."""
        self.run.loop.ask(Authorised(self.run.loop.clock.t_s, "the truck"))

    def hear(self, datagrams: list[bytes]) -> list[bytes]:
        """Take these datagrams; the datagrams for the autopilot in answer."""
        self.link.heard.extend(datagrams)
        while self.ended is None:
            code = self.run.step()
            if code is not None:
                self.run.end(code)
                self.ended = code
                self.port.close()
            if not self.link.heard:
                break
        said, self.link.said = self.link.said, []
        return said

    def kill(self) -> None:
        """As a computer that loses its power."""
        if self.ended is None:
            self.ended = 9
            self.port.close()
            self.run.recorder.close()
            self.run.lock.release()

    def stop(self) -> None:
        """In order."""
        if self.ended is None:
            self.run.end(0)
            self.ended = 0
            self.port.close()


@dataclass(slots=True)
class Crosser:
    """One vehicle of the scene; `truth` has a row (t, north, east, down, airborne) each step."""

    drone: DayDrone
    fleet: str
    pad_ne_m: tuple[float, float]
    customer_ne_m: tuple[float, float]
    companion: LoneCompanion | None = None
    truth: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    aside_s: float = 0.0
    dead: bool = False

    @property
    def name(self) -> str:
        """Among all fleets."""
        return self.drone.folder.name

    @property
    def is_ready(self) -> bool:
        """Mission aboard and read back."""
        return self.companion is not None and self.companion.phase is Phase.READY

    @property
    def is_over(self) -> bool:
        """It stands on the ground and will not fly again."""
        ended = self.dead or (self.companion is not None and self.companion.ended is not None)
        return ended and not self.drone.is_airborne


class Spoiler:
    """Adds wandering errors to the tracks that neighbours receive."""

    def __init__(self, off_m: float, rng: np.random.Generator) -> None:
        self._std = np.array([off_m, off_m, VERTICAL_SHARE * off_m])
        self._rng = rng
        self._off: dict[str, tuple[float, np.ndarray]] = {}

    def __call__(self, raw: bytes, t_s: float) -> bytes:
        """The same track with its sender's present GNSS error."""
        told = decode_track(raw)
        if not isinstance(told, Told):
            return raw
        before_s, off = self._off.get(told.vehicle, (t_s, self._std * self._rng.standard_normal(3)))
        keep = math.exp(-(t_s - before_s) / WANDER_S)
        off = keep * off + math.sqrt(1.0 - keep**2) * self._std * self._rng.standard_normal(3)
        self._off[told.vehicle] = (t_s, off)
        north, east, down = (float(x) for x in off)
        lat, lon = (float(x) for x in moved_deg(told.lat_deg, told.lon_deg, north, east))
        return encode(
            msgspec.structs.replace(
                told, lat_deg=lat, lon_deg=lon, alt_amsl_m=told.alt_amsl_m - down
            )
        )


class Crossing:
    """The scene: `run` it to its end, then look at `crossers`."""

    def __init__(self, options: CrossOptions, folder: Path) -> None:
        self.options, self.folder = options, folder
        self.clock = DayClock()
        seeds = np.random.SeedSequence(options.seed).spawn(4)
        scene_seed, bus_seed, error_seed, drone_seed = seeds
        self.buses = _networks(options, bus_seed, error_seed)
        self.airframe = read_airframe(AIRFRAME)
        self.authorised_s: float | None = None
        self.crossers = self._crossers(np.random.default_rng(scene_seed), drone_seed)
        self._steps = 0

    # --- building ------------------------------------------------------------------------------

    def _crossers(self, rng: np.random.Generator, seed: np.random.SeedSequence) -> list[Crosser]:
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
            mean=mean_wind(wind, Path()),
            parameters={
                f: read_parameters(params_dir() / "autopilots" / f"{f}.toml") for f in AUTOPILOTS
            },
        )
        truth = load_airframe(params_dir() / "truth" / f"{AIRFRAME}.toml")
        turn = float(rng.uniform(0.0, 2.0 * math.pi))
        found: list[Crosser] = []
        for k, own in enumerate(seed.spawn(count)):
            angle = turn + 2.0 * math.pi * k / count
            across = angle + math.pi + float(rng.uniform(-1.0, 1.0)) * self.options.astray_rad
            fleet = list(self.buses)[k % len(self.buses)]
            name = f"d{k // len(self.buses) + 1}"  # the same in each fleet
            alone = len(self.buses) == 1
            drone = DayDrone(
                name=name,
                number=k + 1,
                autopilot_kind=self._autopilot_kind(k),
                airframe=truth,
                temperature_c=20.0,
                battery_health_frac=1.0,
                shelf_frac=(0.9, 0.95),
                world=world,
                folder=self.folder / (name if alone else f"{fleet}-{name}"),
                seeds=own,
                start_companion=self._start,
            )
            found.append(
                Crosser(
                    drone,
                    fleet,
                    _polar(self.options.ring_m, angle),
                    _polar(self.options.customer_m, across),
                )
            )
        for crosser in found:
            drone = crosser.drone
            drone.switch_on(0.0, crosser.pad_ne_m, PAYLOAD_KG, drone.name, booted=True)
        return found

    def _autopilot_kind(self, k: int) -> str:
        return AUTOPILOTS[k % 2] if self.options.autopilot == "mixed" else self.options.autopilot

    def _start(self, drone: DayDrone) -> Companion:
        crosser = next(c for c in self.crossers if c.drone is drone)
        link = MemoryLink()
        port = FleetPort.open(
            drone.name,
            AIRFRAME,
            self.airframe,
            drone.folder,
            lambda life: self.buses[crosser.fleet].join(drone.name, life),
            self.clock.monotonic_s,
            self.clock.epoch_us,
        )
        options = RunOptions(
            link="memory",
            airframe=AIRFRAME,
            mission=self._flight_file(crosser),
            run_dir=drone.folder,
            policy=self.options.policy,
            plan_at_once=True,
            record_at_once=True,
            pilot=PilotOptions(
                configure=True,
                keep_apart=self.options.keep_apart,
                separation_filter=self.options.separation_filter,
                name=drone.name,
                fleet=crosser.fleet,
            ),
        )
        run = Run.begin(
            LoadedFlight.read(options),
            lambda url: link,
            port=port,
            wall_clock_s=self.clock.monotonic_s,
        )
        crosser.companion = LoneCompanion(port, link, run)
        return crosser.companion

    def _flight_file(self, crosser: Crosser) -> Path:
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
                "drop_height_m": 15.0,
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

    def run(self, goes_on: Callable[["Crossing"], bool] = lambda _: True) -> None:
        """Until all are down, or `LIMIT_S`; `goes_on` is asked once a second."""
        try:
            while self.clock.t_s < LIMIT_S and not all(c.is_over for c in self.crossers):
                self.step()
                if self._steps % 10 == 0 and not goes_on(self):
                    return
        finally:
            self.close()

    def close(self) -> None:
        """End every companion, in order."""
        for crosser in self.crossers:
            if crosser.companion is not None:
                crosser.companion.stop()

    def step(self) -> None:
        """A tenth of a second."""
        self._steps += 1
        t_s = self.clock.t_s = self._steps * STEP_S
        for bus in self.buses.values():
            bus.deliver(t_s)
        for crosser in self.crossers:
            if not crosser.is_over:
                crosser.drone.advance(t_s, STEPS)
                self._look(crosser, t_s)
        if self.authorised_s is None and all(c.is_ready for c in self.crossers):
            self.authorised_s = t_s
        if self.authorised_s is not None:
            for crosser in self.crossers:
                if crosser.is_ready and crosser.companion is not None:
                    crosser.companion.authorise()

    def kill(self, number: int) -> None:
        """A companion dies, and is not started again."""
        crosser = self.crossers[number]
        crosser.drone.kill_companion(self.clock.t_s)
        crosser.drone.companion_due_s = None
        crosser.dead = True

    def _look(self, crosser: Crosser, t_s: float) -> None:
        up = crosser.drone.up
        if up is None:
            return
        vehicle = up.vehicle
        north, east, down = vehicle.pos_ned_m
        crosser.truth.append((t_s, north, east, down, float(vehicle.is_airborne)))
        if crosser.companion is not None and crosser.companion.ended is None:
            crosser.aside_s += STEP_S * crosser.companion.run.pilot.on_setpoints


def _networks(
    options: CrossOptions, bus_seed: np.random.SeedSequence, error_seed: np.random.SeedSequence
) -> dict[str, Bus]:
    """A network for each fleet, by its name."""
    several, buses = options.fleets > 1, dict[str, Bus]()
    own_seeds = bus_seed.spawn(options.fleets) if several else [bus_seed]
    error_seeds = error_seed.spawn(options.fleets) if several else [error_seed]
    for number, (own, errors) in enumerate(zip(own_seeds, error_seeds, strict=True)):
        bus = Bus(np.random.default_rng(own), fleet=f"fleet-{number + 1}")
        bus.track_delay_s = options.late_s
        if options.off_m > 0.0:
            bus.spoil = Spoiler(options.off_m, np.random.default_rng(errors))
        buses[bus.fleet] = bus
    for bus in buses.values():
        bus.beside = [other for other in buses.values() if other is not bus]
    return buses


def _polar(radius_m: float, angle_rad: float) -> tuple[float, float]:
    return radius_m * math.cos(angle_rad), radius_m * math.sin(angle_rad)
