"""Vehicles that other programs reach by a socket: the simulated m100, powered up on its pad."""

import contextlib
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from companion.adapters.files.params import params_dir
from sim_bridge.app.serve.server import Host
from sim_bridge.app.world.vehicle_host import VehicleHost, power_up_vehicle
from sim_bridge.autopilot.kinds import AutopilotKind
from sim_bridge.truth.params import load_airframe

COMMAND = Path(sys.executable).with_name("companion")
SPEEDUP = 6.0


def on_the_ground(
    kind: AutopilotKind | str, settings: Mapping[str, float] | None = None, **options: Any
) -> VehicleHost:
    """Return a vehicle of one autopilot; `settings`: parameters, `options`: those of
    `power_up_vehicle`.
    """
    kind = AutopilotKind(kind)
    airframe = load_airframe(params_dir() / "truth" / "m100.toml")
    return power_up_vehicle(kind, airframe, settings, **options)


def companion_done(
    served: VehicleHost,
    *words: str,
    prepare: Callable[[VehicleHost], None] = lambda served: None,
) -> subprocess.CompletedProcess[str]:
    """Run the `companion` command on a served vehicle after `prepare`; its stderr is empty."""
    port = free_udp_port()
    with Host(SPEEDUP) as host:
        host.add_vehicle(served, onboard_urls=[f"udpout:127.0.0.1:{port}"])
        with host.serve_in_thread():
            prepare(served)
            done = subprocess.run(
                [str(COMMAND), *words, f"--link=udpin:127.0.0.1:{port}"],
                capture_output=True,
                text=True,
                timeout=90,
                check=False,
            )
    assert done.stderr == ""
    return done


def free_udp_port() -> int:
    """Return a free UDP port of the loopback interface."""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
