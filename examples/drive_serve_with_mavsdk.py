"""Fly a simulated PX4 with MAVSDK 4: `sim-bridge serve` stands it up, MAVSDK arms, lifts and lands.

Somebody else's client and our vehicle know each other only by MAVLink. Needs leeway-uas[sim] and
mavsdk 4. Run it from a checkout or an installed package:

    python examples/drive_serve_with_mavsdk.py
"""

import asyncio
import socket
import subprocess
import sys

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

SPEEDUP = 8.0
HEIGHT_M = 10.0
PATIENCE_S = 60.0
SERVE = (sys.executable, "-m", "sim_bridge.main", "serve")  # as the command sim-bridge serve


def free_port() -> int:
    """A UDP port that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def serve(port: int) -> subprocess.Popen:
    """`sim-bridge serve` with one PX4 that calls this port."""
    options = [f"--speedup={SPEEDUP}", f"--onboard-port={port}", "--ground-port=0", "--tcp-port=0"]
    return subprocess.Popen([*SERVE, *options])


async def fly(system: System) -> None:
    """Arm, take off, see it climb, land, see it disarm."""
    action, telemetry = ActionAsync(system), TelemetryAsync(system)
    async for all_ok in telemetry.subscribe_health_all_ok():
        if all_ok:
            break
    await action.set_takeoff_altitude(HEIGHT_M)
    await action.arm()
    await action.takeoff()
    async for position in telemetry.subscribe_position():
        if position.relative_altitude_m > 0.9 * HEIGHT_M:
            print(f"at {position.relative_altitude_m:.1f} m")
            break
    await action.land()
    async for armed in telemetry.subscribe_armed():
        if not armed:
            print("landed and disarmed")
            break


async def connect_and_fly(port: int) -> None:
    """With a limit in time: an example that hangs teaches nothing."""
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with asyncio.timeout(PATIENCE_S), Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        assert system is not None, "MAVSDK found no autopilot"
        await fly(system)


if __name__ == "__main__":
    chosen = free_port()
    with serve(chosen) as server:
        try:
            asyncio.run(connect_and_fly(chosen))
        finally:
            server.terminate()
