"""zenoh on loopback for tests: explicit endpoints, no multicast, and vehicles that only answer."""

import json
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from companion.adapters.files.params import read_airframe
from companion.app.flight.fleet_port import FleetPort
from companion.core.mission.events import Position
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.separation.track_cells import cell_of
from companion.fleet.command_log import Verdict
from companion.fleet.messages import Answered, Command
from companion.fleet.network import MemberLink
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_config
from companion.fleet.zenoh_link import ZenohLink

FLEET = "harbour"
AT_HARBOUR = Position(0.0, 55.47, 8.45, 12.0, 0.0, 0.0, 0.0, 0.0)
"""Where params/days/harbour.toml has its depot."""

CELL = cell_of(AT_HARBOUR.lat_deg, AT_HARBOUR.lon_deg)
HERE = {"lat_deg": AT_HARBOUR.lat_deg, "lon_deg": AT_HARBOUR.lon_deg}
"""The place of a track that all vehicles of these tests hear."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def config_file(
    path: Path, *, listen: int | None = None, connect: int | None = None, **more: Any
) -> Path:
    """A peer that listens at, or calls, a port of loopback."""
    table: dict[str, Any] = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "listen": {"endpoints": [f"tcp/127.0.0.1:{listen or 0}"]},
        "connect": {
            "endpoints": [f"tcp/127.0.0.1:{connect}"] if connect else [],
            "retry": {"period_init_ms": 50, "period_max_ms": 200},
        },
    }
    path.write_text(json.dumps(table | more))
    return path


class Vehicle:
    """A FleetPort in a thread of its own that carries every command out, and counts."""

    def __init__(self, name: str, folder: Path, config: Path) -> None:
        keys, loaded = VehicleKeys(FLEET, name), read_config(config)
        self.begin(name, folder, lambda life: ZenohLink(loaded, keys, life, lambda: None))

    @classmethod
    def on(cls, name: str, folder: Path, link_of: Callable[[str], MemberLink]) -> "Vehicle":
        """A vehicle on a link of the test's own."""
        vehicle = cls.__new__(cls)
        vehicle.begin(name, folder, link_of)
        return vehicle

    def begin(self, name: str, folder: Path, link_of: Callable[[str], MemberLink]) -> None:
        """Start the thread on this link."""
        self.done: list[Command] = []
        self.answer = Verdict(Answered.DONE, "done")
        self.woken = threading.Event()
        self.port = FleetPort.open(name, "m100", read_airframe("m100"), folder, link_of)
        self.port.link.be_woken(self.woken.set)
        self.situation = TelemetryState(position=AT_HARBOUR)
        self.phase = "standby"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            self.port.turn(self.carry_out)
            self.port.publish(self.phase, self.situation)
            self.woken.wait(0.05)
            self.woken.clear()

    def carry_out(self, command: Command) -> Verdict:
        self.done.append(command)
        return self.answer

    def stop(self) -> None:
        """End the thread; the port stays."""
        self._stop.set()
        self._thread.join()

    def close(self) -> None:
        self.stop()
        self.port.close()
