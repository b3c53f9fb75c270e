"""`sim-bridge serve`: simulated vehicles for QGroundControl, MAVSDK, MAVProxy or anything else."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from companion.core.base.errors import LeewayError

if TYPE_CHECKING:
    from sim_bridge.app.serve.server import Home
    from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing

app = typer.Typer()

AUTOPILOTS = ("px4", "ardupilot")
TCP_STRIDE = 10
"""ArduPilot's SITL gives instance N the port 5760 + 10 N."""

SPACING_M = 60.0


@dataclass(frozen=True, slots=True)
class Ports:
    """Where a vehicle is found; 0 leaves a way out. Vehicles count up from the first's."""

    host: str
    onboard: int
    ground: int
    tcp: int

    def onboard_urls(self, index: int) -> list[str]:
        """A companion or MAVSDK listens here."""
        return [f"udpout:{self.host}:{self.onboard + index}"] if self.onboard else []

    def ground_urls(self, index: int) -> list[str]:
        """QGroundControl listens on one port for all; TCP is served, a port a vehicle."""
        udp = [f"udpout:{self.host}:{self.ground}"] if self.ground else []
        tcp = [f"tcpin:{self.host}:{self.tcp + TCP_STRIDE * index}"] if self.tcp else []
        return [*udp, *tcp]


def _wind_table(
    speed_mps: float, from_deg: float, turbulence: bool, wind_log: Path | None, start_s: float
) -> dict[str, Any]:
    gusts = "dryden" if turbulence else "none"
    if wind_log is None:
        steady = {"kind": "steady", "speed_mps": speed_mps, "from_deg": from_deg}
        return steady | {"turbulence": gusts}
    log = {"kind": "log", "log": str(wind_log.absolute()), "start_s": start_s}
    return log | {"turbulence": gusts}


def _autopilot_of(autopilot: str, index: int) -> str:
    if autopilot == "mixed":
        return AUTOPILOTS[index % 2]
    if autopilot not in AUTOPILOTS:
        raise LeewayError(f"--autopilot {autopilot}: expected px4, ardupilot or mixed")
    return autopilot


def _sensing(battery: str, kind: "AutopilotKind") -> "BatterySensing":
    from sim_bridge.autopilot.kinds import AutopilotKind, BatterySensing

    known = [sensing.value for sensing in BatterySensing]
    if battery not in known:
        raise LeewayError(f"--battery {battery}: expected {' or '.join(known)}")
    sensing = BatterySensing(battery)
    if sensing is BatterySensing.SIH_TIMER and kind is not AutopilotKind.PX4:
        raise LeewayError(f"--battery {battery}: {kind.value} has none, expected --autopilot px4")
    return sensing


def _home(words: str) -> "Home":
    from sim_bridge.app.serve.server import Home

    try:
        lat_deg, lon_deg, alt_amsl_m = map(float, words.split(","))
    except ValueError as error:
        raise LeewayError(f"--home {words}: expected LAT,LON,ALT in degrees and m") from error
    if not (abs(lat_deg) <= 85.0 and abs(lon_deg) <= 180.0 and -500.0 <= alt_amsl_m <= 6000.0):
        raise LeewayError(f"--home {words}: not a place to fly from")
    return Home(lat_deg, lon_deg, alt_amsl_m)


def how_to_connect(index: int, autopilot: str, ports: Ports) -> list[str]:
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


@app.command()
def serve(
    vehicles: Annotated[int, typer.Option(min=1, max=100, help="How many.")] = 1,
    autopilot: Annotated[str, typer.Option(help="px4, ardupilot or mixed.")] = "px4",
    airframe: Annotated[str, typer.Option(help="m100 or octo8.")] = "m100",
    home: Annotated[str, typer.Option(help="LAT,LON,ALT of the first.")] = "55.47,8.45,12",
    payload_kg: Annotated[float, typer.Option(min=0.0, help="Parcel aboard.")] = 0.0,
    charge_frac: Annotated[float, typer.Option(min=0.05, max=1.0, help="Of a full pack.")] = 1.0,
    battery: Annotated[
        str,
        typer.Option(
            help="power_module: volts and amperes; sih_timer: as PX4's SIH, a percentage by time."
        ),
    ] = "power_module",
    wind_speed_mps: Annotated[float, typer.Option(min=0.0, max=40.0, help="Mean wind.")] = 0.0,
    wind_from_deg: Annotated[float, typer.Option(help="Where it blows from.")] = 0.0,
    turbulence: Annotated[bool, typer.Option(help="Dryden gusts on the mean wind.")] = True,
    wind_log: Annotated[
        Path | None, typer.Option(help="Recording (t_s, wind_speed_mps, wind_from_deg) instead.")
    ] = None,
    wind_start_s: Annotated[float, typer.Option(min=0.0, help="Where it starts.")] = 0.0,
    speedup: Annotated[float, typer.Option(min=0.1, max=50.0, help="Times real time.")] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Gusts and sensor errors follow it.")] = 1,
    host: Annotated[str, typer.Option(help="Address to send to and to serve on.")] = "127.0.0.1",
    onboard_port: Annotated[int, typer.Option(help="UDP of the first's companion; 0: none.")] = (
        14540
    ),
    ground_port: Annotated[int, typer.Option(help="UDP of the ground station; 0: none.")] = 14550,
    tcp_port: Annotated[int, typer.Option(help="TCP server of the first; 0: none.")] = 5760,
) -> None:
    """Stand up simulated vehicles and serve them until Ctrl-C, for any MAVLink program.

    The ports are those of PX4's and ArduPilot's own simulators, so other programs find the
    vehicles where they look for them. As ArduCopter a vehicle has what ArduPilot's own simulator
    has: a receiver with its throttle down, and (GRIP_ENABLE is 1) a gripper.
    """
    import numpy as np
    from rich.console import Console

    from companion.adapters.files.params import params_dir
    from companion.core.base.geo import moved_deg
    from sim_bridge.app.serve.server import (
        SITL_RECEIVER,
        SITL_SETTINGS,
        Home,
        Host,
        stand_up,
    )
    from sim_bridge.autopilot.kinds import AutopilotKind
    from sim_bridge.autopilot.mavlink.parameters import read_parameters
    from sim_bridge.truth.params import load_airframe
    from sim_bridge.truth.wind_params import build_wind_field, mean_wind, parse_wind

    ports = Ports(host, onboard_port, ground_port, tcp_port)
    console = Console(highlight=False)
    place = _home(home)
    body = load_airframe(params_dir() / "truth" / f"{airframe}.toml")
    params = parse_wind(
        _wind_table(wind_speed_mps, wind_from_deg, turbulence, wind_log, wind_start_s)
    )
    mean = mean_wind(params, Path())
    with Host(speedup) as bridge:
        for index, seeds in enumerate(np.random.SeedSequence(seed).spawn(vehicles)):
            name = _autopilot_of(autopilot, index)
            gusts, sensors = seeds.spawn(2)
            kind = AutopilotKind(name)
            settings = params_dir() / "autopilots" / f"{name}.toml"
            served = stand_up(
                kind,
                body,
                read_parameters(settings, SITL_SETTINGS[kind]),
                receiver=SITL_RECEIVER[kind],
                battery_sensing=_sensing(battery, kind),
                home=Home(
                    *moved_deg(place.lat_deg, place.lon_deg, SPACING_M * index, 0.0),
                    place.alt_amsl_m,
                ),
                wind=build_wind_field(params, mean, np.random.default_rng(gusts)),
                payload_kg=payload_kg,
                charge_frac=charge_frac,
                system_id=index + 1,
                seed=sensors,
            )
            bridge.add(served, onboard=ports.onboard_urls(index), gcs=ports.ground_urls(index))
            for line in how_to_connect(index, name, ports):
                console.print(line)
        console.print("serving; Ctrl-C ends it")
        try:
            bridge.run(lambda: False)
        except KeyboardInterrupt:
            console.print(
                f"stopped after {bridge.t_s:.0f} s of flight time"
                f" ({bridge.slipped_s:.1f} s of wall time behind)"
            )
