"""`sim-bridge serve`: simulated vehicles for any MAVLink program, or one that flies a plan."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import (
    command_class_with_options,
    require_options_not_given,
)
from sim_bridge.app.cli.options import run_options
from sim_bridge.autopilot.kinds import AUTOPILOTS

if TYPE_CHECKING:
    from rich.console import Console

    from sim_bridge.app.world.vehicle_host import Home
    from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing
    from sim_bridge.truth.params import AirframeTruth
    from sim_bridge.truth.wind_field import WindField

app = typer.Typer()

TCP_STRIDE = 10
"""ArduPilot's SITL gives instance N the port 5760 + 10 N."""

PARCEL_KG = 0.4
"""A parcel whose release shows: without one no delivery can be proven."""

SPACING_M = 21.0  # as pads on which drones may climb and descend at once


def home_offset_ne_m(vehicle_index: int) -> tuple[float, float]:
    """Return the offset of a vehicle's home, on rings of six: a desk at the first serves seven."""
    radius_m, angle = SPACING_M * ((vehicle_index + 5) // 6), math.tau * vehicle_index / 6
    return radius_m * math.cos(angle), radius_m * math.sin(angle)


@dataclass(frozen=True, slots=True)
class Ports:
    """Where a vehicle is found; 0 leaves a way out. Vehicles count up from the first's."""

    host: str
    onboard: int
    ground: int
    tcp: int

    def onboard_urls(self, vehicle_index: int) -> list[str]:
        """A companion or MAVSDK listens here."""
        return [f"udpout:{self.host}:{self.onboard + vehicle_index}"] if self.onboard else []

    def ground_urls(self, vehicle_index: int) -> list[str]:
        """QGroundControl listens on one port for all; TCP is served, a port a vehicle."""
        udp = [f"udpout:{self.host}:{self.ground}"] if self.ground else []
        tcp = [f"tcpin:{self.host}:{self.tcp + TCP_STRIDE * vehicle_index}"] if self.tcp else []
        return [*udp, *tcp]


def _select_autopilot(autopilot: str, vehicle_index: int) -> str:
    if autopilot == "mixed":
        return AUTOPILOTS[vehicle_index % 2]
    if autopilot not in AUTOPILOTS:
        raise LeewayError(f"--autopilot {autopilot}: expected px4, ardupilot or mixed")
    return autopilot


def _parse_battery_sensing(battery: str, kind: "AutopilotKind") -> "BatterySensing":
    from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing

    known = [sensing.value for sensing in BatterySensing]
    if battery not in known:
        raise LeewayError(f"--battery {battery}: expected {' or '.join(known)}")
    sensing = BatterySensing(battery)
    if sensing is BatterySensing.SIH_TIMER and kind is not AutopilotKind.PX4:
        raise LeewayError(f"--battery {battery}: {kind.value} has none, expected --autopilot px4")
    return sensing


def _parse_home(text: str) -> "Home":
    from sim_bridge.app.world.vehicle_host import Home

    try:
        lat_deg, lon_deg, alt_amsl_m = map(float, text.split(","))
    except ValueError as error:
        raise LeewayError(f"--home {text}: expected LAT,LON,ALT in degrees and m") from error
    if not (abs(lat_deg) <= 85.0 and abs(lon_deg) <= 180.0 and -500.0 <= alt_amsl_m <= 6000.0):
        raise LeewayError(f"--home {text}: not a place to fly from")
    return Home(lat_deg, lon_deg, alt_amsl_m)


def connection_lines(index: int, autopilot: str, ports: Ports) -> list[str]:
    """The lines that tell how other programs reach a vehicle."""
    lines = [f"vehicle {index + 1}, {autopilot}, MAVLink system {index + 1}"]
    if ports.ground:
        lines.append(f"  QGroundControl  finds it by itself (UDP {ports.ground})")
    if ports.onboard:
        port = ports.onboard + index
        lines += [
            f"  MAVSDK          udpin://0.0.0.0:{port}",
            f"  companion       companion run --link udpin:0.0.0.0:{port} ...",
        ]
    if ports.tcp:
        port = ports.tcp + TCP_STRIDE * index
        lines.append(f"  MAVProxy        mavproxy.py --master tcp:{ports.host}:{port}")
    return lines


PLAN_SETTINGS = {  # to fly a plan without a receiver, at the plan's own speeds
    "px4": {"MPC_XY_VEL_MAX": 20.0, "MPC_TILTMAX_AIR": 35.0},
    "ardupilot": {"AUTO_OPTIONS": 3, "ANGLE_MAX": 3500},
}
SERVED = (
    *("vehicles", "home", "battery", "speedup"),
    *("host", "onboard_port", "ground_port", "tcp_port"),
)
"""Options of vehicles that are served to other programs."""

FIXED_HEADING = {"px4": {"MPC_YAW_MODE": 5}, "ardupilot": {"WP_YAW_BEHAVIOR": 0}}


@app.command(cls=command_class_with_options("seed", "out"))
def serve(
    context: typer.Context,
    vehicles: Annotated[int, typer.Option(min=1, max=100, help="Number of vehicles.")] = 1,
    autopilot: Annotated[str, typer.Option(help="Autopilot: px4, ardupilot or mixed.")] = "px4",
    airframe: Annotated[str, typer.Option(help="Airframe: m100 or octo8.")] = "m100",
    home: Annotated[str, typer.Option(help="LAT,LON,ALT of the first, deg, m.")] = "55.47,8.45,12",
    payload_kg: Annotated[
        float | None,
        typer.Option(min=0.0, help="Mass of the parcel, kg. Default: 0.4, with --fly 0."),
    ] = None,
    battery: Annotated[
        str,
        typer.Option(
            help="power_module: volts and amperes; sih_timer: as PX4's SIH, a percentage by time."
        ),
    ] = "power_module",
    wind_speed_mps: Annotated[
        float,
        typer.Option(min=0.0, max=40.0, help="Mean wind at 10 m, m/s; stronger above."),
    ] = 0.0,
    wind_from_deg: Annotated[
        float, typer.Option(help="Direction that the wind blows from, degrees.")
    ] = 0.0,
    turbulence: Annotated[bool, typer.Option(help="Dryden gusts on the mean wind.")] = True,
    speedup: Annotated[float, typer.Option(min=0.1, max=50.0, help="Multiple of real time.")] = 1.0,
    host: Annotated[str, typer.Option(help="Address to send to and to serve on.")] = "127.0.0.1",
    onboard_port: Annotated[int, typer.Option(help="UDP of the first companion; 0: none.")] = (
        14540
    ),
    ground_port: Annotated[int, typer.Option(help="UDP of the ground station; 0: none.")] = 14550,
    tcp_port: Annotated[int, typer.Option(help="TCP server of the first; 0: none.")] = 5760,
    fly: Annotated[
        Path | None,
        typer.Option(
            metavar="PLAN",
            help="Fly this QGroundControl plan (as of companion calibrate-plan) instead, from the"
            " plan's home and as fast as possible; record it to --out (.tlog).",
        ),
    ] = None,
    nose_held: Annotated[
        bool, typer.Option("--nose-held", help="With --fly: keep one heading, for sideways drag.")
    ] = False,
) -> None:
    """Stand up simulated vehicles and serve them until Ctrl-C, for any MAVLink program.

    The ports are those of PX4's and ArduPilot's own simulators, so other programs find the
    vehicles where they look for them. As ArduCopter a vehicle has what ArduPilot's own simulator
    has: a receiver with its throttle down, and (GRIP_ENABLE is 1) a gripper.

    sim-bridge serve --vehicles 2 --autopilot mixed --wind-speed-mps 6
    sim-bridge serve --fly square.plan --out 1.tlog --payload-kg 0.8 --wind-speed-mps 6
    """
    import numpy as np
    from rich.console import Console

    from companion.adapters.files.params import params_dir
    from companion.core.base.geo import offset_position_deg
    from sim_bridge.app.serve.server import SITL_RECEIVER, SITL_SETTINGS, Host
    from sim_bridge.app.world.vehicle_host import Home, power_up_vehicle
    from sim_bridge.autopilot.kinds import AutopilotKind
    from sim_bridge.truth.params import load_airframe
    from sim_bridge.truth.wind_params import build_mean_wind, build_wind_field, parse_wind

    if fly is None:
        require_options_not_given(context, ("out", "nose_held"), "expected with --fly")
    else:
        require_options_not_given(context, SERVED, "not with --fly")
    ports = Ports(host, onboard_port, ground_port, tcp_port)
    console = Console(highlight=False)
    home_position = _parse_home(home)
    airframe_truth = load_airframe(params_dir() / "truth" / f"{airframe}.toml")
    steady = {"kind": "steady", "speed_mps": wind_speed_mps, "from_deg": wind_from_deg}
    params = parse_wind(steady | {"turbulence": "dryden" if turbulence else "none"})
    mean = build_mean_wind(params, Path())
    if fly is not None:
        wind = build_wind_field(params, mean, np.random.default_rng(run_options().seed_or_1))
        _fly_plan_and_record(
            console, fly, autopilot, airframe_truth, wind, payload_kg or 0.0, nose_held=nose_held
        )
        return
    seed_sequence = np.random.SeedSequence(run_options().seed_or_1)
    with Host(speedup) as simulator_host:
        for index, seeds in enumerate(seed_sequence.spawn(vehicles)):
            name = _select_autopilot(autopilot, index)
            gusts, sensors = seeds.spawn(2)
            kind = AutopilotKind(name)
            served = power_up_vehicle(
                kind,
                airframe_truth,
                SITL_SETTINGS[kind],
                receiver_channels_us=SITL_RECEIVER[kind],
                battery_sensing=_parse_battery_sensing(battery, kind),
                home=Home(
                    *offset_position_deg(
                        home_position.lat_deg, home_position.lon_deg, *home_offset_ne_m(index)
                    ),
                    home_position.alt_amsl_m,
                ),
                wind_field=build_wind_field(params, mean, np.random.default_rng(gusts)),
                payload_kg=PARCEL_KG if payload_kg is None else payload_kg,
                system_id=index + 1,
                seed=sensors,
            )
            simulator_host.add_vehicle(
                served, onboard_urls=ports.onboard_urls(index), gcs_urls=ports.ground_urls(index)
            )
            for line in connection_lines(index, name, ports):
                console.print(line)
        console.print("serving; Ctrl-C ends it")
        try:
            simulator_host.serve_until(lambda: False)
        except KeyboardInterrupt:
            behind_s = simulator_host.wall_time_behind_s
            pace = "kept real time" if behind_s < 0.05 else f"{behind_s:.1f} s behind real time"
            console.print(f"stopped after {simulator_host.t_s:.0f} s of flight time ({pace})")


def _fly_plan_and_record(
    console: "Console",
    plan: Path,
    autopilot: str,
    airframe_truth: "AirframeTruth",
    wind: "WindField",
    payload_kg: float,
    *,
    nose_held: bool,
) -> None:
    from companion.adapters.files.qgc_plan import read_plan_home_and_items
    from sim_bridge.app.serve.plan_flight import fly_plan
    from sim_bridge.app.world.vehicle_host import Home, power_up_vehicle
    from sim_bridge.autopilot.kinds import AutopilotKind

    out = run_options().out
    if autopilot not in AUTOPILOTS or out is None:
        raise LeewayError("--fly: expected --out FILE.tlog, and --autopilot px4 or ardupilot")
    home, items = read_plan_home_and_items(plan)
    settings = PLAN_SETTINGS[autopilot] | (FIXED_HEADING[autopilot] if nose_held else {})
    kind = AutopilotKind(autopilot)
    served = power_up_vehicle(
        kind,
        airframe_truth,
        settings,
        home=Home(*home),
        wind_field=wind,
        payload_kg=payload_kg,
    )
    with console.status("on the ground") as status:
        flown = fly_plan(
            served,
            kind,
            items,
            out,
            report_simulated_time_s=lambda t_s: status.update(
                f"{t_s:.0f} s, {served.vehicle.height_m:.0f} m up"
            ),
        )
    console.print(
        f"{out}: {flown.duration_s:.0f} s, {flown.energy_wh:.1f} Wh by truth, mean wind"
        f" {flown.wind_mean_mps:.1f} m/s, {payload_kg:g} kg",
        soft_wrap=True,
    )
