"""One simulated vehicle from power-up: physics and autopilot, stepped together.

Flights, days and `sim-bridge serve` all run their vehicles with this host.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.adapters.files.params import params_dir
from sim_bridge.autopilot.autopilot import Autopilot
from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing
from sim_bridge.autopilot.mavlink.parameters import read_parameters
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.signals import Truth
from sim_bridge.truth.vehicle import Vehicle
from sim_bridge.truth.wind_field import SteadyWind, WindField

PHYSICS_STEP_S = 0.01
EXCHANGE_S = 0.1
"""Interval between two exchanges of a vehicle with its companion."""

STEPS_PER_EXCHANGE = round(EXCHANGE_S / PHYSICS_STEP_S)
EPOCH_UNIX_S = 1_700_000_000.0
"""Default GNSS time at power-up."""

SAMPLE_STEPS = 20
"""Physics steps between two samples of ground truth."""


@dataclass(frozen=True, slots=True)
class Home:
    """Power-on location of a vehicle: the origin of its positions."""

    lat_deg: float = 55.47
    lon_deg: float = 8.45
    alt_amsl_m: float = 12.0


@dataclass(slots=True)
class VehicleHost:
    """Physics and autopilot of one power cycle; `sample` is called five times a second."""

    vehicle: Vehicle
    autopilot: Autopilot
    steps: int = 0
    sample: Callable[[], None] = lambda: None

    @property
    def t_s(self) -> float:
        """Simulated time since power-up."""
        return self.steps * PHYSICS_STEP_S

    @property
    def truth(self) -> Truth:
        """Ground truth for monitoring and verdicts."""
        return self.vehicle.truth

    def advance(self, physics_steps: int) -> None:
        """Run physics and autopilot for some 100 Hz steps."""
        vehicle, autopilot = self.vehicle, self.autopilot
        for _ in range(physics_steps):
            autopilot.process_readings(
                vehicle.advance_and_read_sensors(autopilot.actuation, PHYSICS_STEP_S),
                PHYSICS_STEP_S,
            )
            self.steps += 1
            if self.steps % SAMPLE_STEPS == 0:
                self.sample()

    def take_sent_frames_by_link(self) -> dict[int, list[bytes]]:
        """Return the frames that the autopilot has sent since the last call, by link."""
        frames: dict[int, list[bytes]] = {}
        for link, frame in self.autopilot.take_frames_to_send():
            frames.setdefault(link, []).append(frame)
        return frames


def true_reserve_wh(
    vehicle: Vehicle,
    airframe: AirframeTruth,
    temperature_c: float,
    battery_health_frac: float,
    reserve_frac: float,
) -> float:
    """Return the true reserve: a share of the full pack's usable energy at hover draw."""
    pack = Battery(airframe.battery, temperature_c=temperature_c, health_frac=battery_health_frac)
    return reserve_frac * pack.usable_wh(vehicle.hover_power_without_parcel_w)


def power_up_vehicle(
    autopilot_kind: AutopilotKind,
    airframe: AirframeTruth,
    settings: Mapping[str, float] | None = None,
    *,
    home: Home = Home(),
    wind_field: WindField | None = None,
    seed: int | np.random.SeedSequence = 1,
    system_id: int = 1,
    receiver_channels_us: tuple[int, ...] | None = None,
    battery_sensing: BatterySensing = BatterySensing.POWER_MODULE,
    boot_age_s: float = 0.0,
    epoch_unix_s: float = EPOCH_UNIX_S,
    **vehicle_options: Any,
) -> VehicleHost:
    """Power up a vehicle of this airframe at `home`, with this autopilot.

    `settings`: parameters that differ from the defaults. Without `wind_field` the air is still.
    `receiver_channels_us`: channels (us) of an active radio control. `vehicle_options`: further
    arguments of `Vehicle`.
    """
    physics = Vehicle(
        airframe,
        wind_field or WindField(SteadyWind(0.0, 0.0)),
        np.random.default_rng(seed),
        depot_alt_amsl_m=home.alt_amsl_m,
        **vehicle_options,
    )
    autopilot = Autopilot(
        autopilot_kind,
        (home.lat_deg, home.lon_deg, home.alt_amsl_m),
        read_parameters(params_dir() / "autopilots" / f"{autopilot_kind.value}.toml", settings),
        system_id=system_id,
        battery_sensing=battery_sensing,
        boot_age_s=boot_age_s,
        epoch_unix_s=epoch_unix_s,
    )
    autopilot.set_receiver_channels(receiver_channels_us)
    return VehicleHost(physics, autopilot)
