"""Builds the simulated vehicles and companions of a run from options and a flight file."""

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.params import (
    params_dir,
    read_flight,
)
from companion.core.base.errors import LeewayError
from companion.core.base.geo import offset_position_deg
from companion.core.base.location import Location
from companion.core.base.plugin import WIND_ESTIMATORS, load_plugin
from companion.core.mission.flight_file import Flight
from sim_bridge.adapters.fork_server import ForkServer
from sim_bridge.adapters.wall_clock import mavlink_signing_time_10us
from sim_bridge.app.flight.companion_process import CompanionProcess
from sim_bridge.app.flight.scenario import read_or_draw_true_wind
from sim_bridge.app.flight.vehicle_process import Craft, build_terrain
from sim_bridge.app.link.operator import Operator
from sim_bridge.app.world.companion_link import COMPANION_LINK, OPERATOR_LINK
from sim_bridge.app.world.vehicle_host import Home, power_up_vehicle
from sim_bridge.autopilot.kinds import AUTOPILOTS, AutopilotKind, BatterySensing, LinkKind
from sim_bridge.autopilot.mavlink.signing import LinkSigning, Signing
from sim_bridge.truth.params import AirframeTruth, load_airframe
from sim_bridge.truth.wind_field import MeanWind
from sim_bridge.truth.wind_params import build_wind_field

DEFAULT_HOME = Location(lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0)
VEHICLE_SPACING_M = 40.0


@dataclass(frozen=True, slots=True)
class FlyOptions:
    """Options from the command line. `speedup` None runs at the maximum speed of the machine.

    `companion_airframe` is the companion's airframe, a name or a file; None: the true airframe.
    `companion_flight_file` is the flight file of a single vehicle's companion; None: the file of
    the world. With `signing_key` (a file of 32 bytes) the companion's link is signed. The companion
    is then authorised on its command line, because the operator's frames are unsigned.
    `companion_startup_code` is Python code that runs before the companion's `main`, e.g. to
    simulate a slow disk.
    """

    flight_file: Path
    autopilot: str = "px4"
    seed: int = 1
    wind_log: Path | None = None
    gate: bool = True
    vehicles: int = 1
    speedup: float | None = None
    run_root: Path = Path("logs")
    picture: bool = True
    lockstep_limit_s: float = 20.0
    companion_airframe: str | None = None
    companion_flight_file: Path | None = None
    signing_key: Path | None = None
    estimator: str | None = None
    """Wind estimator of the companions, a plug-in; None: their own."""
    mean_wind: MeanWind | None = None
    """True mean wind in place of the flight file's."""
    companion_startup_code: str = ""
    companion_arguments: tuple[str, ...] = ()
    """Additional options for `companion run`."""
    settings: Mapping[str, float] = field(default_factory=dict)
    """Autopilot parameters that differ from the defaults."""
    battery_sensing: BatterySensing = BatterySensing.POWER_MODULE
    fork_server: ForkServer | None = None
    """Fork server for companions in suites of many flights; None: start a new interpreter."""


def _autopilot_kind_of(options: FlyOptions, vehicle_index: int) -> str:
    return AUTOPILOTS[vehicle_index % 2] if options.autopilot == "mixed" else options.autopilot


def build_craft(
    options: FlyOptions,
    flight: Flight,
    wind_params: Any,
    mean_wind_field: Any,
    vehicle_index: int,
    seed: np.random.SeedSequence,
    companion_link_url: str,
    run_dir: Path,
    *,
    has_kill_fault: bool = False,
) -> Craft:
    """Build one vehicle of a run; its companion will connect to `companion_link_url`."""
    gust_seed, sensor_seed, charge_seed = seed.spawn(3)
    charge_frac = _draw_charge_frac(flight, np.random.default_rng(charge_seed))
    autopilot_kind = _autopilot_kind_of(options, vehicle_index)
    number = vehicle_index + 1
    depot = _shift_north(flight.site.depot or DEFAULT_HOME, VEHICLE_SPACING_M * vehicle_index)
    vehicle_dir = run_dir if options.vehicles == 1 else run_dir / f"vehicle{number}"
    vehicle_dir.mkdir(exist_ok=True)
    mission_file = options.companion_flight_file or options.flight_file
    if vehicle_index > 0:  # a separate depot, so that the vehicles of a run never share a route
        mission_file = _write_flight_file_with_depot(options.flight_file, depot, vehicle_dir)
    terrain = build_terrain(flight.site.terrain, options.flight_file.parent)
    host = power_up_vehicle(
        AutopilotKind(autopilot_kind),
        read_true_airframe(flight),
        options.settings,
        home=Home(depot.lat_deg or 0.0, depot.lon_deg or 0.0, depot.alt_amsl_m or 0.0),
        wind_field=build_wind_field(wind_params, mean_wind_field, np.random.default_rng(gust_seed)),
        seed=sensor_seed,
        system_id=number,
        terrain=terrain,
        payload_kg=flight.vehicle.payload_kg,
        charge_frac=charge_frac,
        temperature_c=flight.vehicle.temperature_c,
        air_temperature_c=flight.site.air_temperature_c,
        battery_health_frac=flight.vehicle.battery_health_frac,
        pitot=flight.vehicle.pitot,
        battery_sensing=options.battery_sensing,
    )
    signing = _link_signing(options.signing_key)
    host.autopilot.add_link(COMPANION_LINK, LinkKind.ONBOARD, signer=signing)
    host.autopilot.add_link(OPERATOR_LINK, LinkKind.GCS)
    companion = CompanionProcess(
        run_dir=vehicle_dir,
        arguments=[
            f"--link={companion_link_url}",
            f"--airframe={options.companion_airframe or flight.vehicle.airframe}",
            f"--mission={mission_file}",
            f"--gate={'on' if options.gate else 'off'}",
            "--configure",
            f"--vehicle-settings={vehicle_dir / 'vehicle_settings'}",
            f"--monitor={vehicle_dir / 'monitor'}",
            *_companion_signing_arguments(options.signing_key),
            "--lockstep",
            *(["--record-at-once"] if has_kill_fault else []),
            *options.companion_arguments,
        ],
        startup_code=_estimator_startup_code(options.estimator) + options.companion_startup_code,
        fork_server=options.fork_server,
    )
    return Craft(
        number=number,
        autopilot_kind=autopilot_kind,
        flight=flight,
        charge_frac=charge_frac,
        depot=depot,
        host=host,
        terrain=terrain,
        operator=Operator(number),
        companion=companion,
        run_dir=vehicle_dir,
    )


def build_single_craft(options: FlyOptions, companion_link_url: str, run_dir: Path) -> Craft:
    """Build the only vehicle of a flight whose steps a trial runs itself."""
    flight = read_flight(options.flight_file)
    wind_seed, vehicle_seed = np.random.SeedSequence(options.seed).spawn(2)
    wind, mean = read_or_draw_true_wind(
        flight, options.flight_file, np.random.default_rng(wind_seed), options.wind_log
    )
    return build_craft(options, flight, wind, mean, 0, vehicle_seed, companion_link_url, run_dir)


def _estimator_startup_code(estimator: str | None) -> str:
    """Return code that replaces the wind estimator of a companion: it has no option for that."""
    if estimator is None:
        return ""
    load_plugin(WIND_ESTIMATORS, estimator)  # here, an error is reported before the flight
    return (
        "from companion.core.pilot import estimates\n"
        "from companion.core.wind.checked_filter import checked_filter_factory\n"
        f"estimates.WindEstimator = checked_filter_factory({estimator!r})\n"
    )


def read_true_airframe(flight: Flight) -> AirframeTruth:
    """Return the truth of the flight's airframe. Raise LeewayError if it is not simulated."""
    folder, name = params_dir() / "truth", flight.vehicle.airframe
    if not (folder / f"{name}.toml").exists():
        known = ", ".join(sorted(path.stem for path in folder.glob("*.toml")))
        raise LeewayError(
            f"vehicle.airframe {name}: expected a simulated airframe ({known}); use"
            " --link to fly an external vehicle"
        )
    return load_airframe(folder / f"{name}.toml")


ONE_MINUTE_10US = 6_000_000
"""ArduPilot starts a minute after its stored time stamp (`GCS_Signing.cpp`)."""


def _link_signing(signing_key_file: Path | None) -> LinkSigning | None:
    return (
        None
        if signing_key_file is None
        else Signing(
            signing_key_file.read_bytes(), mavlink_signing_time_10us() + ONE_MINUTE_10US
        ).link_signer(0)
    )


def _companion_signing_arguments(signing_key_file: Path | None) -> list[str]:
    return (
        []
        if signing_key_file is None
        else [f"--signing-key={signing_key_file}", "--authorise", "--no-operator"]
    )


def _draw_charge_frac(flight: Flight, rng: np.random.Generator) -> float:
    charge = flight.vehicle.charge_frac
    return float(rng.uniform(charge[0], charge[1])) if isinstance(charge, list) else charge


def _shift_north(depot: Location, north_m: float) -> Location:
    if north_m == 0.0:
        return depot
    lat_deg, _ = offset_position_deg(depot.lat_deg or 0.0, depot.lon_deg or 0.0, north_m, 0.0)
    return msgspec.structs.replace(depot, lat_deg=float(lat_deg))


def _write_flight_file_with_depot(flight_file: Path, depot: Location, vehicle_dir: Path) -> Path:
    table = tomllib.loads(flight_file.read_text())
    table["site"]["depot"] = {
        "lat_deg": depot.lat_deg,
        "lon_deg": depot.lon_deg,
        "alt_amsl_m": depot.alt_amsl_m,
    }
    for holder, key in ((table["site"], "obstacles"), (table["site"].get("terrain", {}), "grid")):
        if key in holder:
            holder[key] = os.path.abspath(flight_file.parent / holder[key])
    path = vehicle_dir / "flight.toml"
    path.write_bytes(msgspec.toml.encode(table))
    return path
