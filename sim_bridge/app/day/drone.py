"""One drone of the simulated day: powered off aboard the truck, or standing and flying.

Each time the driver puts it on a pad, it gets a pack from the shelf and boots there, with its
companion. Positions are NED metres about the day's depot; time is the day's.
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
from sim_bridge.app.day.take_over import TakeOver
from sim_bridge.app.flight.operator import Operator
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
LINK, OPERATOR_LINK = 0, 1
COMPANION_BOOT_S = 8.0
"""From power-on to a companion on the network. A Raspberry Pi class computer takes 10 to 20 s; here
it is less, to shorten the wait. The autopilot's own boot is simulated in parallel."""

BOOTED_S = 60.0
"""Time after power-on at which both autopilots' estimators are ready."""

RESTART_S = 6.0
"""systemd's 1 s delay plus the program's start (deploy/leeway-companion-fleet.service)."""


class Companion(Protocol):
    """The drone's companion, in this process or another."""

    def hear(self, datagrams: list[bytes]) -> list[bytes]:
        """Pass the autopilot's datagrams, its TIMESYNC request last; returns the replies."""
        ...

    def kill(self) -> None:
        """SIGKILL."""
        ...

    def stop(self) -> None:
        """Orderly shutdown."""
        ...

    @property
    def running(self) -> bool:
        """False once it has ended."""
        ...


BY_HAND_AFTER_S = 45.0
"""By then the companion has given up its attempts to disarm (`touchdown`) and reported it."""


@dataclass(frozen=True, slots=True)
class Later:
    """The day's mean wind on the time axis of a vehicle powered on at `from_s`."""

    mean: MeanWind
    from_s: float

    def to_ne_mps(self, t_s: float) -> tuple[float, float]:
        """Wind towards north and east, `t_s` after power-on."""
        return self.mean.to_ne_mps(self.from_s + t_s)


@dataclass(frozen=True, slots=True)
class DroneWorld:
    """What all drones of a day share. `site`: depot latitude, longitude (deg), height AMSL (m).

    `air_temperature_c` None: each drone's own temperature.
    """

    site: tuple[float, float, float]
    terrain: Terrain
    wind: WindParams
    mean: MeanWind
    parameters: dict[str, dict[str, Parameter]]
    mavlink_loss: float = 0.0
    air_temperature_c: float | None = None


@dataclass(slots=True)
class PowerUp:
    """One power cycle: vehicle, autopilot, pad and recorded track. `t0_s`: power-on time.

    `rows`: time of day, north, east, down, airborne; five a second, from truth.
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
    taken: TakeOver | None = None
    steps: int = 0
    last_airborne_s: float | None = None
    """Of the newest record that has it in the air: a drone stands for hours, and is asked often."""
    _loaded: bool = False

    @property
    def t_s(self) -> float:
        """Seconds since power-on."""
        return self.steps * PHYSICS_STEP_S

    def load(self, payload_kg: float, order: str | None) -> None:
        """The parcel of another order is on it from now on, or none."""
        self.vehicle.load(payload_kg)
        self.order, self._loaded = order, self.vehicle.parcel_aboard

    def look(self) -> None:
        """Record the true position, and the parcel's release if it happened."""
        vehicle = self.vehicle
        north, east, down = vehicle.pos_ned_m
        t_s = self.t0_s + self.t_s
        if self._loaded and not vehicle.parcel_aboard:
            self.released_s, self.released_ned_m = t_s, (north, east, down)
            self.release_height_m = vehicle.height_m
        self._loaded = vehicle.parcel_aboard
        if vehicle.is_airborne:
            self.last_airborne_s = t_s
        self.rows.append((t_s, north, east, down, float(vehicle.is_airborne)))


@dataclass(slots=True)
class DayDrone:
    """`number` is its MAVLink system id. `up` is None while it is powered off aboard the truck."""

    name: str
    number: int
    autopilot_kind: str
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
    wall_off_s: float = 0.0
    """How far its companion's wall clock is ahead of the day's."""
    ended_by_itself: list[float] = field(default_factory=list)
    """When a companion ended that nobody had killed or switched off."""
    _loss_rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        (child,) = self.seeds.spawn(1)
        self._loss_rng = np.random.default_rng(child)

    # --- the driver's hands --------------------------------------------------------------------

    @property
    def carries_parcel(self) -> bool:
        """Whether the parcel is attached, as the driver sees it."""
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
        """Power on at its pad, with a parcel and a pack from the shelf.

        `booted`: autopilot and companion have already booted.
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
            air_temperature_c=world.air_temperature_c,
            battery_health_frac=self.battery_health_frac,
            depot_alt_amsl_m=world.site[2],
            start_ne_m=pad_ne_m,
        )
        autopilot = Autopilot(
            AutopilotKind(self.autopilot_kind),
            world.site,
            world.parameters[self.autopilot_kind],
            system_id=self.number,
            boot_age_s=BOOTED_S if booted else 0.0,
            epoch_unix_s=EPOCH_US / 1e6 + t_s,  # GNSS time is common to all
        )
        autopilot.add_link(LINK, LinkKind.ONBOARD)
        self.up = PowerUp(t_s, pad_ne_m, order, charge_frac, vehicle, autopilot)
        self.companion_due_s = t_s if booted else t_s + COMPANION_BOOT_S

    def load(self, payload_kg: float, order: str | None) -> None:
        """Put the parcel of an order on it, or take off what is on it; it stands switched on."""
        assert self.up is not None
        self.up.load(payload_kg, order)

    def switch_off(self) -> None:
        """Power off autopilot and companion; an armed autopilot is disarmed by hand first."""
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
        """Fly this many physics steps, then exchange messages; `t_s` is the time after them."""
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
        self._talk(up, t_s)

    def _mind_companion(self, t_s: float) -> None:
        if self.companion is not None and not self.companion.running:
            self.companion = None
            self.companion_due_s = t_s + RESTART_S
            self.ended_by_itself.append(t_s)
        if self.companion_due_s is not None and t_s >= self.companion_due_s:
            self.companion_due_s = None
            self.companion_starts += 1
            self.companion = self.start_companion(self)

    def _talk(self, up: PowerUp, t_s: float) -> None:
        said = _to_companion(up)
        if self.companion is None:
            return
        heard = bundled(frame for frame in said if not self._is_lost())
        up.autopilot.request_timesync(LINK, round(up.t_s * 1e9))
        heard += _to_companion(up)  # sent within the same instant
        if up.taken is not None:
            up.taken.reaches_companion(t_s, heard)
        for datagram in self.companion.hear(heard):
            if up.taken is not None:
                up.taken.leaves_companion(t_s, datagram)
            if not self._is_lost():
                up.autopilot.receive(LINK, datagram)

    def _is_lost(self) -> bool:
        lost = self.world.mavlink_loss > 0.0 and self._loss_rng.random() < self.world.mavlink_loss
        self.lost_frames += lost
        return lost

    def track(self, up: PowerUp, reserve_frac: float) -> VehicleTrack:
        """The track of one power cycle, for the judge."""
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
            autopilot=self.autopilot_kind,
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
            taken_s=None if up.taken is None else up.taken.taken_s,
        )

    def ground_takes_over(self, t_s: float) -> None:
        """A person at a second ground station orders the autopilot home."""
        assert self.up is not None
        self.up.taken = TakeOver(self.autopilot_kind, t_s)
        self._order(Operator(self.number).mode_change(self.autopilot_kind))

    def _order(self, frames: list[bytes]) -> None:
        """What a second ground station tells its autopilot."""
        assert self.up is not None
        autopilot = self.up.autopilot
        autopilot.add_link(OPERATOR_LINK, LinkKind.GCS)
        for frame in frames:
            autopilot.receive(OPERATOR_LINK, frame)

    def disarm(self) -> None:
        """Somebody beside it disarms what has landed and stays armed, and leaves it switched on."""
        self._order(Operator(self.number).disarm())
        self.disarmed_by_hand += 1

    def kill_companion(self, t_s: float) -> None:
        """SIGKILL; it restarts after RESTART_S, as its service does."""
        if self.companion is not None:
            self.companion.kill()
            self.companion = None
            self.companion_due_s = t_s + RESTART_S

    # --- state ---------------------------------------------------------------------------------

    @property
    def power_ups(self) -> list[PowerUp]:
        """Every time that it stood or flew, the present one last."""
        return [*self.past, *([self.up] if self.up is not None else [])]

    @property
    def is_taken_over(self) -> bool:
        """Whether a person has taken it over since it was put out."""
        return self.up is not None and self.up.taken is not None

    @property
    def is_airborne(self) -> bool:
        """Whether it is in the air now."""
        return self.up is not None and self.up.vehicle.is_airborne

    def airborne_s(self, t_s: float) -> float:
        """How long (s) it has been in the air; 0 on the ground."""
        rows = self.up.rows if self.up is not None else []
        began_s = t_s
        for row in reversed(rows):
            if not row[4]:
                break
            began_s = row[0]
        return t_s - began_s

    def standing_at(self, t_s: float, ne_m: tuple[float, float], within_m: float) -> bool:
        """Whether a driver may approach it there: disarmed, or on the ground long enough.

        An ArduCopter that misses its landing (measured, with wind on the ground) stays armed at
        idle, and its companion reports "disarm by hand". The driver then does so.
        """
        up = self.up
        if up is None or self.is_airborne:
            return False
        if up.autopilot.is_armed and self.grounded_s(t_s) < BY_HAND_AFTER_S:
            return False
        return math.dist(up.vehicle.pos_ned_m[:2], ne_m) <= within_m

    def wants_a_hand(self, t_s: float) -> bool:
        """It has landed and stays armed, and its companion has said so: "disarm by hand"."""
        up = self.up
        if up is None or self.is_airborne or not up.autopilot.is_armed:
            return False
        return not up.vehicle.is_crashed and self.grounded_s(t_s) >= BY_HAND_AFTER_S

    def grounded_s(self, t_s: float) -> float:
        """How long (s) it has been on the ground; 0 if it has not flown."""
        last = None if self.up is None else self.up.last_airborne_s
        return t_s - last if last is not None else 0.0


def _to_companion(up: PowerUp) -> list[bytes]:
    return [frame for link, frame in up.autopilot.take_outbox() if link == LINK]
