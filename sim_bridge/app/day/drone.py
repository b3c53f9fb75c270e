"""One drone of the simulated day: switched off aboard the truck, or standing and flying by itself.

Whenever the driver puts it on a pad it has a pack from the shelf, boots there, and its companion
with it. Positions are NED metres about the day's depot, time is the day's.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from sim_bridge.adapters.endpoint import bundled
from sim_bridge.app.day.clock import EPOCH_US
from sim_bridge.app.day.judge import VehicleTrack
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.kinds import AutopilotKind, LinkKind
from sim_bridge.autopilot.mavlink.parameters import Parameter
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.terrain import Terrain
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import MeanWind
from sim_bridge.truth.wind_params import WindParams, build_wind_field

PHYSICS_STEP_S = 0.01
RECORD_EVERY_STEPS = 20
LINK = 0
COMPANION_BOOT_S = 8.0
"""From power to a companion that is on the network: a Raspberry Pi class computer takes 10 to 20 s,
the autopilot's own boot is simulated beside it; less here because everybody waits for it."""

BOOTED_S = 60.0
"""A minute after power: both autopilots' estimators are ready."""

RESTART_S = 6.0
"""systemd's second, and the program's start (deploy/leeway-companion-fleet.service)."""


class Companion(Protocol):
    """What flies the drone, in this process or another."""

    def hear(self, datagrams: list[bytes]) -> list[bytes]:
        """Datagrams of the autopilot, its TIMESYNC request last; what is said in answer."""
        ...

    def kill(self) -> None:
        """SIGKILL."""
        ...

    def stop(self) -> None:
        """In order."""
        ...

    @property
    def running(self) -> bool:
        """False once it has ended."""
        ...


BY_HAND_AFTER_S = 45.0
"""The companion gives up its own tries to disarm before (`touchdown`), and says so."""


@dataclass(frozen=True, slots=True)
class Later:
    """The day's mean wind as a vehicle sees it that was switched on at `from_s`."""

    mean: MeanWind
    from_s: float

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        """Where the air moves to, north and east, `t_s` after switching on."""
        return self.mean.to_ne_mps(self.from_s + t_s)


@dataclass(frozen=True, slots=True)
class DroneWorld:
    """What all drones of a day share. `site`: latitude, longitude, height AMSL of the depot."""

    site: tuple[float, float, float]
    terrain: Terrain
    wind: WindParams
    mean: MeanWind
    parameters: dict[str, dict[str, Parameter]]
    mavlink_loss: float = 0.0


@dataclass(slots=True)
class PowerUp:
    """From one battery to the next: what flew then, and where it stood. `t0_s`: switched on.

    `rows`: time of the day, north, east, down, airborne; five a second, from truth.
    """

    t0_s: float
    pad_ne_m: tuple[float, float]
    order: str | None
    charge_frac: float
    vehicle: Vehicle
    autopilot: Autopilot
    rows: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    released_s: float | None = None
    released_ned_m: tuple[float, float, float] | None = None
    release_height_m: float | None = None
    steps: int = 0
    _loaded: bool = False

    @property
    def t_s(self) -> float:
        """Since switched on."""
        return self.steps * PHYSICS_STEP_S

    def look(self) -> None:
        """Write down where it truly is, and note its parcel's release."""
        vehicle = self.vehicle
        north, east, down = vehicle.pos_ned_m
        t_s = self.t0_s + self.t_s
        if self._loaded and not vehicle.parcel_aboard:
            self.released_s, self.released_ned_m = t_s, (north, east, down)
            self.release_height_m = vehicle.height_m
        self._loaded = vehicle.parcel_aboard
        self.rows.append((t_s, north, east, down, float(vehicle.is_airborne)))


@dataclass(slots=True)
class DayDrone:
    """`number` is its MAVLink system. `up` is None while it is switched off, aboard the truck."""

    name: str
    number: int
    flavour: str
    airframe: AirframeTruth
    temperature_c: float
    battery_health_frac: float
    shelf_frac: tuple[float, float]
    world: DroneWorld
    folder: Path
    seeds: np.random.SeedSequence
    start_companion: Callable[["DayDrone"], Companion]
    companion: Companion | None = None
    up: PowerUp | None = None
    past: list[PowerUp] = field(default_factory=list)
    companion_starts: int = 0
    companion_due_s: float | None = None
    lost_frames: int = 0
    disarmed_by_hand: int = 0
    _loss_rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        (child,) = self.seeds.spawn(1)
        self._loss_rng = np.random.default_rng(child)

    # --- the driver's hands --------------------------------------------------------------------

    @property
    def carries_parcel(self) -> bool:
        """As the driver sees it."""
        return self.up is not None and self.up.vehicle.parcel_aboard

    def switch_on(
        self,
        t_s: float,
        pad_ne_m: tuple[float, float],
        payload_kg: float,
        order: str | None,
        *,
        booted: bool = False,
    ) -> None:
        """On its pad, with a parcel and a pack from the shelf.

        `booted`: as if for a while, autopilot and companion with it.
        """
        self.switch_off()
        charge_seed, gust_seed, sensor_seed = self.seeds.spawn(3)
        charge_frac = float(np.random.default_rng(charge_seed).uniform(*self.shelf_frac))
        world = self.world
        wind = build_wind_field(
            world.wind, Later(world.mean, t_s), np.random.default_rng(gust_seed)
        )
        vehicle = Vehicle(
            self.airframe,
            wind,
            np.random.default_rng(sensor_seed),
            terrain=world.terrain,
            payload_kg=payload_kg,
            charge_frac=charge_frac,
            temperature_c=self.temperature_c,
            battery_health_frac=self.battery_health_frac,
            depot_alt_amsl_m=world.site[2],
            start_ne_m=pad_ne_m,
        )
        autopilot = Autopilot(
            AutopilotKind(self.flavour),
            world.site,
            world.parameters[self.flavour],
            system_id=self.number,
            boot_age_s=BOOTED_S if booted else 0.0,
            epoch_unix_s=EPOCH_US / 1e6 + t_s,  # satellites tell all the same time
        )
        autopilot.add_link(LINK, LinkKind.ONBOARD)
        self.up = PowerUp(t_s, pad_ne_m, order, charge_frac, vehicle, autopilot)
        self.companion_due_s = t_s if booted else t_s + COMPANION_BOOT_S

    def switch_off(self) -> None:
        """Power off: autopilot and companion with it; an armed one is disarmed by hand first."""
        self.disarmed_by_hand += self.up is not None and self.up.autopilot.is_armed
        if self.companion is not None:
            self.companion.kill()
            self.companion = None
        self.companion_due_s = None
        if self.up is not None:
            self.past.append(self.up)
            self.up = None

    # --- time ----------------------------------------------------------------------------------

    def advance(self, t_s: float, steps: int) -> None:
        """Fly so many physical steps, then let autopilot and companion talk; `t_s` is then."""
        up = self.up
        if up is None:
            return
        vehicle, autopilot = up.vehicle, up.autopilot
        for _ in range(steps):
            autopilot.step(vehicle.step(autopilot.actuation, PHYSICS_STEP_S), PHYSICS_STEP_S)
            up.steps += 1
            if up.steps % RECORD_EVERY_STEPS == 0:
                up.look()
        self._mind_companion(t_s)
        self._talk(up)

    def _mind_companion(self, t_s: float) -> None:
        if self.companion is not None and not self.companion.running:
            self.companion = None
            self.companion_due_s = t_s + RESTART_S
        if self.companion_due_s is not None and t_s >= self.companion_due_s:
            self.companion_due_s = None
            self.companion_starts += 1
            self.companion = self.start_companion(self)

    def _talk(self, up: PowerUp) -> None:
        said = [frame for _, frame in up.autopilot.take_outbox()]
        if self.companion is None:
            return
        heard = bundled(frame for frame in said if not self._is_lost())
        up.autopilot.request_timesync(LINK, round(up.t_s * 1e9))
        heard += [frame for _, frame in up.autopilot.take_outbox()]  # time stands still for it
        for datagram in self.companion.hear(heard):
            if not self._is_lost():
                up.autopilot.receive(LINK, datagram)

    def _is_lost(self) -> bool:
        lost = self.world.mavlink_loss > 0.0 and self._loss_rng.random() < self.world.mavlink_loss
        self.lost_frames += lost
        return lost

    def track(self, up: PowerUp, reserve_frac: float) -> VehicleTrack:
        """What one pack's time came to, for the judge."""
        rows = np.asarray(up.rows, float).reshape(-1, 5)
        truth = up.vehicle.truth
        pack = Battery(
            self.airframe.battery,
            temperature_c=self.temperature_c,
            health_frac=self.battery_health_frac,
        )
        reserve_wh = reserve_frac * pack.usable_wh(up.vehicle.reference_draw_w)
        return VehicleTrack(
            vehicle=self.name,
            autopilot=self.flavour,
            order=up.order,
            pad_ne_m=up.pad_ne_m,
            t_s=rows[:, 0],
            ned_m=rows[:, 1:4],
            airborne=rows[:, 4],
            energy_used_wh=truth.energy_used_wh,
            margin_wh=truth.usable_wh - reserve_wh,
            crashed=truth.crashed,
            released_s=up.released_s,
            released_ned_m=up.released_ned_m,
            release_height_m=up.release_height_m,
        )

    def kill_companion(self, t_s: float) -> None:
        """SIGKILL; it starts again as its service does."""
        if self.companion is not None:
            self.companion.kill()
            self.companion = None
            self.companion_due_s = t_s + RESTART_S

    # --- what is so ----------------------------------------------------------------------------

    @property
    def is_airborne(self) -> bool:
        """Whether it flies now."""
        return self.up is not None and self.up.vehicle.is_airborne

    def airborne_s(self, t_s: float) -> float:
        """For how long it has been in the air now."""
        rows = self.up.rows if self.up is not None else []
        began_s = t_s
        for row in reversed(rows):
            if not row[4]:
                break
            began_s = row[0]
        return t_s - began_s

    def standing_at(self, t_s: float, ne_m: tuple[float, float], within_m: float) -> bool:
        """Whether a driver may walk up to it there: disarmed, or on the ground for a while.

        An ArduCopter that never notices its landing (measured, wind on the ground) stays armed at
        idle, and its companion says "disarm by hand": that is what the driver then does.
        """
        up = self.up
        if up is None or self.is_airborne:
            return False
        if up.autopilot.is_armed and self.grounded_s(t_s) < BY_HAND_AFTER_S:
            return False
        return math.dist(up.vehicle.pos_ned_m[:2], ne_m) <= within_m

    def grounded_s(self, t_s: float) -> float:
        """For how long it has been on the ground now."""
        rows = self.up.rows if self.up is not None else []
        last = next((row[0] for row in reversed(rows) if row[4]), None)
        return t_s - last if last is not None else 0.0
